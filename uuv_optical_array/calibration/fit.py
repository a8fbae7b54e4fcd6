"""The most probable lamp, water, background and gains, outliers left out, unknowns held."""

from collections.abc import Callable, Collection

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.optimize import brentq

from uuv_optical_array.calibration.likelihood import (
    BACKGROUND,
    GAINS,
    POWER,
    SIGMA,
    CalibrationLikelihood,
    K,
    State,
)
from uuv_optical_array.core.geometry import Array

MAX_ITERATIONS = 60
ARRIVED = 1e-5  # Newton decrement from which the next step is the last
MAX_STEP = 1.0  # of a logarithm
GIVE_UP = 1e10  # damping beyond which no step gains
OUTLIER = 5.0  # standard deviations; noise alone does it to one reading in two million
WHOLE_IMAGE = 0.25  # share of outliers among an image's readings from which none counts
ROUNDS = 10  # of leaving out outliers
RELEASES = 6  # of looking anew at what is known
HURTS = 2.0  # mean squared residual from which what is held is let go once, lest it be far off
# A standard error beyond these is no knowledge: a water type, or a look at the array in the dark,
# tells as much. Of the logarithms, 1/m, and of the full scale.
UNKNOWN = {POWER: 0.15, SIGMA: 0.15, K: 0.02, BACKGROUND: 0.02, GAINS: 0.15}
# What is held first where several mix: the power takes up what the others leave.
FIRST = (K, SIGMA, BACKGROUND, GAINS, POWER)
STILL = 10  # images from which a reading that never changes is a fault,
SWING_COUNTS = 20.0  # where it should have changed by this much


class CalibrationFit:
    """One fit by damped Gauss-Newton steps (Levenberg and Marquardt).

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
        Parameters that are known only as long as another, the value, is held.
    at_bound
        Parameters that would go beyond a bound.
    dead
        Detectors that were found to be at fault.
    outlying
        Images that were left out whole.
    residuals, fair
        Standard deviations; used readings that could hardly be censored, shape ``(m, n)``.
    misfit
        Mean squared residual of the fair ones.
    """

    def __init__(
        self,
        likelihood: CalibrationLikelihood,
        known: Collection[int],
        on_step: Callable[[], object],
    ) -> None:
        self.likelihood, self._on_step = likelihood, on_step
        self.start = likelihood.start()
        size = len(self.start)
        low, high = np.full((2, size), np.log(1e3))
        low[GAINS:] = -high[GAINS:]
        low[[POWER, K, BACKGROUND]], high[[POWER, K, BACKGROUND]] = [-50, 0, 0], [50, 10, 1e6]
        low[SIGMA], high[SIGMA] = np.log([0.1, 90])
        self._low, self._high = low, high
        self._limits = np.full(size, UNKNOWN[GAINS])
        self._limits[:GAINS] = [UNKNOWN[i] for i in range(GAINS)]
        self._limits[BACKGROUND] *= likelihood.scene.full_scale_counts
        self.known, self.unknown = frozenset(known), frozenset[int]()
        self.mixed: dict[int, int] = {}
        self.at_bound: frozenset[int] = frozenset()
        self.outlying: tuple[int, ...] = ()
        self.misfit = 1.0
        self.state = likelihood.at(self.start, np.zeros(likelihood.poses.shape), expected=True)
        self.dead = self._dead()
        # A lamp that starts far too dim or too bright would hide what can be known.
        self.unknown = frozenset(range(size)) - self._given() - {POWER, SIGMA, BACKGROUND}
        state = self._climb(self.start, self.state.shifts)
        self.state = likelihood.at(state.parameters, state.shifts, expected=True)
        self.unknown = self._not_told(1.0)
        released = False
        for _ in range(RELEASES):
            self._fit()
            # Without the misfit, which is large while what could be known is held far off.
            before, self.unknown = self.unknown, self._not_told(1.0)
            if self.unknown == before:
                if released or not before or self.misfit < HURTS:
                    break
                self.unknown, released = frozenset(), True
        if more := self._not_told(max(1.0, self.misfit)) - self.unknown:
            self.unknown |= more
            self._fit()

    def _dead(self) -> tuple[int, ...]:
        """Find detectors whose reading never changes where it should, and leave them out."""
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

    def _basis(self, held: Collection[int]) -> Array:
        """Return the directions that the fit may take, shape ``(p, q)``: the gauge is not one."""
        size = len(self.start)
        lamp = [i for i in range(GAINS) if i not in held]
        gains = [i for i in range(GAINS, size) if i not in held]
        across = null_space(np.ones((1, len(gains)))) if gains else np.zeros((0, 0))
        basis = np.zeros((size, len(lamp) + across.shape[1]))
        basis[lamp, np.arange(len(lamp))] = 1.0
        basis[gains, len(lamp) :] = across
        return basis

    def covariance(self, held: Collection[int] | None = None) -> Array:
        """Return the inverse information, shape ``(p, p)``: 0 where held, huge where unknown."""
        basis = self._basis(self.held() if held is None else held)
        reduced = basis.T @ self.state.information @ basis
        if not len(reduced):
            return np.zeros((len(basis), len(basis)))
        # In units of the limits, so that rounding is judged alike for all.
        unit = np.sqrt((basis**2).T @ self._limits**2)
        values, vectors = np.linalg.eigh(reduced * np.outer(unit, unit))
        inverse = 1 / np.maximum(values, 1e-12 * max(1.0, values[-1]))
        vectors = basis @ (vectors * unit[:, None])
        return (vectors * inverse) @ vectors.T

    def _not_told(self, scale: float) -> frozenset[int]:
        """Return what the images do not tell, so that the rest is known once it is held.

        The variances of the fit count `scale` times.
        """
        self.mixed = {}
        given = self._given()
        unknown: set[int] = set()
        own = np.diag(self.state.information) * self._limits**2
        while True:
            std = np.sqrt(scale * np.diag(self.covariance(given | unknown)))
            over = np.flatnonzero(std > self._limits).tolist()
            if not over:
                self.mixed = {i: with_ for i, with_ in self.mixed.items() if i not in unknown}
                return frozenset(unknown)
            # Detectors without light come before what mixes with all of them.
            chosen = [i for i in over if i >= GAINS and own[i] < scale]
            if not chosen:
                first = next(i for i in FIRST if i in (min(j, GAINS) for j in over))
                chosen = [i for i in over if min(i, GAINS) == first]
                for i in over:
                    self.mixed.setdefault(i, first)
            unknown.update(chosen)

    def _fit(self) -> None:
        """Fit, and leave outliers out, until the same ones stay out."""
        likelihood = self.likelihood
        works = np.broadcast_to(~likelihood.faulty, likelihood.used.shape)
        parameters, held = self.state.parameters.copy(), list(self.held())
        parameters[held] = self.start[held]
        shifts = np.zeros(likelihood.poses.shape)
        for _ in range(ROUNDS):
            state = self._climb(parameters, shifts)
            parameters, shifts = state.parameters, state.shifts
            residuals = likelihood.residuals(state)
            sound = likelihood.inside(state) & works
            scale = 1.4826 * np.median(np.abs(residuals[sound])) if sound.any() else 1.0
            good = works & (np.abs(residuals) <= OUTLIER * max(1.0, scale))
            lost = (works & ~good).sum(axis=1) > WHOLE_IMAGE * works.sum(axis=1)
            if likelihood.pose_std is not None:
                lost |= (np.abs(shifts) > OUTLIER * likelihood.pose_std).any(axis=1)
            good[lost] = False
            if not good.any():
                break
            self.outlying = tuple(np.flatnonzero(lost).tolist())
            if (good == likelihood.used).all():
                break
            likelihood.used = good
        self.state = likelihood.at(parameters, shifts, expected=True)
        self._look()

    def _climb(self, parameters: Array, shifts: Array) -> State:
        """Climb to the most probable parameters."""
        state, damping, held = self.likelihood.at(parameters, shifts), 1e-3, self.held()
        for _ in range(MAX_ITERATIONS):
            self._on_step()
            at, slope = state.parameters, state.gradient
            outward = ((at <= self._low) & (slope < 0)) | ((at >= self._high) & (slope > 0))
            self.at_bound = frozenset(np.flatnonzero(outward).tolist()) - held
            basis = self._basis(held | self.at_bound)
            if not basis.shape[1]:
                return state
            reduced = basis.T @ state.information @ basis
            diagonal = np.diag(reduced)
            reduced += np.diag(damping * diagonal + 1e-12 * max(diagonal.max(), 1e-12))
            step = basis @ np.linalg.solve(reduced, basis.T @ slope)
            # A heavily damped step is short wherever it is taken, so it proves nothing.
            last = 0.5 * slope @ step < ARRIVED and damping < 1e-1
            step /= max(1.0, np.abs(np.delete(step, [K, BACKGROUND])).max() / MAX_STEP)
            trial, moved = np.clip(at + step, self._low, self._high), state.shifts
            if state.shift_step.size:
                moved = moved + state.shift_step + state.shift_by_parameters @ (trial - at)
            new = self.likelihood.at(trial, moved)
            better = new.value > state.value
            state = new if better else state
            if last or damping > GIVE_UP:
                break
            damping = max(damping * 0.1, 1e-12) if better else damping * 10
        return state

    def _look(self) -> None:
        """Compare the fit with the readings."""
        likelihood = self.likelihood
        self.residuals = likelihood.residuals(self.state)
        self.fair: NDArray[np.bool_] = likelihood.used & likelihood.inside(self.state)
        number = int(self.fair.sum())
        share = number / max(1, int(likelihood.used.sum()))
        left = number - share * self._basis(self.held()).shape[1]
        total = float((self.residuals[self.fair] ** 2).sum())
        if likelihood.pose_std is not None:
            # Shifts are residuals too, of poses that were recorded with this error.
            seen = self.fair.any(axis=1)
            total += float(((self.state.shifts[seen] / likelihood.pose_std) ** 2).sum())
        self.misfit = total / left if left > 0 else 1.0

    def together(self) -> float:
        """Return the squared mean residual of an image over that of independent ones."""
        number = self.fair.sum(axis=1)
        seen = number > 0
        if not seen.any():
            return 1.0
        total = np.where(self.fair, self.residuals, 0.0).sum(axis=1)[seen]
        return float(np.mean(total**2 / number[seen]) / max(self.misfit, 1e-12))

    def noise(self, sigma_counts: float) -> tuple[float, float]:
        """Return the sensor noise for which the misfit would be 1, and its standard error.

        Parameters
        ----------
        sigma_counts
            The sensor noise of the scene, counts.

        Raises
        ------
        ValueError
            Where every reading may be censored.
        """
        variance = self.state.variance[self.fair]
        if not len(variance):
            raise ValueError("noise: every reading is dark or saturated; record more light")
        square = self.residuals[self.fair] ** 2 * variance
        lost = self.misfit / float((square / variance).mean())  # to the fit

        def excess(more: float) -> float:
            return float((lost * square / np.maximum(variance + more, 1e-9)).mean()) - 1

        least = -(sigma_counts**2)
        more = least
        if excess(least) > 0:
            more = float(brentq(excess, least, lost * float(square.max()) + 1))
        sigma = float(np.sqrt(sigma_counts**2 + more))
        error = np.sqrt(2 / float((np.maximum(variance + more, 1e-9) ** -2.0).sum()))
        return sigma, float(error / (2 * max(sigma, 1e-9)))
