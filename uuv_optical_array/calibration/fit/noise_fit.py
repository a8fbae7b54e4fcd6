"""The noise of the detectors by the residuals of a calibration.

The squares of residuals give the variance of readings: that of the dark, and a part that is
relative to the reading, on top of what the scene has besides. Both are the most probable ones, with
the standard errors of Fisher's information (S. Kay, Estimation Theory, 1993, eq. 3.31).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from uuv_optical_array.calibration.fit.fit import CalibrationFit
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.effects.electronics import detection
from uuv_optical_array.forward.scene import Scene, scene_from_settings

NOISE, RELATIVE = "sensor_noise.sigma_counts", "sensor_noise.relative"
UNITS = "counts", ""
# Standard error of the relative part beyond which it is not known: readings are as bright as each
# other, or hardly brighter than the dark.
MOST_ERROR = 0.02
LEAST_VARIANCE = 1e-9  # counts^2


class FittedNoise(NamedTuple):
    """Settings of ``sensor_noise``, in the order of `UNITS`, and their standard errors.

    Without a `reason` the relative part is fitted, too; else it keeps its value, whose error is
    nan, and the reason says why.
    """

    values: Array
    errors: Array
    reason: str

    def of(self, scene: Scene) -> Scene:
        """Return the scene with this noise."""
        settings = scene.settings()
        settings["effects"]["sensor_noise"] = dict(
            zip(("sigma_counts", "relative"), self.values.tolist(), strict=True)
        )
        return scene_from_settings(settings, scene.name)


def noise_of(scene: Scene) -> Array:
    """Return the settings of the noise of a scene, shape ``(2,)``."""
    own = scene.effects["sensor_noise"]
    return np.array([own["sigma_counts"], own["relative"]])


def fitted_noise(fit: CalibrationFit, scene: Scene) -> FittedNoise:
    """Return the noise by which the residuals of a fit in a scene are most probable.

    ValueError where every reading may be censored.
    """
    agreement, before = fit.agreement, noise_of(scene)
    told = agreement.uncensored
    variance, mean = agreement.variance[told], np.maximum(agreement.mean[told], 0.0)
    if not len(variance):
        raise ValueError("noise: every reading is dark or saturated; record more light")
    residuals = agreement.residuals[told] ** 2
    square = residuals * variance * (agreement.misfit / residuals.mean())  # by the freedoms
    demodulation = scene.effects.get("demodulation")
    white = 1.0
    if demodulation:
        white = detection(demodulation["waveform"], scene.lamp_count).noise_factor
    units = np.array([np.full(len(mean), white), mean**2])
    # What the shape of the beam leaves is of the same law, and is found by the fit itself.
    own = before**2 + [0.0, fit.likelihood.shape_std**2]
    rest = np.maximum(variance - own @ units, 0.0)
    free = np.array([True, True])
    found, errors = _most_probable(square, rest, units, own, free)
    reason = ""
    if fit.shaped:
        reason = "it cannot be told from the misfit of the beam's shape, prior.beam_shape_std"
    elif errors[1] > MOST_ERROR:
        reason = (
            "record from close to the lamp to far from it: readings of much and of little light"
        )
        free[1] = False
        found, errors = _most_probable(square, rest, units, own, free)
    if reason:
        found[1], errors[1] = before[1], np.nan
    return FittedNoise(found, errors, reason)


def _most_probable(
    square: Array, rest: Array, units: Array, start: Array, free: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return the roots of the factors of `units` in the variance, ``(2,)``, and their errors.

    Those that are not free keep the value of the start.
    """
    scale = square.mean() / np.maximum(units.mean(axis=1), LEAST_VARIANCE) + LEAST_VARIANCE

    def cost(at: Array) -> tuple[float, Array]:
        variance = np.maximum(rest + (at * scale) @ units, LEAST_VARIANCE)
        relative = square / variance
        slope = 0.5 * (units @ ((1 - relative) / variance)) * scale
        return 0.5 * float((np.log(variance) + relative).mean()), slope / len(square)

    first = np.where(free, np.maximum(start / scale, 0.1), start / scale)
    bounds = [(0.0, None) if each else (at, at) for each, at in zip(free, first, strict=True)]
    options = {"ftol": 1e-15, "gtol": 1e-9, "maxiter": 200}
    at = minimize(cost, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    factors = at * scale
    weighed = units[free] / np.maximum(rest + factors @ units, LEAST_VARIANCE)
    stds = np.full(2, np.nan)
    information = 0.5 * weighed @ weighed.T
    # In units of their own, as counts and shares differ by orders of magnitude.
    size = np.sqrt(np.maximum(information.diagonal(), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-10, hermitian=True)
    unseen = np.where(inverse.diagonal() < 0.5, np.inf, inverse.diagonal())
    stds[free] = np.sqrt(unseen) / size
    values = np.sqrt(factors)
    return values, stds / np.maximum(2 * values, np.sqrt(stds))
