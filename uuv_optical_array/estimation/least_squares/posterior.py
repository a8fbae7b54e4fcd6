"""What an image leaves possible: mean and covariance of the pose."""

import numpy as np
from scipy.optimize import minimize
from scipy.special import chdtri, logsumexp, ndtri
from scipy.stats import qmc

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.mcmc import Chains
from uuv_optical_array.estimation.least_squares.solver import Fit, ImageFit

# How far the log-posterior may be from the quadratic one at the cubature points.
TOLERANCE = 0.2
FREEDOM = 5.0  # of the Student distributions that are sampled: tails heavier than the posterior's
# Of importance sampling about one minimum, and where its tails are heavy; with nuisances for both.
POINTS, TAIL_POINTS, NUISANCE_POINTS = 256, 1024, 2048
# Log-posterior above the quadratic one at a cubature point that makes a tail heavy.
HEAVY = 0.3
MOST_TILT = 2.0
# Points' worth of covariance that so few points miss: one by the mean they share, the rest as
# measured against posteriors of 8,192 points.
MISSED = 2.0
# Share of the points that must count, in effect: for that sampling to be done in one round, and
# to be trusted after a second one.
DONE, TRUSTED = 0.6, 0.3
# Minima that are this much less probable, as a logarithm, leave no trace.
NEGLIGIBLE = 12.0


class Posterior:
    """Moments of the pose given an image; the prior is flat in the pose but for the scene's.

    Three ways, each for what the one before cannot do. In the chart most posteriors are nearly
    Gaussian, and the cubature points (I. Arasaratnam and S. Haykin, 2009) carry them to the pose
    with the bend of the valley. Importance sampling knows a somewhat bent posterior. `Chains`
    know one with several minima, edges or rings.

    Parameters
    ----------
    image_fit
        What made the fits.
    rng
        Source of the numbers that every posterior is sampled with; they are drawn here, once, so
        that an image has one answer.
    """

    def __init__(self, image_fit: ImageFit, rng: np.random.Generator) -> None:
        self._fit = image_fit
        size = self._size = 5 + len(image_fit.names)
        self._cubature = np.sqrt(size) * np.concatenate([np.eye(size), -np.eye(size)])
        if size == 5:
            self._usual, self._for_tails = (_student_points(5, n) for n in (POINTS, TAIL_POINTS))
        else:
            self._usual = self._for_tails = _student_points(size, NUISANCE_POINTS)
        self._chains = Chains(image_fit, rng)

    @np.errstate(under="ignore")  # of points that weigh nothing
    def moments(self, readings: Array, fits: list[Fit], roll: float = 0.0) -> tuple[Array, Array]:
        """Mean and covariance of the pose.

        Parameters
        ----------
        readings
            Counts, shape ``(n,)``.
        fits
            What `ImageFit.refine` made of them, best first, each in a minimum of its own.
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
        rivals = rivalling(fits)
        # A planar array's minimum is a ring, though it may not look so from one place on it.
        if len(rivals) == 1 and not self._fit.chart.planar:
            found = self._about(readings, rivals[0], roll)
            if found is not None:
                return found
        poses, chains = self._chains.sample(readings, rivals, roll)
        mean, covariance = _moments(poses, np.full(len(poses), 1 / len(poses)))
        # What so few chains leave uncertain of the moments themselves.
        return mean, covariance * (1 + (self._size + 2) / chains)

    def _about(self, readings: Array, fit: Fit, roll: float) -> tuple[Array, Array] | None:
        """Return the moments of a posterior with one plain minimum, ``None`` for any other."""
        mean, covariance = fit.coordinates, np.linalg.inv(fit.information)
        root = np.linalg.cholesky(covariance)
        poses, cost, log_volume = self._fit.cost(readings, mean + self._cubature @ root.T, roll)
        expected = 0.5 * self._size
        excess = cost - fit.cost - expected
        if np.abs(excess).max() <= TOLERANCE:
            weights, _ = _weights(log_volume - excess)
            return _moments(poses, weights)
        # Along each axis of the root, what reaches farther than the Gaussian is sampled farther out
        # and by more points, of which a tail gets few.
        tails = np.minimum(excess[: self._size], excess[self._size :]).clip(-0.75 * expected, 0.0)
        root *= np.sqrt(expected / (expected + tails))
        student, log_odds = self._for_tails if tails.min() < -HEAVY else self._usual
        for least in (DONE, TRUSTED):
            points = mean + student @ root.T
            poses, cost, log_volume = self._fit.cost(readings, points, roll)
            weights, count = _weights(log_volume - cost + log_odds)
            if count > least * len(points):
                found, covariance = _moments(poses, weights)
                return found, covariance / (1 - MISSED / count)
            if count < 8 * self._size:
                return None
            # Once more, about the moments that the first round found, and by more points.
            mean, covariance = _moments(points, weights)
            root = np.linalg.cholesky(covariance)
            student, log_odds = self._for_tails
        return None


def rivalling(fits: list[Fit]) -> list[Fit]:
    """Return the fits that are not negligible beside the best, which comes first."""
    return [fit for fit in fits if fit.cost - fits[0].cost < NEGLIGIBLE]


def _student_points(size: int, count: int) -> tuple[Array, Array]:
    """Return points of a Student distribution, and what a log-posterior there lacks as a weight.

    The points come in pairs of opposites. The weights are tilted, so that a standard Gaussian has
    its moments E[x_i x_j] and E[x_i^2 x_j^2], which a few hundred points alone would miss by
    several percent.
    """
    # Centred in their cells, so that no point lies at infinity.
    half = count // 2
    uniform = qmc.Sobol(size + 1, scramble=False).random(half) + 0.5 / half
    scale = np.sqrt(chdtri(FREEDOM, uniform[:, -1]) / FREEDOM)
    points = ndtri(uniform[:, :-1]) / scale[:, None]
    points = np.concatenate([points, -points])
    log_weights = -0.5 * (points**2).sum(axis=1) - _log_student(points)
    rows, columns = np.triu_indices(size)
    products = points[:, rows] * points[:, columns]
    powers = np.concatenate([products, products**2], axis=1)
    same = rows == columns
    moments = np.concatenate([np.where(same, 1.0, 0.0), np.where(same, 3.0, 1.0)])

    # The tilt of least entropy is where this convex function is least.
    def excess(tilt: Array) -> tuple[float, Array]:
        tilted = log_weights + powers @ tilt
        weights, _ = _weights(tilted)
        return float(logsumexp(tilted) - moments @ tilt), weights @ powers - moments

    def curvature(tilt: Array) -> Array:
        weights, _ = _weights(log_weights + powers @ tilt)
        off = powers - weights @ powers
        return (off.T * weights) @ off

    start = np.zeros(len(moments))
    found = minimize(excess, start, jac=True, hess=curvature, method="trust-exact")
    # A point far out, of which a Gaussian has nothing, is not to be blown up for it.
    return points, np.clip(powers @ found.x, -MOST_TILT, MOST_TILT) - _log_student(points)


def _log_student(standard: Array) -> Array:
    """Logarithm of the standard Student density without its constant, shape ``(...)``."""
    size = standard.shape[-1]
    return -0.5 * (FREEDOM + size) * np.log1p((standard * standard).sum(axis=-1) / FREEDOM)


def _weights(log_weights: Array) -> tuple[Array, float]:
    """Return weights of sum 1, and how many equal ones they are worth."""
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    return weights, float(1 / (weights @ weights))


def _moments(values: Array, weights: Array) -> tuple[Array, Array]:
    mean = weights @ values
    off = values - mean
    return mean, (off.T * weights) @ off
