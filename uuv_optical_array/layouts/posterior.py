"""The posterior of the pose of a row of readings, at many places at once, and its maxima."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import PITCH, Array
from uuv_optical_array.core.numerics.gauss_newton import minimiser
from uuv_optical_array.estimation.information.likelihood import log_likelihood
from uuv_optical_array.forward.noise import ReadingNoise

STEPS, SETTLED = 40, 1e-5  # of the refinement; decrement of the cost
LEAST_ABEAM = 0.49 * np.pi


class Row(NamedTuple):
    """The readings of a row, which detectors work, their noise, and the prior of its coordinates.

    `light` is of coordinates in standard deviations, the scale, about the mean.
    """

    readings: Array
    works: NDArray[np.bool_]
    noise: ReadingNoise
    scale: Array
    mean: Array
    light: Callable[[Array, Array, Array], tuple[Array, Array]]


class RowState(NamedTuple):
    """The posterior of a row at k coordinates, whose axis is the last of each part."""

    cost: Array
    at: Array
    gradient: Array
    hessian: Array
    light: Array


def evaluate(row: Row, at: Array) -> RowState:
    """Return the negative logarithm of the posterior, with its derivatives."""
    light, slopes = row.light(at.T, row.mean, row.scale)
    values, score, weight = log_likelihood(row.readings, light, row.noise)
    cost = 0.5 * (at**2).sum(axis=0) - (values * row.works).sum(axis=1)
    gradient = np.einsum("kn,knp->pk", score * row.works, slopes) - at
    weighed = slopes * (weight * row.works)[..., None]
    hessian = np.einsum("knp,knq->pqk", weighed, slopes) + np.eye(len(at))[..., None]
    return RowState(cost, at, gradient, hessian, light.T)


def propose(row: Row, state: RowState, damping: Array) -> tuple[Array, Array]:
    """Return the damped Gauss-Newton step from each place, and its decrement."""
    unit = np.eye(len(state.at))
    damped = np.moveaxis(state.hessian * (1 + damping * unit[..., None]), -1, 0)
    step = np.linalg.solve(damped, state.gradient.T[..., None])[..., 0].T
    # The bow stays off the zenith, where yaw has no meaning.
    trial = state.at + step
    legal = np.abs(row.mean[PITCH] + trial[PITCH] * row.scale[PITCH]) < LEAST_ABEAM
    trial = np.where(legal, trial, state.at)
    return trial, 0.5 * (step * state.gradient).sum(axis=0)


# refine(row, start): the states of the largest posteriors near the starts.
refine = minimiser(evaluate, propose, SETTLED, STEPS)
