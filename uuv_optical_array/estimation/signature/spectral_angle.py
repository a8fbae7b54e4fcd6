"""The Spectral Angle Mapper: the angle between vectors, and the rows nearest by it."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from uuv_optical_array.core.geometry import Array

# Chords that differ by no more than this are ranked by the stable angle.
APART, ROUNDING = 1 + 1e-9, 1e-15
CANDIDATES = 1 << 20  # ranked at a time, which bounds the memory
BLOCK_ROWS = 1 << 16
SHORT = 8  # numbers; NumPy sums fewer than these one after the other
# Numbers between these have squares that neither overflow nor underflow.
SMALL, LARGE = 1e-100, 1e100


def unit_vectors(vectors: ArrayLike) -> Array:
    """Scale vectors, shape ``(..., n)``, to length one, whatever their magnitude.

    ValueError for a zero vector, which has no direction, or one that is not finite.
    """
    own: Array = np.asarray(vectors, dtype=float)
    largest = np.abs(own).max(axis=-1, keepdims=True)
    if not np.isfinite(largest).all():
        raise ValueError("spectral angle: a vector is not finite; drop it before the match")
    if not largest.all():
        raise ValueError("spectral angle: a vector is zero and has no angle; drop it")
    with np.errstate(under="ignore"):
        if largest.size and not (largest.min() > SMALL and largest.max() < LARGE):
            # Near one first, so that squares neither overflow nor underflow; by a power of two,
            # which rounds nothing.
            own = np.ldexp(own, -np.frexp(largest)[1])
        return own / np.sqrt(np.add.reduce(own * own, axis=-1, keepdims=True))


def _unit_vector(vector: Array) -> Array:
    """`unit_vectors` of a single one, to the last bit, in an eighth of the time."""
    values, squared = vector.tolist(), 0.0
    if len(values) < SHORT:
        for value in values:
            squared += value * value
    if SMALL * SMALL < squared < LARGE * LARGE:
        length = math.sqrt(squared)
        return np.array([value / length for value in values])
    return unit_vectors(vector)


def _angle_between_units(u: Array, v: Array) -> Array:
    with np.errstate(under="ignore"):
        return 2 * np.arctan2(np.linalg.norm(u - v, axis=-1), np.linalg.norm(u + v, axis=-1))


def spectral_angle(u: ArrayLike, v: ArrayLike) -> Array:
    """Angle between vectors, accurate for small angles too.

    ``2 atan2(|u' - v'|, |u' + v'|)`` on unit vectors (W. Kahan), where the arccos of the dot
    product (Eren et al. 2016, eq. 13) answers 0 below 1e-8 rad.

    Parameters
    ----------
    u, v
        Vectors of shapes that broadcast to ``(..., n)``.

    Returns
    -------
    Array
        Angles in [0, pi] rad, shape ``(...)``.

    Raises
    ------
    ValueError
        As `unit_vectors`.
    """
    return _angle_between_units(unit_vectors(u), unit_vectors(v))


def _tree(units: Array) -> cKDTree:
    # These options build faster than SciPy's defaults and search as fast.
    return cKDTree(units, leafsize=32, balanced_tree=False, compact_nodes=False)


class SpectralIndex:
    """Exact search for the rows, shape ``(m, n)``, of least spectral angle.

    Nearest by angle is nearest by chord on the unit sphere, so a k-d tree on normalised rows
    answers exactly; the candidates are ranked again by the stable angle. ValueError for a row that
    has no direction, or no rows.
    """

    def __init__(self, rows: ArrayLike) -> None:
        rows = np.asarray(rows)
        if rows.ndim != 2 or len(rows) == 0:
            raise ValueError(f"spectral index: rows have shape {rows.shape}; give (m, n), m >= 1")
        # Block by block: the temporaries of all rows at once would be three more copies.
        self._units = np.empty(rows.shape)
        for start in range(0, len(rows), BLOCK_ROWS):
            self._units[start : start + BLOCK_ROWS] = unit_vectors(rows[start : start + BLOCK_ROWS])
        # Rows of one leaf next to each other: a search waits for memory more than it computes.
        self._rows = _tree(self._units).indices.copy()
        self._units = self._units[self._rows]
        self._tree = _tree(self._units)
        self._places = np.empty_like(self._rows)
        self._places[self._rows] = np.arange(len(self._rows))

    def units(self, rows: NDArray[np.intp]) -> Array:
        """Return the unit vectors of rows, shape ``(k, n)``, by their numbers, shape ``(k,)``."""
        units: Array = self._units[self._places[rows]]
        return units

    def nearest(self, query: ArrayLike, k: int = 1) -> tuple[Array, NDArray[np.intp]]:
        """Find the k rows nearest to a vector, ``(n,)``, or to each of many, ``(q, n)``.

        Returned are angles, rad, ascending, and row numbers, by which equal angles are ordered,
        shape ``(min(k, m),)`` or ``(q, min(k, m))``. ValueError for a query that has no direction,
        or is of another length than the rows.
        """
        query = np.asarray(query, dtype=float)
        length = self._units.shape[1]
        if query.ndim not in (1, 2) or query.shape[-1] != length:
            raise ValueError(
                f"spectral index: query of shape {query.shape}; give ({length},) or (q, {length})"
            )
        k = min(k, len(self._units))
        if query.ndim == 2:
            return self._ranked(unit_vectors(query), k)
        unit = _unit_vector(query)
        if k < len(self._units):
            chords, neighbours = self._tree.query(unit, k + 1)
            # Where all are clearly apart they are in order, and up to 60 deg the chord, taken by
            # itself, is as good as the stable angle.
            least = np.minimum.reduce(chords[1:] - chords[:-1])
            if chords[-1] < 1 and least > chords[-1] * (APART - 1) + ROUNDING:
                return 2 * np.arcsin(chords[:k] / 2), self._rows[neighbours[:k]]
        angles, rows = self._ranked(unit[None], k)
        return angles[0], rows[0]

    def _ranked(self, units: Array, k: int) -> tuple[Array, NDArray[np.intp]]:
        """Find the `k` nearest rows to each unit vector, shape ``(q, n)``, ranked once more."""
        angles, rows = np.empty((len(units), k)), np.empty((len(units), k), dtype=np.intp)
        pending, fetch = np.arange(len(units)), k + 1
        while len(pending):
            fetch, unsettled = min(fetch, len(self._units)), []
            step = max(1, CANDIDATES // fetch)
            for part in (pending[i : i + step] for i in range(0, len(pending), step)):
                chords, neighbours = self._tree.query(units[part], fetch)
                chords, neighbours = chords.reshape(-1, fetch), neighbours.reshape(-1, fetch)
                # Until the last one fetched is clearly farther, a tie may lie outside.
                settled = chords[:, -1] > chords[:, k - 1] * APART + ROUNDING
                settled |= fetch == len(self._units)
                neighbours, own = neighbours[settled], part[settled]
                stable = _angle_between_units(self._units[neighbours], units[own, None])
                neighbours = self._rows[neighbours]
                order = np.lexsort((neighbours, stable))[:, :k]
                angles[own] = np.take_along_axis(stable, order, axis=1)
                rows[own] = np.take_along_axis(neighbours, order, axis=1)
                unsettled.append(part[~settled])
            pending, fetch = np.concatenate(unsettled), 4 * fetch
        return angles, rows
