"""The posterior of an image with every reading at full scale.

Such an image says that there is enough light on each detector, and no more. What it leaves of the
prior is wide and has walls, which neither a fit nor a lattice about one describes. So the prior is
sampled, each sample weighted by how likely it saturates the array, and sampled again from the
Gaussian of those weighted samples until enough of them count (population Monte Carlo: O. Cappe,
A. Guillin, J.-M. Marin and C. Robert, 2004, J. Comput. Graph. Stat. 13, 907).
"""

from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import PITCH, Array
from uuv_optical_array.estimation.information.likelihood import log_likelihood
from uuv_optical_array.estimation.least_squares.misfit import chi_square_score, residual_moments
from uuv_optical_array.estimation.least_squares.problem import PosePrior
from uuv_optical_array.forward.model import ForwardModel

SAMPLES = 4096  # of each round
ROUNDS = 8
WIDER = 1.5  # standard deviations of a round's samples, times those of the last
ENOUGH = 400  # samples that count


class SaturatedPosterior(NamedTuple):
    """What an image with every reading at full scale says.

    - mean, covariance: of the pose, m and rad, shapes ``(5,)`` and ``(5, 5)``.
    - score: of the misfit of the likeliest sample, as `misfit.chi_square_score`.
    """

    mean: Array
    covariance: Array
    score: float


def saturated_posterior(model: ForwardModel, prior: PosePrior, roll: float) -> SaturatedPosterior:
    """Return the posterior of an image with every reading at full scale.

    - model: the scene's forward model, with a largest reading.
    - prior: of pose and nuisances.
    - roll: of the follower, rad.
    """
    rng = np.random.default_rng(0)  # the same in every run: an image has one answer
    std = np.concatenate([prior.pose_std, list(prior.nuisance_std.values())])
    prior_mean = np.concatenate([prior.pose_mean, np.zeros(len(prior.nuisance_std))])
    mean, factor = prior_mean, np.diag(std)
    full = np.full(model.array.side**2, model.noise.high)
    for _ in range(ROUNDS):
        units = rng.standard_normal((SAMPLES, len(std)))
        samples = mean + units @ factor.T
        offsets = dict(zip(prior.nuisance_std, samples[:, 5:].T, strict=True))
        light = model.light(samples[:, :5], roll, offsets).reshape(SAMPLES, -1)
        log_weights = log_likelihood(full, light, model.noise)[0].sum(axis=1)
        log_weights -= 0.5 * (((samples - prior_mean) / std) ** 2).sum(axis=1)
        log_weights += 0.5 * (units**2).sum(axis=1)
        # Beyond it the same attitude has another pitch.
        log_weights[np.abs(samples[:, PITCH]) > np.pi / 2] = -np.inf
        best = light[log_weights.argmax()]
        weights = np.exp(log_weights - log_weights.max())
        weights /= weights.sum()
        mean = weights @ samples
        off = samples - mean
        covariance = (weights[:, None] * off).T @ off
        if weights @ weights < 1 / ENOUGH:
            break
        # A share of the prior keeps the Gaussian of few samples from being none.
        factor = np.linalg.cholesky(WIDER**2 * covariance + np.diag((0.05 * std) ** 2))
    variance, _ = model.variance(best)
    squares = np.maximum(model.noise.high - best, 0.0) ** 2 / variance
    expected, around = residual_moments(best, np.sqrt(variance), model.noise)
    score = chi_square_score(squares.sum(), expected.sum(), around.sum())
    covariance = 0.5 * (covariance + covariance.T)
    return SaturatedPosterior(mean[:5], covariance[:5, :5], float(score))
