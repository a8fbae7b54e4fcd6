"""The most probable parameters of a calibration, with bounds and with some of them held."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from uuv_optical_array.calibration.maximum_likelihood.likelihood import (
    CalibrationLikelihood,
    CalibrationState,
    Place,
)
from uuv_optical_array.calibration.parameters import bounds, directions, is_logarithm
from uuv_optical_array.core.numerics.gauss_newton import minimiser

MOST_STEPS = 60
ARRIVED = 1e-5  # decrement of the negative log-likelihood from which a step is the last
MAX_STEP = 1.0  # of a logarithm
NEGLIGIBLE = 1e-12  # what is added to the information, of its largest


class CalibrationProblem(NamedTuple):
    """A likelihood to be made as large as it can be.

    Parameters
    ----------
    likelihood
        Of the images.
    held
        Parameters that stay where they are.
    on_step
        Called at every step, to show that it goes on.
    """

    likelihood: CalibrationLikelihood
    held: frozenset[int]
    on_step: Callable[[], object]


def outward(state: CalibrationState) -> frozenset[int]:
    """Return the parameters that are at a bound and would go beyond it."""
    values, slope = state.at.parameters, state.gradient
    low, high = bounds(len(values))
    beyond = ((values <= low) & (slope < 0)) | ((values >= high) & (slope > 0))
    return frozenset(np.flatnonzero(beyond).tolist())


def evaluate(problem: CalibrationProblem, at: Place) -> CalibrationState:
    """Return the likelihood at a place, with derivatives."""
    return problem.likelihood.evaluate(at)


def propose(
    problem: CalibrationProblem, state: CalibrationState, damping: float
) -> tuple[Place, float]:
    """Return the damped Gauss-Newton step from a state, and its decrement."""
    problem.on_step()
    values, shifts = state.at
    size = len(values)
    basis = directions(problem.held | outward(state), size)
    reduced = basis.T @ state.information @ basis
    diagonal = np.diag(reduced)
    least = NEGLIGIBLE * np.max(diagonal, initial=NEGLIGIBLE)
    reduced = reduced + np.diag(damping * diagonal + least)
    step = basis @ np.linalg.solve(reduced, basis.T @ state.gradient)
    decrement = 0.5 * float(state.gradient @ step) + state.shift_decrement
    step /= max(1.0, np.abs(step[is_logarithm(size)]).max() / MAX_STEP)
    trial = np.clip(values + step, *bounds(size))
    if state.shift_step.size:
        shifts = shifts + state.shift_step + state.shift_by_parameters @ (trial - values)
    return Place(trial, shifts), decrement


# Moves a place to where the likelihood is largest nearby.
refine = minimiser(evaluate, propose, ARRIVED, MOST_STEPS)
