"""What the readings of one frame say of pose and constants, as a linear problem."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.likelihood import log_likelihood
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import POWER

LEAST_CURVATURE = 1e-12  # of a reading's log-likelihood, 1/counts^2, below which it says nothing


class LinearisedReadings(NamedTuple):
    """The likelihood of one image near a place, without any prior.

    ``residuals = slopes @ (x - at) + light * gain errors + noise(variances)``

    Parameters
    ----------
    at
        Pose, m and rad, then offsets of the q constants, shape ``(5 + q,)``: where the light was
        linearised.
    residuals
        Readings less their expected light there, counts, shape ``(n,)``; of a censored reading
        the score over the curvature of its log-likelihood.
    slopes
        Of the light by pose and constants, shape ``(n, 5 + q)``.
    light
        Expected light of the lamp there, which a gain error multiplies, counts, shape ``(n,)``.
    variances
        Of the readings without gain errors, counts^2, > 0, shape ``(n,)``; inf: the reading says
        nothing.
    """

    at: Array
    residuals: Array
    slopes: Array
    light: Array
    variances: Array


def linearised_readings(
    model: ForwardModel,
    constants: Sequence[str],
    readings: ArrayLike,
    at: ArrayLike,
    roll: float = 0.0,
) -> LinearisedReadings:
    """Linearise the likelihood of an image.

    Parameters
    ----------
    model
        The scene's forward model.
    constants
        Dotted names of settings that are not known, as `ForwardModel.nuisances` has them.
    readings
        The image, counts, of n readings in any shape.
    at
        Pose, m and rad, then offsets of the constants, shape ``(5 + q,)``.
    roll
        Roll of the follower, rad.
    """
    at = np.array(at, dtype=float)
    # The slope by the logarithm of the lamp's power is the lamp's share of the light.
    names = [*constants, *([] if POWER in constants else [POWER])]
    offsets = dict(zip(names, [*at[5:], 0.0], strict=False))
    light, slopes = model.linearised(at[:5], roll, {n: np.array(v) for n, v in offsets.items()})
    noise = model.noise._replace(square=0.0)
    _, score, curvature = log_likelihood(np.ravel(readings), light, noise)
    says = curvature > LEAST_CURVATURE
    variances = np.divide(1.0, curvature, out=np.full(len(light), np.inf), where=says)
    residuals = np.divide(score, curvature, out=np.zeros(len(light)), where=says)
    lamp = slopes[:, 5 + names.index(POWER)]
    return LinearisedReadings(at, residuals, slopes[:, : len(at)].copy(), lamp.copy(), variances)
