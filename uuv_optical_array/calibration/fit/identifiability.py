"""Which parameters the images of a calibration determine, and with what covariance."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.likelihood.parameters import (
    BOUGHT,
    GAINS,
    HOLD_ORDER,
    SIGMA,
    Layout,
)
from uuv_optical_array.core.geometry import Array

# Undetermined parameters that are held may shift a gain by this much, relative. Beyond it all gains
# are held: they would absorb an error of the beam as a pattern from which poses are read.
MAX_GAIN_SHIFT = 0.005


def covariance(layout: Layout, information: Array, held: Collection[int]) -> Array:
    """Return the inverse information, ``(p, p)``: 0 where held, huge where undetermined."""
    basis = layout.free_directions(held)
    reduced = basis.T @ information @ basis
    if not len(reduced):
        return np.zeros(information.shape)
    # In these units rounding errors of all parameters compare.
    unit = np.sqrt((basis**2).T @ layout.largest**2)
    values, vectors = np.linalg.eigh(reduced * np.outer(unit, unit))
    inverse = 1 / np.maximum(values, 1e-12 * max(1.0, values[-1]))
    vectors = basis @ (vectors * unit[:, None])
    return (vectors * inverse) @ vectors.T


def held_shifts(
    layout: Layout, information: Array, covariances: Array, unknown: Collection[int]
) -> Array:
    """Return how far the fitted parameters move with each of the q unknown ones, ``(p, q)``.

    Each moves by its standard deviation: the largest of its kind, or of a gain that as bought.
    """
    held: NDArray[np.intp] = np.array(sorted(unknown), dtype=np.intp)
    shifts = -covariances @ information[:, held]
    shifts[held, np.arange(len(held))] += 1.0
    stds = np.where(held < layout.gains, layout.largest[held], BOUGHT["gain_std"])
    return np.asarray(shifts * stds)


def undetermined(
    layout: Layout,
    information: Array,
    given: frozenset[int],
    misfit: float = 1.0,
    keep: Collection[int] = (),
) -> tuple[frozenset[int], dict[int, int]]:
    """Return the parameters to hold so that the images determine all others, and correlated ones.

    Those `given` are held anyway, those to `keep` are among the result; `misfit` is a factor of the
    variances. A correlated one is held with another, its value, or determined only while that is.
    """
    correlated: dict[int, int] = {}
    unknown, kinds, largest = set(keep), layout.kinds, layout.largest
    own = np.diag(information) * largest**2
    while True:
        covariances = covariance(layout, information, given | unknown)
        over = np.flatnonzero(misfit * np.diag(covariances) > largest**2).tolist()
        if not over:
            shifts = held_shifts(layout, information, covariances, unknown)
            more = _shifted_too_far(layout, shifts, unknown)
            if more.keys() <= unknown | given:
                return frozenset(unknown), correlated
            correlated |= more
            unknown |= more.keys() - given
            continue
        # Detectors without light come before what correlates with all of them.
        chosen = [i for i in over if kinds[i] == GAINS and own[i] < misfit]
        if not chosen:
            first = next(kind for kind in HOLD_ORDER if kind in kinds[over])
            chosen = [i for i in over if kinds[i] == first]
            for i in over:
                correlated.setdefault(i, chosen[0])
        unknown.update(chosen)
        for i in chosen:
            correlated.pop(i, None)


def _shifted_too_far(layout: Layout, shifts: Array, unknown: Collection[int]) -> dict[int, int]:
    """Return the parameters that held ones shift too far, and by which one the most."""
    if not unknown:
        return {}
    size = np.sqrt((shifts**2).sum(axis=1))
    size[sorted(unknown)] = 0.0
    causes = np.array(sorted(unknown))[np.abs(shifts).argmax(axis=1)].tolist()
    first = layout.gains
    # The power may be shifted: something has to absorb what the others leave.
    over = [i for i in range(SIGMA, first) if size[i] > layout.largest[i]]
    if size[first:].max() > MAX_GAIN_SHIFT:
        over += range(first, len(size))
        causes[first:] = [causes[first + int(size[first:].argmax())]] * (len(size) - first)
    return {i: causes[i] for i in over}
