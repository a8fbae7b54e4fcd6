"""How well the fit of a calibration agrees with its images."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from uuv_optical_array.calibration.maximum_likelihood.likelihood import (
    CalibrationLikelihood,
    CalibrationState,
)
from uuv_optical_array.core.geometry import Array


@dataclass(frozen=True)
class Agreement:
    """Residuals of m images of n detectors, and what they say.

    Parameters
    ----------
    residuals
        Standard deviations, shape ``(m, n)``.
    variance
        Of the readings, counts^2, shape ``(m, n)``.
    fair
        Used readings that could hardly be censored, shape ``(m, n)``.
    misfit
        Mean squared residual of these, 1 where the model explains the images.
    freedoms
        Degrees of freedom of these: readings less what was fitted to them, 0 or more.
    """

    residuals: Array
    variance: Array
    fair: NDArray[np.bool_]
    misfit: float
    freedoms: int

    def inflation(self) -> float:
        """Return the mean square of the images' mean and tilts, over that of independent residuals.

        An image's tilts are its residuals' moments about the middle column and the middle row. It
        is 1 where the residuals of an image are independent.
        """
        side = math.isqrt(self.fair.shape[1])
        across, down = np.meshgrid(*[np.arange(side) - (side - 1) / 2] * 2)
        modes = np.array([np.ones(side * side), across.ravel(), down.ravel()])
        return self._over_independent(modes)

    def pattern(self) -> float:
        """Return the mean square of the detectors' mean residuals, over that of independent ones.

        It is 1 where the residuals of a detector are independent, below where its gain was fitted.
        """
        fair, residuals = self.fair.T, self.residuals.T
        turned = dataclasses.replace(self, residuals=residuals, fair=fair)
        return turned._over_independent(np.ones((1, len(self.fair))))

    def _over_independent(self, modes: Array) -> float:
        """Return the mean square of the sums of each row weighted by modes, shape ``(k, n)``."""
        expected = self.fair @ (modes**2).T
        seen = expected > 0
        if not seen.any():
            return 1.0
        total = np.where(self.fair, self.residuals, 0.0) @ modes.T
        return float(np.mean(total[seen] ** 2 / expected[seen]) / max(self.misfit, 1e-12))

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
        variance = self.variance[self.fair]
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


def agreement_of(
    likelihood: CalibrationLikelihood, state: CalibrationState, freedoms: int
) -> Agreement:
    """Compare a fit with the readings.

    Parameters
    ----------
    likelihood
        Of the images.
    state
        The fit.
    freedoms
        How many numbers were fitted, besides the shifts of the poses.
    """
    residuals = likelihood.residuals(state)
    fair = likelihood.used & likelihood.inside(state)
    number = int(fair.sum())
    share = number / max(1, int(likelihood.used.sum()))
    left = number - share * freedoms
    total = float((residuals[fair] ** 2).sum())
    if likelihood.pose_std is not None:
        # Shifts are residuals too, of poses that were recorded with this error.
        seen = fair.any(axis=1)
        total += float(((state.at.shifts[seen] / likelihood.pose_std) ** 2).sum())
    misfit = total / left if left > 0 else 1.0
    return Agreement(residuals, state.variance, fair, misfit, max(0, int(left)))
