"""What an image leaves possible: mean and covariance of the pose about its best fit."""

import numpy as np
from scipy.special import chdtri, ndtri
from scipy.stats import qmc

from uuv_optical_array.fit import Fit, ImageFit
from uuv_optical_array.pose import Array

# How far the log-posterior may be from the quadratic one at the cubature points.
TOLERANCE = 0.5
POINTS = 128
FREEDOM = 5.0  # of the Student distribution that is sampled: tails heavier than the posterior's
STRETCH = 1.2
# Effective sample size below which the sample missed the posterior, and the Gaussian stands.
LEAST_SAMPLE = 12.0


class Posterior:
    """Moments of the pose given an image.

    In the chart the posterior is nearly Gaussian, and the cubature points (I. Arasaratnam and
    S. Haykin, 2009) carry it to the pose with the bend of the valley. Where the log-posterior at
    these points is not the quadratic one, such as at the edge where a detector turns away from
    the lamp, importance sampling on a fixed low-discrepancy set takes over.

    Parameters
    ----------
    image_fit
        What made the fits.
    """

    def __init__(self, image_fit: ImageFit) -> None:
        self._fit = image_fit
        size = 5 + len(image_fit.names)
        self._cubature = np.sqrt(size) * np.concatenate([np.eye(size), -np.eye(size)])
        # Centred in their cells, so that no point lies at infinity.
        uniform = qmc.Sobol(size + 1, scramble=False).random(POINTS) + 0.5 / POINTS
        scale = np.sqrt(chdtri(FREEDOM, uniform[:, -1]) / FREEDOM)
        student = ndtri(uniform[:, :-1]) / scale[:, None]
        self._student = STRETCH * student
        self._log_density = -0.5 * (FREEDOM + size) * np.log1p((student**2).sum(axis=1) / FREEDOM)

    @np.errstate(under="ignore")  # of points that weigh nothing
    def moments(self, readings: Array, fit: Fit, roll: float = 0.0) -> tuple[Array, Array]:
        """Mean and covariance of the pose.

        Parameters
        ----------
        readings
            Counts, shape ``(n,)``.
        fit
            The best fit to them.
        roll
            Roll of the follower, rad.

        Returns
        -------
        mean : Array
            m and rad, shape ``(5,)``.
        covariance : Array
            Shape ``(5, 5)``, positive definite.

        Raises
        ------
        numpy.linalg.LinAlgError
            Where the information is not positive definite.
        """
        centre = fit.coordinates
        covariance: Array = np.asarray(np.linalg.inv(fit.information), dtype=np.float64)
        poses, cost = self._at(self._cubature, readings, centre, covariance, roll)[1:]
        gaussian = _moments(poses, np.full(len(poses), 1 / len(poses)))
        if np.abs(cost - fit.cost - 0.5 * len(centre)).max() <= TOLERANCE:
            return gaussian
        for _ in range(2):  # the second time about the moments that the first one found
            points, poses, cost = self._at(self._student, readings, centre, covariance, roll)
            log_weights = -cost - self._log_density
            weights = np.exp(log_weights - log_weights.max())
            weights /= weights.sum()
            if 1 / (weights @ weights) < LEAST_SAMPLE:
                return gaussian
            centre, covariance = _moments(points, weights)
        return _moments(poses, weights)

    def _at(
        self, standard: Array, readings: Array, centre: Array, covariance: Array, roll: float
    ) -> tuple[Array, Array, Array]:
        """Return points about a centre, with their poses and negative log-posteriors."""
        points = centre + standard @ np.linalg.cholesky(covariance).T
        return points, *self._fit.cost(readings, points, roll)


def _moments(values: Array, weights: Array) -> tuple[Array, Array]:
    mean = weights @ values
    off = values - mean
    return mean, (off.T * weights) @ off
