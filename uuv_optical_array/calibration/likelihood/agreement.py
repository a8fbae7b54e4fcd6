"""How well the fit of a calibration agrees with its images."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from uuv_optical_array.calibration.likelihood.likelihood import (
    UNKNOWN_STD,
    CalibrationLikelihood,
    CalibrationState,
)
from uuv_optical_array.core.geometry import Array

FALSE_REFUSAL = 1e-6  # probability that a correct model is refused


@dataclass(frozen=True)
class Agreement:
    """Residuals of m images of n readings, and their statistics."""

    residuals: Array  # in standard deviations, (m, n)
    mean: Array  # of the readings by the fit, counts, (m, n)
    variance: Array  # of the readings, counts^2, (m, n)
    uncensored: NDArray[np.bool_]  # readings that are used and far from both limits, (m, n)
    misfit: float  # mean squared residual of these, 1 where the model explains the images
    freedoms: int  # degrees of freedom of these: readings less what was fitted to them, >= 0
    side: int  # of the array; an image of several lamps has several times as many readings

    def inflation(self) -> float:
        """Return the mean square of the images' mean residuals and tilts; 1 if independent.

        Each lamp has an image; tilts are first moments about its middle column and middle row.
        """
        across, down = np.meshgrid(*[np.arange(self.side) - (self.side - 1) / 2] * 2)
        modes = np.array([np.ones(self.side**2), across.ravel(), down.ravel()])
        images = -1, self.side**2
        residuals, uncensored = self.residuals.reshape(images), self.uncensored.reshape(images)
        return _over_independent(residuals, uncensored, modes, self.misfit)

    def pattern(self) -> float:
        """Return the mean square of detectors' mean residuals; 1 if independent, less if fitted."""
        ones = np.ones((1, len(self.uncensored)))
        return _over_independent(self.residuals.T, self.uncensored.T, ones, self.misfit)

    def spread(self, std: float) -> tuple[float, float]:
        """Return by how much, relative to the light, readings differ beyond noise; standard error.

        That is for a misfit of 1, 0 at least, and starts from that of the fit. ValueError where
        every reading may be censored.
        """
        variance, unit = self.variance[self.uncensored], self.mean[self.uncensored] ** 2
        if not len(variance):
            raise ValueError("noise: every reading is dark or saturated; record more light")
        square = self.residuals[self.uncensored] ** 2 * variance
        absorbed = self.misfit / float((square / variance).mean())  # by the degrees of freedom

        def excess(added: float) -> float:
            return float((absorbed * square / np.maximum(variance + added * unit, 1e-9)).mean()) - 1

        lowest = -(std**2)
        added = lowest
        if excess(lowest) > 0:
            most = absorbed * float((square / np.maximum(unit, 1e-9)).max()) + 1
            added = float(brentq(excess, lowest, most))
        found = float(np.sqrt(std**2 + added))
        each = unit / np.maximum(variance + added * unit, 1e-9)
        error = np.sqrt(2 / float((each**2).sum()))
        return found, float(error / (2 * max(found, 1e-9)))


def _over_independent(
    residuals: Array, uncensored: NDArray[np.bool_], modes: Array, misfit: float
) -> float:
    """Return the mean square of rows weighted by modes ``(k, n)``, relative to independent ones."""
    expected = uncensored @ (modes**2).T
    lit = expected > 0
    if not lit.any():
        return 1.0
    total = np.where(uncensored, residuals, 0.0) @ modes.T
    return float(np.mean(total[lit] ** 2 / expected[lit]) / max(misfit, 1e-12))


def agreement_of(
    likelihood: CalibrationLikelihood, state: CalibrationState, freedoms: int
) -> Agreement:
    """Compare a fit of `freedoms` numbers, besides the shifts of the poses, with the readings."""
    residuals = likelihood.residuals(state)
    uncensored = likelihood.used & likelihood.uncensored(state)
    number = int(uncensored.sum())
    share = number / max(1, int(likelihood.used.sum()))
    remaining = number - share * freedoms
    total = float((residuals[uncensored] ** 2).sum())
    if likelihood.pose_std is not None:
        # Shifts are residuals too, of poses that were recorded with this error.
        seen = np.unique(likelihood.places[uncensored.any(axis=1)])
        total += float(((state.at.shifts[seen] / likelihood.pose_std[seen]) ** 2).sum())
        # What was not known of them has been fitted to the readings.
        remaining -= share * int((likelihood.pose_std[seen] >= UNKNOWN_STD).sum())
    misfit = total / remaining if remaining > 0 else 1.0
    side = likelihood.scene.array.detectors_per_side
    return Agreement(
        residuals, state.mean, state.variance, uncensored, misfit, max(0, int(remaining)), side
    )
