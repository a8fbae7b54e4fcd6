"""Which parameters the images of a calibration determine, and with what covariance."""

from collections.abc import Collection

import numpy as np

from uuv_optical_array.calibration.parameters import (
    BACKGROUND,
    GAINS,
    POWER,
    SIGMA,
    K,
    directions,
)
from uuv_optical_array.core.geometry import Array

# A standard error beyond these is no knowledge: a water type, or a look at the array in the dark,
# tells as much. Of the logarithms, 1/m, and of the full scale.
LARGEST = {POWER: 0.15, SIGMA: 0.15, K: 0.02, BACKGROUND: 0.02, GAINS: 0.15}
# What is held first where several mix: the power takes up what the others leave.
FIRST = (K, SIGMA, BACKGROUND, GAINS, POWER)


def largest_errors(size: int, full_scale_counts: float) -> Array:
    """Return the standard error beyond which each parameter is undetermined, shape ``(size,)``."""
    largest = np.full(size, LARGEST[GAINS])
    largest[:GAINS] = [LARGEST[i] for i in range(GAINS)]
    largest[BACKGROUND] *= full_scale_counts
    return largest


def covariance(information: Array, held: Collection[int], units: Array) -> Array:
    """Return the inverse information of the parameters that are not held.

    Parameters
    ----------
    information
        Fisher's, shape ``(p, p)``.
    held
        Parameters that do not move.
    units
        In which rounding is judged alike for all, such as `largest_errors`, shape ``(p,)``.

    Returns
    -------
    Array
        Shape ``(p, p)``; 0 where held, huge where undetermined.
    """
    basis = directions(held, len(information))
    reduced = basis.T @ information @ basis
    if not len(reduced):
        return np.zeros(information.shape)
    unit = np.sqrt((basis**2).T @ units**2)
    values, vectors = np.linalg.eigh(reduced * np.outer(unit, unit))
    inverse = 1 / np.maximum(values, 1e-12 * max(1.0, values[-1]))
    vectors = basis @ (vectors * unit[:, None])
    return (vectors * inverse) @ vectors.T


def undetermined(
    information: Array, given: frozenset[int], largest: Array, misfit: float = 1.0
) -> tuple[frozenset[int], dict[int, int]]:
    """Find what the images do not tell, so that the rest is known once it is held.

    Parameters
    ----------
    information
        Fisher's, shape ``(p, p)``.
    given
        Parameters that are held anyway.
    largest
        As `largest_errors` returns it.
    misfit
        Factor of the variances.

    Returns
    -------
    unknown
        Undetermined parameters.
    mixed
        Parameters that are known only as long as another, the value, is held.
    """
    mixed: dict[int, int] = {}
    unknown: set[int] = set()
    own = np.diag(information) * largest**2
    while True:
        variances = np.diag(covariance(information, given | unknown, largest))
        over = np.flatnonzero(misfit * variances > largest**2).tolist()
        if not over:
            return frozenset(unknown), {i: by for i, by in mixed.items() if i not in unknown}
        # Detectors without light come before what mixes with all of them.
        chosen = [i for i in over if i >= GAINS and own[i] < misfit]
        if not chosen:
            first = next(i for i in FIRST if i in (min(j, GAINS) for j in over))
            chosen = [i for i in over if min(i, GAINS) == first]
            for i in over:
                mixed.setdefault(i, first)
        unknown.update(chosen)
