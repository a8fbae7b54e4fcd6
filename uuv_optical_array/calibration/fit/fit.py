"""The fit of a calibration: bounded Gauss-Newton steps, outliers out, undetermined ones held."""

import itertools
from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.fit.identifiability import covariance, held_shifts, undetermined
from uuv_optical_array.calibration.likelihood.agreement import Agreement, agreement_of
from uuv_optical_array.calibration.likelihood.likelihood import (
    CalibrationLikelihood,
    CalibrationState,
    Unknowns,
)
from uuv_optical_array.calibration.likelihood.parameters import (
    BACKGROUND,
    LAMP_FLOOR,
    POWER,
    SHAPE,
    SHARE,
    SIGMA,
    WIDE,
    Layout,
)
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.gauss_newton import minimiser

OUTLIER = 5.0  # standard deviations; noise alone exceeds it once in two million readings
OUTLYING_IMAGE = 0.25  # share of outliers among an image's readings from which none is used
OUTLIER_ROUNDS = 10
FREE_ROUNDS = 3  # of finding what is determined, in which a held parameter may be released
POOR_MISFIT = 2.0  # mean squared residual from which held parameters are released once
# Relative change of what the shape of the beam leaves, and its size, at which it is found.
SHAPE_STEADY, LEAST_SHAPE = 0.02, 1e-3
MOST_SHAPE = 0.1  # in the fit; a wrong model would attribute everything to the beam
CONSTANT_IMAGES = 10  # a reading that is the same in so many images is a fault,
EXPECTED_CHANGE_COUNTS = 20.0  # where it should have changed by this much
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


class CalibrationFit:
    """The most probable parameters, and which of them the images determine."""

    agreement: Agreement
    at_bound: frozenset[int]  # parameters whose likelihood grows beyond a bound

    def __init__(
        self,
        likelihood: CalibrationLikelihood,
        known: Collection[int],
        on_step: Callable[[], object],
    ) -> None:
        # Faulty detectors and used readings of the likelihood are updated.
        self.likelihood, self._on_step, self._layout = likelihood, on_step, likelihood.layout
        self.start = likelihood.start()
        # Parameters that are held: those given, and those that the images do not determine.
        self.known, self.unknown = frozenset(known), frozenset[int]()
        # Whether the shape of the beam is fitted, and how far its light differs from every shape.
        self.shaped = WIDE not in self.known
        self.shape_error = np.nan
        self.correlated: dict[int, int] = {}  # determined only while another, the value, is held
        self.outlying_images: tuple[int, ...] = ()  # that are not used
        start = likelihood.unshifted(self.start)
        self.state = likelihood.evaluate(start, expected=True)
        self.dead = self._exclude_dead_detectors()  # whose reading never changes
        # From a lamp far too dim, or of another beam, nothing would seem to be determined.
        others = ~np.isin(self._layout.kinds, [POWER, SIGMA, BACKGROUND, *SHAPE, SHARE, LAMP_FLOOR])
        self.unknown = frozenset(np.flatnonzero(others).tolist()) - self._given()
        self.state = likelihood.evaluate(self._refined(start).at, expected=True)
        self.unknown = self._undetermined()
        self._fit_determined()

    def _fit_determined(self) -> None:
        """Fit until the parameters determined at the fit are those that were fitted."""
        released = False
        for rounds in itertools.count():
            self._fit()
            if self.likelihood.shape_std >= MOST_SHAPE:
                return  # the model is wrong
            # Without the misfit, which a parameter that is held at a wrong value makes large. What
            # is determined in some rounds only stays held in the end.
            before = self.unknown
            self.unknown = self._undetermined(keep=before if rounds >= FREE_ROUNDS else ())
            if self.unknown == before:
                if released or not before or self.agreement.misfit < POOR_MISFIT:
                    break
                self.unknown, released = frozenset(), True
        if more := self._undetermined(max(1.0, self.agreement.misfit)) - self.unknown:
            self.unknown |= more
            self._fit()

    def _exclude_dead_detectors(self) -> tuple[int, ...]:
        """Exclude detectors whose reading never changes though it should."""
        likelihood, lamps = self.likelihood, max(1, len(self._layout.own))
        expected = np.clip(self.state.mean, likelihood.noise.low, likelihood.noise.high)
        changes, should_change = (
            np.ptp(values, axis=0).reshape(lamps, -1).max(axis=0)
            for values in (likelihood.readings, expected)
        )
        constant = changes == 0
        dead = constant & (should_change > EXPECTED_CHANGE_COUNTS) & ~likelihood.faulty
        if len(likelihood.readings) < CONSTANT_IMAGES or constant.all():
            dead[:] = False
        likelihood.faulty |= dead
        likelihood.used &= likelihood.works
        return tuple(np.flatnonzero(dead).tolist())

    def _given(self) -> frozenset[int]:
        """Return the parameters that need no fit: those known, and gains of faulty detectors."""
        gains = self._layout.gains + np.flatnonzero(self.likelihood.faulty)
        return self.known | frozenset(gains.tolist())

    def held(self) -> frozenset[int]:
        """Return the parameters that do not move."""
        return self._given() | self.unknown

    def covariance(self, misfit: float) -> Array:
        """Return the covariance of the parameters, shape ``(p, p)``.

        It is the inverse information times the misfit, and the effect of the unknown parameters.
        """
        layout, information = self._layout, self.state.information
        own = covariance(layout, information, self.held())
        shifts = held_shifts(layout, information, own, self.unknown)
        return misfit * own + shifts @ shifts.T

    def _undetermined(self, misfit: float = 1.0, keep: Collection[int] = ()) -> frozenset[int]:
        """Return what the images do not determine, or is to `keep`; note what correlates."""
        unknown, self.correlated = undetermined(
            self._layout, self.state.information, self._given(), misfit, keep
        )
        return unknown

    def _refined(self, at: Unknowns) -> CalibrationState:
        problem = CalibrationProblem(self.likelihood, self.held(), self._on_step)
        state: CalibrationState = refine(problem, at)
        return state

    def _fit(self) -> None:
        """Fit and leave out outliers until the same ones stay out."""
        likelihood, held = self.likelihood, list(self.held())
        parameters = self.state.at.parameters.copy()
        parameters[held] = self.start[held]
        at = likelihood.unshifted(parameters)
        for _ in range(OUTLIER_ROUNDS):
            state = self._refined(at)
            at = state.at
            good, bad_images = self._without_outliers(state)
            if not good.any():
                break
            self.outlying_images = tuple(np.flatnonzero(bad_images).tolist())
            if self._widened(state) and (good == likelihood.used).all():
                break
            likelihood.used = good
        self.state = likelihood.evaluate(at, expected=True)
        self.at_bound = outward(self._layout, self.state) - self.held()
        self.agreement = agreement_of(likelihood, self.state, self._freedoms())

    def _widened(self, state: CalibrationState) -> bool:
        """Find what the shape of the beam leaves; return whether it is what it was."""
        before = self.likelihood.shape_std
        agreement = agreement_of(self.likelihood, state, self._freedoms())
        if not (self.shaped and agreement.uncensored.any()):
            return True
        left, self.shape_error = agreement.spread(before)
        self.likelihood.widen(min(left, MOST_SHAPE))
        change = abs(self.likelihood.shape_std - before)
        return change <= SHAPE_STEADY * max(before, LEAST_SHAPE)

    def _freedoms(self) -> int:
        return self._layout.free_directions(self.held()).shape[1]

    def _without_outliers(
        self, state: CalibrationState
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which readings are no outliers, ``(m, n)``, and which images are, ``(m,)``."""
        likelihood = self.likelihood
        works = np.broadcast_to(likelihood.works, likelihood.used.shape)
        residuals = likelihood.residuals(state)
        uncensored = likelihood.uncensored(state) & works
        # Where the model is poor, outliers are judged by the actual spread of the residuals.
        spread = 1.4826 * np.median(np.abs(residuals[uncensored])) if uncensored.any() else 1.0
        good = works & (np.abs(residuals) <= OUTLIER * max(1.0, spread))
        bad_images = (works & ~good).sum(axis=1) > OUTLYING_IMAGE * works.sum(axis=1)
        if likelihood.pose_std is not None:
            far = np.abs(state.at.shifts) > OUTLIER * likelihood.pose_std
            bad_images |= far[likelihood.places].any(axis=1)
        good[bad_images] = False
        return good, bad_images
