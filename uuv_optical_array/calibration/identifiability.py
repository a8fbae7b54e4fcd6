"""Which parameters the images of a calibration determine, and with what covariance."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.parameters import (
    AIMS,
    BACKGROUND,
    COSINE_POWER,
    GAINS,
    POWER,
    SCATTER,
    SIGMA,
    SIZE,
    K,
    free_directions,
)
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.prior import PRIORS

# A larger standard error counts as undetermined: a water type, or a look at the array in the dark,
# tells as much. Of the logarithms, in 1/m and rad, and relative to full scale.
LARGEST_STD = {
    POWER: 0.15,
    SIGMA: 0.15,
    K: 0.02,
    SCATTER: 0.5,
    COSINE_POWER: 0.2,
    SIZE: 0.03,
    **dict.fromkeys(AIMS, 0.02),
    BACKGROUND: 0.02,
    GAINS: 0.15,
}
# Undetermined parameters that are held may shift a gain by this much, relative. Beyond it all gains
# are held: they would absorb an error of the beam as a pattern from which poses are read.
MAX_GAIN_SHIFT = 0.005
# Which of several correlated parameters is held first; the power absorbs what the others leave.
HOLD_ORDER = (
    *(SIZE, COSINE_POWER, SCATTER, *AIMS),
    *(K, SIGMA, BACKGROUND, GAINS, POWER),
)


def largest_stds(size: int, full_scale_counts: float) -> Array:
    """Return the standard error beyond which each parameter is undetermined, shape ``(size,)``."""
    largest = np.full(size, LARGEST_STD[GAINS])
    largest[:GAINS] = [LARGEST_STD[i] for i in range(GAINS)]
    largest[BACKGROUND] *= full_scale_counts
    return largest


def covariance(information: Array, held: Collection[int], units: Array) -> Array:
    """Return the inverse of Fisher's information of the parameters that are not held, ``(p, p)``.

    It is 0 where held and huge where undetermined. In `units`, shape ``(p,)``, rounding errors of
    all parameters compare.
    """
    basis = free_directions(held, len(information))
    reduced = basis.T @ information @ basis
    if not len(reduced):
        return np.zeros(information.shape)
    unit = np.sqrt((basis**2).T @ units**2)
    values, vectors = np.linalg.eigh(reduced * np.outer(unit, unit))
    inverse = 1 / np.maximum(values, 1e-12 * max(1.0, values[-1]))
    vectors = basis @ (vectors * unit[:, None])
    return (vectors * inverse) @ vectors.T


def held_shifts(
    information: Array, covariances: Array, unknown: Collection[int], largest: Array
) -> Array:
    """Return how far the fitted parameters move with each of the q unknown ones, ``(p, q)``.

    The most probable values follow a parameter that is held though unknown linearly. Its standard
    deviation is `largest`; that of a gain is the one of a rig as bought. The `covariances` are
    those of the fitted parameters, 0 where held.
    """
    held: NDArray[np.intp] = np.array(sorted(unknown), dtype=np.intp)
    shifts = -covariances @ information[:, held]
    shifts[held, np.arange(len(held))] += 1.0
    stds = np.where(held < GAINS, largest[held], PRIORS["as_bought"]["gain_std"])
    return np.asarray(shifts * stds)


def undetermined(
    information: Array,
    given: frozenset[int],
    largest: Array,
    misfit: float = 1.0,
    keep: Collection[int] = (),
) -> tuple[frozenset[int], dict[int, int]]:
    """Return the parameters to hold so that the images determine all others, and correlated ones.

    Those `given` are held anyway, those to `keep` are among the result; `misfit` is a factor of the
    variances. A correlated parameter is determined only while another, the value, is held, or it is
    held with it.
    """
    correlated: dict[int, int] = {}
    unknown = set(keep)
    own = np.diag(information) * largest**2
    while True:
        covariances = covariance(information, given | unknown, largest)
        over = np.flatnonzero(misfit * np.diag(covariances) > largest**2).tolist()
        if not over:
            shifts = held_shifts(information, covariances, unknown, largest)
            more = _shifted_too_far(shifts, unknown, largest)
            if more.keys() <= unknown | given:
                return frozenset(unknown), correlated
            correlated |= more
            unknown |= more.keys() - given
            continue
        # Detectors without light come before what correlates with all of them.
        chosen = [i for i in over if i >= GAINS and own[i] < misfit]
        if not chosen:
            first = next(i for i in HOLD_ORDER if i in (min(j, GAINS) for j in over))
            chosen = [i for i in over if min(i, GAINS) == first]
            for i in over:
                correlated.setdefault(i, first)
        unknown.update(chosen)
        for i in chosen:
            correlated.pop(i, None)


def _shifted_too_far(shifts: Array, unknown: Collection[int], largest: Array) -> dict[int, int]:
    """Return the parameters that held ones shift too far, and by which one the most.

    The power may be shifted: something has to absorb what the others leave.
    """
    if not unknown:
        return {}
    size = np.sqrt((shifts**2).sum(axis=1))
    size[sorted(unknown)] = 0.0
    causes = np.array(sorted(unknown))[np.abs(shifts).argmax(axis=1)].tolist()
    over = [i for i in range(SIGMA, GAINS) if size[i] > largest[i]]
    if size[GAINS:].max() > MAX_GAIN_SHIFT:
        over += range(GAINS, len(size))
        causes[GAINS:] = [causes[GAINS + int(size[GAINS:].argmax())]] * (len(size) - GAINS)
    return {i: causes[i] for i in over}
