"""Which parameters the images of a calibration determine, and with what covariance."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.parameters import (
    BACKGROUND,
    GAINS,
    POWER,
    SIGMA,
    K,
    directions,
)
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.scene import PRIORS

# A standard error beyond these is no knowledge: a water type, or a look at the array in the dark,
# tells as much. Of the logarithms, 1/m, and of the full scale.
LARGEST = {POWER: 0.15, SIGMA: 0.15, K: 0.02, BACKGROUND: 0.02, GAINS: 0.15}
# What is not told may put this much into a gain, relative; where it puts more, all gains are held:
# they would take up an error of the beam as a pattern that a pose is read from.
MOST_IN_GAINS = 0.005
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


def carried(
    information: Array, covariances: Array, unknown: Collection[int], largest: Array
) -> Array:
    """Return how the fitted parameters move with each that is held because it is not known.

    Parameters
    ----------
    information
        Fisher's, shape ``(p, p)``.
    covariances
        Of the fitted parameters, 0 where held, shape ``(p, p)``.
    unknown
        The q parameters that are held and not known, taken to be off by `largest`, a gain by what
        it is of a rig as bought.
    largest
        As `largest_errors` returns it.

    Returns
    -------
    Array
        Shape ``(p, q)``: the most probable values, given the held one, follow it linearly.
    """
    held: NDArray[np.intp] = np.array(sorted(unknown), dtype=np.intp)
    moves = -covariances @ information[:, held]
    moves[held, np.arange(len(held))] += 1.0
    off = np.where(held < GAINS, largest[held], PRIORS["as_bought"]["gain_std"])
    return np.asarray(moves * off)


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
        Parameters that are known only as long as another, the value, is held, or held with it.
    """
    mixed: dict[int, int] = {}
    unknown: set[int] = set()
    own = np.diag(information) * largest**2
    while True:
        covariances = covariance(information, given | unknown, largest)
        over = np.flatnonzero(misfit * np.diag(covariances) > largest**2).tolist()
        if not over:
            more = _taken_up(carried(information, covariances, unknown, largest), unknown, largest)
            if more.keys() <= unknown | given:
                return frozenset(unknown), mixed
            mixed |= more
            unknown |= more.keys() - given
            continue
        # Detectors without light come before what mixes with all of them.
        chosen = [i for i in over if i >= GAINS and own[i] < misfit]
        if not chosen:
            first = next(i for i in FIRST if i in (min(j, GAINS) for j in over))
            chosen = [i for i in over if min(i, GAINS) == first]
            for i in over:
                mixed.setdefault(i, first)
        unknown.update(chosen)
        for i in chosen:
            mixed.pop(i, None)


def _taken_up(moves: Array, unknown: Collection[int], largest: Array) -> dict[int, int]:
    """Return what takes up too much of one that is held because it is not known, and of which.

    The power may: something has to take up what the others leave.
    """
    if not unknown:
        return {}
    size = np.sqrt((moves**2).sum(axis=1))
    size[sorted(unknown)] = 0.0
    chief = np.array(sorted(unknown))[np.abs(moves).argmax(axis=1)].tolist()
    over = [i for i in (SIGMA, K, BACKGROUND) if size[i] > largest[i]]
    if size[GAINS:].max() > MOST_IN_GAINS:
        over += range(GAINS, len(size))
        chief[GAINS:] = [chief[GAINS + int(size[GAINS:].argmax())]] * (len(size) - GAINS)
    return {i: chief[i] for i in over}
