"""Damped Gauss-Newton steps of a calibration, with bounds and with some parameters held."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from uuv_optical_array.calibration.likelihood import (
    CalibrationLikelihood,
    CalibrationState,
    Unknowns,
)
from uuv_optical_array.calibration.parameters import Layout
from uuv_optical_array.core.numerics.gauss_newton import minimiser

MAX_STEPS = 500  # where gains and response make up for each other, a long bent valley
CONVERGED = 1e-5  # decrement of the negative log-likelihood from which a step is the last
MAX_STEP = 1.0  # of a logarithm
REGULARISATION = 1e-12  # added to the information, relative to its largest


class CalibrationProblem(NamedTuple):
    """A likelihood, the parameters that are held, and what to call at every step."""

    likelihood: CalibrationLikelihood
    held: frozenset[int]
    on_step: Callable[[], object]


def outward(layout: Layout, state: CalibrationState) -> frozenset[int]:
    """Return the parameters at a bound whose gradient points beyond it."""
    values, slope = state.at.parameters, state.gradient
    beyond = ((values <= layout.low) & (slope < 0)) | ((values >= layout.high) & (slope > 0))
    return frozenset(np.flatnonzero(beyond).tolist())


def evaluate(problem: CalibrationProblem, at: Unknowns) -> CalibrationState:
    """Return the likelihood with its derivatives."""
    return problem.likelihood.evaluate(at)


def propose(
    problem: CalibrationProblem, state: CalibrationState, damping: float
) -> tuple[Unknowns, float]:
    """Return the damped Gauss-Newton step from a state, and its decrement."""
    problem.on_step()
    (values, shifts), layout = state.at, problem.likelihood.layout
    basis = layout.free_directions(problem.held | outward(layout, state))
    reduced = basis.T @ state.information @ basis
    diagonal = np.diag(reduced)
    smallest = REGULARISATION * np.max(diagonal, initial=REGULARISATION)
    reduced = reduced + np.diag(damping * diagonal + smallest)
    step = basis @ np.linalg.solve(reduced, basis.T @ state.gradient)
    decrement = 0.5 * float(state.gradient @ step) + state.shift_decrement
    step /= max(1.0, np.abs(step[layout.logarithm]).max() / MAX_STEP)
    trial = np.clip(values + step, layout.low, layout.high)
    if state.shift_step.size:
        shifts = shifts + state.shift_step + state.shift_by_parameters @ (trial - values)
    return Unknowns(trial, shifts), decrement


# refine(problem, start): the state of the largest likelihood near the start.
refine = minimiser(evaluate, propose, CONVERGED, MAX_STEPS)
