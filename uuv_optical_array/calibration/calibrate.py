"""Lamp, water, background and gains, fitted to images at known poses by maximum likelihood.

Power and mean gain are one product, so the geometric mean of the gains is 1: the gauge. What the
images do not tell is named and stays where it was. Design: docs/calibration.md.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.calibration.fit import CalibrationFit
from uuv_optical_array.calibration.likelihood import (
    BACKGROUND,
    GAINS,
    POWER,
    SIGMA,
    CalibrationLikelihood,
    K,
)
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.scene import Scene, scene_from_settings

NAMES = ("lamp.power", "lamp.beam_sigma_deg", "attenuation.k_per_m", "ambient.level_counts")
UNITS = ("counts m^2", "deg", "1/m", "counts")
NOISE = "sensor_noise.sigma_counts"
MISFIT = 1.2  # mean squared residual from which the model does not explain the data
MANY = 0.05  # share of outliers from which something else is wrong
NOISE_ROUNDS = 4


@dataclass(frozen=True)
class FittedParameter:
    """One fitted number.

    Parameters
    ----------
    name, unit
        As in the scene.
    start, value
        Before and after.
    std
        Standard error; nan where the value was held.
    note
        Why it was held, or what it stands or falls with; empty: known by itself.
    """

    name: str
    unit: str
    start: float
    value: float
    std: float
    note: str = ""


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Parameters
    ----------
    scene
        The starting scene with every fitted value in its place.
    parameters
        Power, beam, attenuation, background; the reference reading, which follows from them; the
        noise, where it was fitted.
    start_gains, gains, gain_std
        Geometric mean 1, shape ``(side, side)``; the standard error is nan where one was held.
    correlation
        Of the first four parameters, shape ``(4, 4)``; nan where one was held.
    mean, variance, residuals
        Of every reading, counts, counts^2 and standard deviations, shape ``(m, n)``.
    used
        Readings that were fitted, shape ``(m, n)``; the others are outliers or of a fault.
    fair
        Used readings that could hardly be censored, shape ``(m, n)``.
    misfit
        Mean squared residual of these, 1 where the model explains the data; the standard errors
        have its root as a factor where it exceeds `MISFIT`.
    together
        How the residuals of an image go together: 1 where they are independent.
    outliers, outlying_images
        Readings left out one by one; indices of images left out whole.
    notes
        What a user should know, a line each.
    """

    scene: Scene
    parameters: tuple[FittedParameter, ...]
    start_gains: Array
    gains: Array
    gain_std: Array
    correlation: Array
    mean: Array
    variance: Array
    residuals: Array
    used: NDArray[np.bool_]
    fair: NDArray[np.bool_]
    misfit: float
    together: float
    outliers: int
    outlying_images: tuple[int, ...]
    notes: tuple[str, ...]


def calibrate(
    scene: Scene,
    images: ArrayLike,
    poses: ArrayLike,
    rolls: ArrayLike = 0.0,
    hold: Collection[str] = (),
    pose_std: ArrayLike | None = None,
    fit_noise: bool = False,
    on_step: Callable[[], object] = int,
) -> Calibration:
    """Fit lamp, water, background and gains to images at known poses.

    Parameters
    ----------
    scene
        Where the fit starts; array, noise and every effect that is not fitted are believed.
    images
        Counts, finite, shape ``(m, side, side)``, m >= 1.
    poses, rolls
        Of the follower in ``beacon``, m and rad, shape ``(m, 5)`` and broadcast to ``(m,)``.
    hold
        What is known and stays as the scene has it: `NAMES`, or ``gains``.
    pose_std
        Standard deviation of each pose, independent by image, m and rad, shape ``(5,)``, > 0;
        ``None``: exact.
    fit_noise
        Whether ``sensor_noise.sigma_counts`` is fitted to the residuals too.
    on_step
        Called at every step, to show that it goes on.

    Returns
    -------
    Calibration
        The most probable values, and how well they are known.

    Raises
    ------
    ValueError
        For images or poses that are not finite or of a wrong shape, an unknown name in `hold`, a
        noise to fit that the scene does not have, no reading that can be used, or a result that
        no scene may hold.
    """
    side = scene.array.detectors_per_side
    images, poses = np.asarray(images, float), np.asarray(poses, float)
    if images.ndim != 3 or images.shape[1:] != (side, side) or not len(images):
        raise ValueError(
            f"images: shape {images.shape}; scene {scene.name} has (m, {side}, {side})"
        )
    if poses.shape != (len(images), 5):
        raise ValueError(f"poses: shape {poses.shape}; give ({len(images)}, 5), one an image")
    rolls = np.broadcast_to(np.asarray(rolls, float), len(images))
    for name, values in (("images", images), ("poses", poses), ("rolls", rolls)):
        if not np.isfinite(values).all():
            raise ValueError(f"{name}: not finite; leave such frames out")
    for name in hold:
        if name not in (*NAMES, "gains"):
            raise ValueError(f"hold {name}: unknown; choose of {', '.join((*NAMES, 'gains'))}")
    if fit_noise and "sensor_noise" not in scene.effects:
        raise ValueError(f"scene {scene.name}: no effects.sensor_noise to fit; add it")
    likelihood = CalibrationLikelihood(
        scene, images, poses, rolls, None if pose_std is None else np.asarray(pose_std, float)
    )
    known = [i for name, i in zip(NAMES, range(GAINS), strict=True) if name in hold]
    if "gains" in hold:
        known += range(GAINS, GAINS + side**2)
    fit = CalibrationFit(likelihood, known, on_step)
    if not fit_noise:
        return _gathered(scene, fit, ())
    start = sigma = float(scene.effects["sensor_noise"]["sigma_counts"])
    for _ in range(NOISE_ROUNDS):
        sigma, error = fit.noise(sigma)
        scene = _changed(scene, "sensor_noise", sigma_counts=sigma)
        fit = CalibrationFit(likelihood.of(scene), known, on_step)
    return _gathered(scene, fit, (FittedParameter(NOISE, "counts", start, sigma, error),))


def _changed(scene: Scene, effect: str, **values: Any) -> Scene:
    settings = scene.settings()
    settings["effects"][effect] = values
    return scene_from_settings(settings, scene.name)


def _gathered(scene: Scene, fit: CalibrationFit, more: tuple[FittedParameter, ...]) -> Calibration:
    """Gather what is known."""
    likelihood, values, held = fit.likelihood, fit.state.parameters, fit.held()
    if POWER in fit.unknown:
        raise ValueError(f"images: {_cure(fit, POWER)}")
    covariance = fit.covariance() * (fit.misfit if fit.misfit > MISFIT else 1.0)
    std = np.sqrt(np.diag(covariance))
    std[list(held)] = np.nan
    logarithm = np.isin(np.arange(len(values)), [K, BACKGROUND], invert=True)
    begun, shown = (np.where(logarithm, np.exp(each), each) for each in (fit.start, values))
    errors = np.where(logarithm, shown * std, std)
    notes = {
        **{
            i: f"only together with {NAMES[i_with]}"
            for i, i_with in fit.mixed.items()
            if i_with < GAINS
        },
        **dict.fromkeys(fit.at_bound, "at its bound"),
        **dict.fromkeys(fit.unknown, "not known"),
        **dict.fromkeys(fit.known, "held"),
    }
    reference, slope = _reference(scene, fit)
    reference_error = reference * float(np.sqrt(slope @ covariance @ slope))
    parameters = [
        FittedParameter(
            name, unit, float(begun[i]), float(shown[i]), float(errors[i]), notes.get(i, "")
        )
        for i, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True))
    ]
    parameters.append(
        FittedParameter(
            "lamp.reference_counts",
            "counts",
            scene.lamp.reference_counts,
            reference,
            reference_error,
        )
    )
    alone = ~likelihood.used & ~likelihood.faulty
    alone[list(fit.outlying)] = False
    grid = (scene.array.detectors_per_side,) * 2
    return Calibration(
        _written(scene, fit, shown, reference),
        (*parameters, *more),
        begun[GAINS:].reshape(grid),
        shown[GAINS:].reshape(grid),
        errors[GAINS:].reshape(grid),
        covariance[:GAINS, :GAINS] / np.outer(std[:GAINS], std[:GAINS]),
        fit.state.mean,
        fit.state.variance,
        fit.residuals,
        likelihood.used,
        fit.fair,
        fit.misfit,
        fit.together(),
        int(alone.sum()),
        fit.outlying,
        tuple(_notes(scene, fit)),
    )


def _cure(fit: CalibrationFit, kind: int) -> str:
    """Say what to drive for a parameter to be known."""
    poses = fit.likelihood.poses
    ranges = np.linalg.norm(poses[:, :3], axis=1)
    off = np.degrees(np.arctan2(np.linalg.norm(poses[:, 1:3], axis=1), -poses[:, 0]))
    return {
        POWER: "too little light of the lamp; record closer to it and in its beam",
        SIGMA: f"record poses up to {2 * np.exp(fit.start[SIGMA]):.0f} deg off the beam's axis; "
        f"here the farthest is {off.max():.1f} deg",
        K: "record ranges that differ by a factor of 2 or more; here they run from "
        f"{ranges.min():.2f} to {ranges.max():.2f} m",
        BACKGROUND: "record some images with the lamp off, out of its beam or far away",
        GAINS: "turn and shift the array so that the lamp shines on it",
    }[kind]


def _notes(scene: Scene, fit: CalibrationFit) -> list[str]:
    side, likelihood, notes = scene.array.detectors_per_side, fit.likelihood, []
    for i in fit.dead:
        notes.append(
            f"detector [{i // side}, {i % side}] always reads {likelihood.readings[0, i]:g} "
            "counts: dead or stuck; it was left out, name it in effects.detector_faults"
        )
    notes += [f"{NAMES[i]} is not known: {_cure(fit, i)}" for i in range(GAINS) if i in fit.unknown]
    if blind := [divmod(i - GAINS, side) for i in sorted(fit.unknown) if i >= GAINS]:
        cells = ", ".join(f"[{row}, {column}]" for row, column in blind)
        notes.append(f"gain of {cells} is not known: {_cure(fit, GAINS)}")
    lost = 1 - likelihood.used[:, ~likelihood.faulty].mean()
    if lost > MANY:
        notes.append(f"{lost:.0%} of the readings are outliers: look at the picture")
    # Of independent residuals it is 1, with this standard deviation.
    common = fit.together() > 1 + 6 * np.sqrt(2 / len(likelihood.readings))
    if common:
        notes.append(
            "the residuals of an image go together: its pose or the lamp's power is off, or the "
            "model; give the poses' standard deviation, or see the picture"
        )
    if fit.misfit > MISFIT:
        notes.append(
            f"the model does not explain the data: mean squared residual {fit.misfit:.2f}, "
            f"not 1; standard errors were multiplied by {np.sqrt(fit.misfit):.2f}"
        )
        if "sensor_noise" in scene.effects and not common:
            sigma, _ = fit.noise(scene.effects["sensor_noise"]["sigma_counts"])
            notes.append(
                f"residuals go each its own way, as noise does: {NOISE} {sigma:.3g} would explain "
                "them"
            )
    elif fit.misfit < 1 / MISFIT and fit.fair.any():
        notes.append(
            f"mean squared residual {fit.misfit:.2f}, below 1: the noise is less than the scene "
            "says, and the standard errors are too large"
        )
    return notes


def _reference(scene: Scene, fit: CalibrationFit) -> tuple[float, Array]:
    """Return the reference reading, and the slope of its logarithm by the parameters."""
    values = fit.state.parameters.copy()
    values[BACKGROUND] = 0.0
    aligned = np.array([[-scene.lamp.reference_range_m, 0.0, 0.0, 0.0, 0.0]])
    light, slopes = fit.likelihood.light(values, aligned, np.zeros(1))
    lit = light[0] * np.exp(values[GAINS:]) * ~fit.likelihood.faulty
    brightest = int(lit.argmax())
    slope = np.zeros(len(values))
    slope[:GAINS] = slopes[0, brightest, 5:] / light[0, brightest]
    slope[BACKGROUND], slope[GAINS + brightest] = 0.0, 1.0
    return float(lit[brightest]), slope


def _written(scene: Scene, fit: CalibrationFit, values: Array, reference: float) -> Scene:
    """Return the scene with the fitted values in their places."""
    settings: dict[str, Any] = scene.settings()
    lamp, effects = settings["lamp"], settings["effects"]
    # Far more digits than are known, and few enough to read.
    values = np.array([float(f"{value:.9g}") for value in values])
    lamp["beam_sigma_deg"], lamp["reference_counts"] = (
        float(values[SIGMA]),
        float(f"{reference:.9g}"),
    )
    for name, key, i in (("attenuation", "k_per_m", K), ("ambient", "level_counts", BACKGROUND)):
        if name in effects or values[i] > 0:
            effects[name] = {key: float(values[i])}
    gains = values[GAINS:].reshape((scene.array.detectors_per_side,) * 2)
    drift = {k: v for k, v in effects.get("responsivity", {}).items() if k == "drift_per_c"}
    effects["responsivity"] = {"gains": gains.tolist(), **drift}
    return scene_from_settings(settings, scene.name)
