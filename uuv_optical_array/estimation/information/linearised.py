"""What the readings of one frame say of pose and constants, as a linear problem."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import (
    PITCH,
    YAW,
    Array,
    lamp_in_body,
    turned_with_beam,
    write_lamp_slopes,
)
from uuv_optical_array.core.numerics.elementwise import borrowed, zeros
from uuv_optical_array.core.numerics.linear_algebra import solve
from uuv_optical_array.estimation.information.likelihood import likelihood_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import ReadingNoise
from uuv_optical_array.forward.optics import Optics, detect, write_light
from uuv_optical_array.forward.prior import ROLL

LEAST_CURVATURE = 1e-12  # of a reading's log-likelihood, 1/counts^2, below which it says nothing


class LinearisedReadings(NamedTuple):
    """The likelihood of one image near a place, without any prior.

    ``residuals = slopes @ (x - at) + light * gain errors + noise(variances)``

    - at: where the light was linearised: pose, m and rad, and offsets of constants, ``(5 + q,)``.
    - residuals: readings less their expected light there, counts, shape ``(n,)``; of a censored
      reading the score over the curvature of its log-likelihood.
    - slopes: of the light by pose and constants, shape ``(n, 5 + q)``.
    - light: expected there, which a gain error multiplies, counts, shape ``(n,)``; no pedestal.
    - variances: of readings without gain errors, counts^2, > 0, ``(n,)``; inf: they say nothing.
    """

    at: Array
    residuals: Array
    slopes: Array
    light: Array
    variances: Array

    @np.errstate(divide="ignore")
    def believed(self, weights: Array) -> "LinearisedReadings":
        """Return readings that count by weights in [0, 1], ``(n,)``; at 0 their variance is inf."""
        return self._replace(variances=self.variances / weights)

    def pose_slopes(self, stds: Array, gain_std: float) -> Array:
        """Return how the pose that fits best follows the last constants, shape ``(5, q - k)``.

        - stds: of the prior of pose and the first k constants, which are fitted, ``(5 + k,)``.
        - gain_std: the detectors' relative error.
        """
        fitted, given = self.slopes[:, : len(stds)], self.slopes[:, len(stds) :]
        weighted = fitted.T / (self.variances + np.square(gain_std * self.light))
        information = weighted @ fitted
        information.flat[:: len(stds) + 1] += stds**-2.0
        return -solve(information, weighted @ given)[:5]


class Lineariser:
    """Linearises the likelihood of images of one scene.

    - constants: dotted names of the unknown settings, of `ForwardModel.nuisances`.
    - write: `write_linear`, as it stands or compiled.
    """

    def __init__(
        self,
        model: ForwardModel,
        constants: Sequence[str],
        write: Callable[..., None] | None = None,
    ) -> None:
        self._size = 5 + len(constants)
        self._roll = 5 + constants.index(ROLL) if ROLL in constants else None
        self._optics = model.optics(constants)
        self._noise = model.own_noise
        self._write = write or write_linear

    @np.errstate(under="ignore", divide="ignore", invalid="ignore")  # of light that is too dim
    def __call__(self, readings: ArrayLike, at: ArrayLike, roll: float = 0.0) -> LinearisedReadings:
        """Linearise the likelihood of an image at pose and offsets of the constants, ``(5 + q,)``.

        The offset of the roll is at this pose.
        """
        readings = np.array(readings, dtype=float).reshape(-1)
        place = np.array(at, dtype=float)
        linear = np.empty((1 + self._size + 3, len(readings)))
        at, r = place.copy(), self._roll
        if r is not None:
            roll, at[r] = roll + at[r], 0.0
        self._write(self._optics, self._noise, readings, at, float(roll), linear)
        image, (_, score, curvature) = linear[:-3], linear[-3:]
        if r is not None:
            # A turn about the beam is one of the roll, after which the pose is turned back.
            image[1 + r] -= turned_with_beam(at[:5]) @ image[1:6]
            image[1 + r] *= math.cos(at[PITCH]) / math.cos(at[YAW])
        says = curvature > LEAST_CURVATURE
        variances = np.where(says, 1 / curvature, np.inf)
        residuals = np.where(says, score / curvature, 0.0)
        light = image[0] - self._noise.black
        return LinearisedReadings(place, residuals, image[1:].T, light, variances)


def write_linear(
    given: Optics, noise: ReadingNoise, readings: Any, at: Any, roll: float, linear: Any
) -> None:
    """Write light and slopes, and the three rows of `likelihood_of`, at pose and constants."""
    optics, image, nuisances = borrowed(given), linear[:-3], at[5:]
    lamp, slopes = lamp_in_body(at, roll), zeros(6, 5, at[0])
    write_lamp_slopes(at, roll, lamp, slopes)
    write_light(optics, lamp, slopes, (at[PITCH], at[YAW], roll), nuisances, image)
    detect(optics, nuisances, image)
    likelihood_of(readings, image[0], noise, linear[-3:])
