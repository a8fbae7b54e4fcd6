"""The scene that a calibration found, and what is reported of it as a whole."""

import numpy as np
from scipy.special import logsumexp, softmax

from uuv_optical_array.calibration.fit.fit import CalibrationFit
from uuv_optical_array.calibration.likelihood.expected_light import POSE
from uuv_optical_array.calibration.likelihood.likelihood import CalibrationLikelihood
from uuv_optical_array.calibration.likelihood.parameters import (
    AIMS,
    BACKGROUND,
    BEHIND,
    COSINE_POWER,
    LAMP_AIM,
    OWN_NAMES,
    POWER,
    SCATTER,
    SHAPE,
    SHARE,
    SIGMA,
    SIZE,
    K,
    Layout,
)
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.scene import Scene, scene_from_settings, without_meaning

LEAST_LIGHT = 1e-100  # at the reference, where a fit has diverged


def as_a_whole(
    layout: Layout, values: Array, start: Array, covariance: Array
) -> tuple[Array, Array]:
    """Return what scenes have: several lamps' power together, and their aim as the mean of axes."""
    shares, axes = layout.own[:, 0], layout.own[:, 4:6]
    if not len(shares):
        return values, covariance
    values, slopes = values.copy(), np.eye(len(values))
    values[POWER] += logsumexp(values[shares]) - logsumexp(start[shares])
    slopes[POWER, shares] = softmax(values[shares])
    for aim, rows in zip(LAMP_AIM, axes.T, strict=True):
        slopes[aim, rows] = np.radians(1) / len(rows)
    return values, slopes @ covariance @ slopes.T


def reference_reading(scene: Scene, fit: CalibrationFit, values: Array) -> tuple[float, Array]:
    """Return the reading of one lamp with the power of all, and its logarithm's slope, ``(p,)``."""
    likelihood, first = fit.likelihood, fit.likelihood.layout.gains
    aligned = np.array([[-scene.lamp.reference_range_m, 0.0, 0.0, 0.0, 0.0]])
    dark = np.zeros((1, *[scene.array.detectors_per_side] * 2))
    alone = likelihood.scene.with_lamps(())
    single = CalibrationLikelihood(alone, dark, aligned, np.zeros(1), None)
    own = values[:SHARE].copy()
    own[[*AIMS, BACKGROUND]] = 0.0
    light, slopes = single.light(own, aligned, np.zeros(1))
    readings = light[0] * np.exp(values[first:]) * ~likelihood.faulty
    brightest = int(readings.argmax())
    slope = np.zeros(len(values))
    slope[:SHARE] = slopes[0, brightest, POSE:] / max(light[0, brightest], LEAST_LIGHT)
    slope[[*AIMS, BACKGROUND]], slope[first + brightest] = 0.0, 1.0
    return float(readings[brightest]), slope


def calibrated_scene(
    scene: Scene, fit: CalibrationFit, values: Array, reference: float, errors: Array
) -> Scene:
    """Return the scene of a fit's `values`, ``(p,)``, whose standard errors are its prior."""
    settings, layout = scene.settings(), fit.likelihood.layout
    lamp, effects = settings["lamp"], settings["effects"]
    # Far more digits than are known, and few enough to read.
    values = np.array([float(f"{value:.9g}") for value in values])
    wider = float(values[SIGMA]) - lamp["beam_sigma_deg"]
    lamp["beam_sigma_deg"] = float(values[SIGMA])
    for one, own in zip(settings.get("lamps", ()), values[layout.own], strict=True):
        one |= dict(zip(OWN_NAMES, own.tolist(), strict=True))
        if "beam_sigma_deg" in one:
            one["beam_sigma_deg"] += wider
    if fit.shaped:
        lamp |= fit.likelihood.beam(fit.state.at.parameters)
    lamp["reference_counts"] = float(f"{reference:.9g}")
    if "sea" in effects:
        sea = {"absorption_per_m": float(values[K]), "scattering_per_m": float(values[SCATTER])}
        effects["sea"] = sea
    elif "attenuation" in effects or values[K] > 0:
        effects["attenuation"] = {"k_per_m": float(values[K])}
    if BEHIND not in fit.held():
        lamp["behind_m"] = float(values[BEHIND])
    if BACKGROUND not in fit.held() and layout.modulated:
        lamp["floor_counts"] = float(values[BACKGROUND])
    elif BACKGROUND not in fit.held() and ("ambient" in effects or values[BACKGROUND] > 0):
        effects["ambient"] = {"level_counts": float(values[BACKGROUND])}
    if COSINE_POWER not in fit.held():
        effects["field_of_view"] = {"cosine_power": float(values[COSINE_POWER])}
    if SIZE not in fit.held():
        settings["array"]["radius_m"] = float(values[SIZE])
    gains = values[layout.gains :].reshape((scene.array.detectors_per_side,) * 2)
    drift = {k: v for k, v in effects.get("responsivity", {}).items() if k == "drift_per_c"}
    effects["responsivity"] = {"gains": gains.tolist(), **drift}
    settings["prior"] |= layout.prior(scene.prior, values, errors, fit.unknown)
    if fit.shaped:
        told = scene.prior.beam_shape_std if fit.unknown & {*SHAPE} else 0.0
        settings["prior"]["beam_shape_std"] = float(f"{max(fit.likelihood.shape_std, told):.3g}")
    settings["prior"] |= dict.fromkeys(without_meaning(effects, scene.array, scene.lamps), 0.0)
    return scene_from_settings(settings, scene.name)
