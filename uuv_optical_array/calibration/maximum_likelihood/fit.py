"""The most probable lamp, water, background and gains, outliers left out, unknowns held."""

from collections.abc import Callable, Collection

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.maximum_likelihood.agreement import Agreement, agreement_of
from uuv_optical_array.calibration.maximum_likelihood.identifiability import (
    carried,
    covariance,
    largest_errors,
    undetermined,
)
from uuv_optical_array.calibration.maximum_likelihood.likelihood import (
    CalibrationLikelihood,
    CalibrationState,
    Place,
)
from uuv_optical_array.calibration.maximum_likelihood.solver import (
    CalibrationProblem,
    outward,
    refine,
)
from uuv_optical_array.calibration.parameters import (
    BACKGROUND,
    GAINS,
    POWER,
    SIGMA,
    directions,
)
from uuv_optical_array.core.geometry import Array

OUTLIER = 5.0  # standard deviations; noise alone does it to one reading in two million
WHOLE_IMAGE = 0.25  # share of outliers among an image's readings from which none counts
ROUNDS = 10  # of leaving out outliers
RELEASES = 6  # of looking anew at what is known
POOR = 2.0  # mean squared residual from which what is held is released once
STILL = 10  # images from which a reading that never changes is a fault,
SWING_COUNTS = 20.0  # where it should have changed by this much


class CalibrationFit:
    """One fit.

    Parameters
    ----------
    likelihood
        Of the images; its faulty detectors and used readings are brought up to date.
    known
        Parameters that are held where they start.
    on_step
        Called at every step, to show that it goes on.

    Attributes
    ----------
    start
        Parameters of the scene, shape ``(p,)``.
    state
        The fit, with Fisher's information.
    known, unknown
        Parameters that were held: those given, and those that the images do not tell.
    mixed
        Parameters that are known only as long as another, the value, is held, or held with it.
    at_bound
        Parameters that would go beyond a bound.
    dead
        Detectors that were found to be at fault.
    outlying
        Images that were left out whole.
    agreement
        Of the fit with the readings.
    """

    agreement: Agreement
    at_bound: frozenset[int]

    def __init__(
        self,
        likelihood: CalibrationLikelihood,
        known: Collection[int],
        on_step: Callable[[], object],
    ) -> None:
        self.likelihood, self._on_step = likelihood, on_step
        self.start = likelihood.start()
        size = len(self.start)
        self._largest = largest_errors(size, likelihood.scene.full_scale_counts)
        self.known, self.unknown = frozenset(known), frozenset[int]()
        self.mixed: dict[int, int] = {}
        self.outlying: tuple[int, ...] = ()
        start = Place(self.start, np.zeros(likelihood.poses.shape))
        self.state = likelihood.evaluate(start, expected=True)
        self.dead = self._leave_out_the_dead()
        # A lamp that starts far too dim or too bright would hide what can be known.
        self.unknown = frozenset(range(size)) - self._given() - {POWER, SIGMA, BACKGROUND}
        self.state = likelihood.evaluate(self._refined(start).at, expected=True)
        self.unknown = self._not_told()
        self._fit_what_is_told()

    def _fit_what_is_told(self) -> None:
        """Fit, until what the images tell at the fit is what was fitted."""
        released = False
        for _ in range(RELEASES):
            self._fit()
            # Without the misfit, which is large while what could be known is held far off.
            before, self.unknown = self.unknown, self._not_told()
            if self.unknown == before:
                if released or not before or self.agreement.misfit < POOR:
                    break
                self.unknown, released = frozenset(), True
        if more := self._not_told(max(1.0, self.agreement.misfit)) - self.unknown:
            self.unknown |= more
            self._fit()

    def _leave_out_the_dead(self) -> tuple[int, ...]:
        """Leave out detectors whose reading never changes where it should."""
        likelihood = self.likelihood
        still = np.ptp(likelihood.readings, axis=0) == 0
        expected = np.clip(self.state.mean, likelihood.noise.low, likelihood.noise.high)
        odd = still & (np.ptp(expected, axis=0) > SWING_COUNTS) & ~likelihood.faulty
        if len(likelihood.readings) < STILL or still.all():
            odd[:] = False
        likelihood.faulty |= odd
        likelihood.used[:, likelihood.faulty] = False
        return tuple(np.flatnonzero(odd).tolist())

    def _given(self) -> frozenset[int]:
        """Return the parameters that need no fit: those known, and gains of faulty detectors."""
        return self.known | frozenset((GAINS + np.flatnonzero(self.likelihood.faulty)).tolist())

    def held(self) -> frozenset[int]:
        """Return the parameters that do not move."""
        return self._given() | self.unknown

    def covariance(self, misfit: float = 1.0) -> Array:
        """Return the covariance of the parameters, shape ``(p, p)``.

        It is the inverse information, of which the misfit is a factor, and what the parameters
        that are held because they are not known bring to the others.
        """
        own = covariance(self.state.information, self.held(), self._largest)
        moves = carried(self.state.information, own, self.unknown, self._largest)
        return misfit * own + moves @ moves.T

    def _not_told(self, misfit: float = 1.0) -> frozenset[int]:
        """Return what the images do not tell, and note what mixes with it."""
        unknown, self.mixed = undetermined(
            self.state.information, self._given(), self._largest, misfit
        )
        return unknown

    def _refined(self, at: Place) -> CalibrationState:
        """Return the most probable place near one."""
        problem = CalibrationProblem(self.likelihood, self.held(), self._on_step)
        state: CalibrationState = refine(problem, at)
        return state

    def _fit(self) -> None:
        """Fit, and leave outliers out, until the same ones stay out."""
        likelihood, held = self.likelihood, list(self.held())
        parameters = self.state.at.parameters.copy()
        parameters[held] = self.start[held]
        at = Place(parameters, np.zeros(likelihood.poses.shape))
        for _ in range(ROUNDS):
            state = self._refined(at)
            at = state.at
            good, lost = self._judged(state)
            if not good.any():
                break
            self.outlying = tuple(np.flatnonzero(lost).tolist())
            if (good == likelihood.used).all():
                break
            likelihood.used = good
        self.state = likelihood.evaluate(at, expected=True)
        self.at_bound = outward(self.state) - self.held()
        freedoms = directions(self.held(), len(parameters)).shape[1]
        self.agreement = agreement_of(likelihood, self.state, freedoms)

    def _judged(self, state: CalibrationState) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which readings are no outliers, ``(m, n)``, and which images are, ``(m,)``."""
        likelihood = self.likelihood
        works = np.broadcast_to(~likelihood.faulty, likelihood.used.shape)
        residuals = likelihood.residuals(state)
        sound = likelihood.inside(state) & works
        # Where the model is poor, of the spread that there is.
        spread = 1.4826 * np.median(np.abs(residuals[sound])) if sound.any() else 1.0
        good = works & (np.abs(residuals) <= OUTLIER * max(1.0, spread))
        lost = (works & ~good).sum(axis=1) > WHOLE_IMAGE * works.sum(axis=1)
        if likelihood.pose_std is not None:
            lost |= (np.abs(state.at.shifts) > OUTLIER * likelihood.pose_std).any(axis=1)
        good[lost] = False
        return good, lost
