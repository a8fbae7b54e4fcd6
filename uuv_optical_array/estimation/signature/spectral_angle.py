"""The Spectral Angle Mapper: the angle between vectors, and the rows nearest by it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from uuv_optical_array.core.geometry import Array

# Chords that differ by no more than this are ranked by the stable angle.
APART, CHORD_ROUNDING = 1 + 1e-9, 1e-15
BLOCK_ROWS = 1 << 16
SMALL = 1e-100  # numbers between this and its inverse have squares that neither over- nor underflow


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
        if largest.size and not (largest.min() > SMALL and largest.max() < 1 / SMALL):
            # Scaled to about one, or squares might overflow; a power of two rounds nothing.
            own = np.ldexp(own, -np.frexp(largest)[1])
        return own / np.sqrt(np.add.reduce(own * own, axis=-1, keepdims=True))


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

    Nearest by angle is nearest by chord on the unit sphere, so a k-d tree of unit rows answers
    exactly; the stable angle ranks again. ValueError for no rows, or a row without a direction.
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

    def nearest(self, query: ArrayLike, k: int = 1) -> tuple[Array, NDArray[np.intp]]:
        """Find the k rows nearest to a vector, shape ``(n,)``.

        Returned are angles, rad, ascending, and row numbers, which order equal rows,
        ``(min(k, m),)`` each. ValueError for a query without a direction, or of another length.
        """
        query, (count, length) = np.asarray(query, dtype=float), self._units.shape
        if query.shape != (length,):
            raise ValueError(f"spectral index: query of shape {query.shape}; give ({length},)")
        unit, k = unit_vectors(query), min(k, count)
        fetch, settled = k + 1, False
        while not settled:
            fetch = min(fetch, count)
            chords, neighbours = map(np.ravel, self._tree.query(unit, fetch))
            # Until the last one fetched is clearly farther, a tie may lie outside.
            settled = fetch == count or chords[-1] > chords[k - 1] * APART + CHORD_ROUNDING
            fetch *= 4
        least = np.minimum.reduce(chords[1:] - chords[:-1], initial=chords[-1])
        if chords[-1] < 1 and least > chords[-1] * (APART - 1) + CHORD_ROUNDING:
            # In order, and up to 60 deg the chord by itself is as good as the stable angle.
            return 2 * np.arcsin(chords[:k] / 2), self._rows[neighbours[:k]]
        angles, rows = _angle_between_units(self._units[neighbours], unit), self._rows[neighbours]
        order = np.lexsort((rows, angles))[:k]
        return angles[order], rows[order]
