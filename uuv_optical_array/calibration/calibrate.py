"""A scene fitted to images at known poses by maximum likelihood; see docs/tutorials/calibration.md.

Parameters that the images do not determine keep their values and are named.
"""

import dataclasses
import math
from collections.abc import Callable, Collection

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.calibration import notes
from uuv_optical_array.calibration.fit.beam_shape import residuals_by_angle
from uuv_optical_array.calibration.fit.clock_fit import offset_step
from uuv_optical_array.calibration.fit.fit import CalibrationFit
from uuv_optical_array.calibration.fit.noise_fit import (
    NOISE,
    RELATIVE,
    UNITS,
    fitted_noise,
    noise_of,
)
from uuv_optical_array.calibration.found_scene import (
    as_a_whole,
    calibrated_scene,
    reference_reading,
)
from uuv_optical_array.calibration.likelihood.likelihood import CalibrationLikelihood
from uuv_optical_array.calibration.likelihood.parameters import LAMP_AIM, POWER, Layout
from uuv_optical_array.calibration.places_check import common_error, disagreement
from uuv_optical_array.calibration.result import Calibration, FittedParameter
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.lamp.beam import of_three
from uuv_optical_array.forward.scene import Scene

REFERENCE = "lamp.reference_counts"
SHAPE_STD = "prior.beam_shape_std"
NOISE_ROUNDS = 4
DARK, LEAST_LIT = 5.0, 0.01  # standard deviations of a dark reading; share of a lamp's readings


def what_is_fitted(scene: Scene, hold: Collection[str] = ()) -> tuple[Scene, Layout]:
    """Return a scene as it is fitted, and its parameters; ValueError for others in `hold`."""
    if scene.prior.beam_shape_std > 0:
        scene = dataclasses.replace(scene, lamp=of_three(scene.lamp))
    layout = Layout(scene)
    there = [name for i, name in enumerate(layout.names) if i not in layout.lacking]
    for name in hold:
        if name not in (*layout.names, "gains"):
            choice = ", ".join([*there, "gains"])
            raise ValueError(f"hold {name}: unknown; choose from {choice}")
    return scene, layout


def calibrate(
    scene: Scene,
    images: ArrayLike,
    poses: ArrayLike,
    rolls: ArrayLike = 0.0,
    hold: Collection[str] = (),
    pose_std: ArrayLike | None = None,
    fit_noise: bool = False,
    on_step: Callable[[], object] = int,
    places: ArrayLike | None = None,
    rates: Array | None = None,
    array: DetectorArray | None = None,
) -> Calibration:
    """Fit lamps, water, array, aims and background to images at known poses.

    - scene: where the fit starts; array, noise and effects that are not fitted stay as they are.
    - images: counts, finite, shape ``(m, L side, side)``, m >= 1.
    - poses, rolls: of the follower in ``beacon``, m and rad, ``(m, 5)`` and broadcast to ``(m,)``.
    - hold: parameters that keep the values of the scene: of `parameters.Layout`, or ``gains``.
    - pose_std: standard deviation of each pose, m and rad, shape ``(5,)`` or ``(m, 5)``, > 0;
      ``None``: exact; from `UNKNOWN_STD` on unknown, so that the pose is a start of the fit. With
      several lamps, which show it, the roll is known as well as the pitch.
    - fit_noise: whether ``sensor_noise`` is fitted to the residuals too.
    - on_step: called at every step, to show progress.
    - places: of each image, a whole number from 0 on, shape ``(m,)``: the images of a place share
      the error of its pose. ``None``: those of the images are independent.
    - rates: of poses and rolls, m/s and rad/s, shape ``(m, 6)``, which tell how far the clock of
      the poses is off that of the images.
    - array: detectors in place of those of the scene, on a grid of the same size.
    - ValueError: for images, poses or errors that are not finite or of a wrong shape, an unknown
      name in `hold`, a noise to fit that the scene lacks, no usable reading, or results out of the
      bounds of a scene.
    """
    side = scene.array.detectors_per_side
    rows = scene.lamp_count * side
    images, poses = np.asarray(images, float), np.asarray(poses, float)
    if images.ndim != 3 or images.shape[1:] != (rows, side) or not len(images):
        raise ValueError(
            f"images: shape {images.shape}; scene {scene.name} has (m, {rows}, {side})"
        )
    if poses.shape != (len(images), 5):
        raise ValueError(f"poses: shape {poses.shape}; give ({len(images)}, 5), one an image")
    rolls = np.broadcast_to(np.asarray(rolls, float), len(images))
    for name, values in (("images", images), ("poses", poses), ("rolls", rolls)):
        if not np.isfinite(values).all():
            raise ValueError(f"{name}: not finite; leave such frames out")
    started = scene
    scene, layout = what_is_fitted(scene, hold)
    names = layout.names
    if fit_noise and "sensor_noise" not in scene.effects:
        raise ValueError(f"scene {scene.name}: no effects.sensor_noise to fit; add it")
    if pose_std is not None:
        pose_std = np.asarray(pose_std, float)
        known_shape = pose_std.shape in ((5,), poses.shape)
        if not (known_shape and (np.isfinite(pose_std) & (pose_std > 0)).all()):
            raise ValueError(
                f"pose_std: {pose_std.tolist()}; give five numbers > 0, m and rad, or None for "
                "exact poses"
            )
    where = None if places is None else np.unique(places, return_inverse=True)[1]
    given = images, poses, rolls, pose_std, where, array
    likelihood = CalibrationLikelihood(scene, *given)
    lit = likelihood.readings > DARK * np.sqrt(likelihood.noise.variance)
    for i, share in enumerate(lit.reshape(len(images), -1, side**2).mean(axis=(0, 2)).tolist()):
        if scene.lamps and share < LEAST_LIT:
            raise ValueError(
                f"lamps.{i}: it lights {share:.1%} of its readings; switch it on and record in its "
                "beam, check which channel is which lamp, or take it out of the scene"
            )
    known = [i for i, name in enumerate(names) if name in hold or i in layout.lacking]
    if "gains" in hold:
        known += range(layout.gains, len(layout.kinds))
    fit = CalibrationFit(likelihood, known, on_step)
    reason = notes.refusal(fit, fit_noise)
    if where is not None and array is None and pose_std is not None:
        _, first = np.unique(where, return_index=True)
        std = np.broadcast_to(pose_std, poses.shape)[first]
        if not reason:
            reason = common_error(fit)
        elif wrong := disagreement(started, images[first], poses[first], rolls[first], std):
            reason = f"{wrong}; {reason}"
    if reason or not fit_noise:
        return _result(scene, fit, rates, reason)
    start = noise_of(scene)
    for _ in range(NOISE_ROUNDS):
        noise = fitted_noise(fit, scene)
        scene = noise.of(scene)
        fit = CalibrationFit(CalibrationLikelihood(scene, *given), known, on_step)
    parts = start.tolist(), noise.values.tolist(), noise.errors.tolist()
    said = "", "not known" if noise.reason else ""
    fitted = tuple(map(FittedParameter, (NOISE, RELATIVE), UNITS, *parts, said))
    told = (f"{RELATIVE} is not known: {noise.reason}",) if noise.reason else ()
    return _result(scene, fit, rates, "", fitted, told)


def _result(
    scene: Scene,
    fit: CalibrationFit,
    rates: Array | None,
    reason: str,
    noise: tuple[FittedParameter, ...] = (),
    of_noise: tuple[str, ...] = (),
) -> Calibration:
    likelihood, held = fit.likelihood, fit.held()
    layout, first = likelihood.layout, likelihood.layout.gains
    if POWER in fit.unknown and not reason:
        raise ValueError(f"images: {notes.advice(fit, POWER)}")
    agreement = fit.agreement
    covariance = fit.covariance(agreement.misfit if agreement.misfit > notes.MISFIT else 1.0)
    values, covariance = as_a_whole(layout, fit.state.at.parameters, fit.start, covariance)
    std = np.sqrt(np.diag(covariance))
    std[list(held)] = np.nan
    start, fitted = (np.where(layout.logarithm, np.exp(x), x) for x in (fit.start, values))
    errors = np.where(layout.logarithm, fitted * std, std)
    if scene.lamps and held.isdisjoint(layout.own[:, 4:6].flat):
        errors[LAMP_AIM] = np.sqrt(np.diag(covariance)[LAMP_AIM])
    names = layout.names
    together = {i: f"only together with {names[j]}" for i, j in fit.correlated.items() if j < first}
    little = [i for i in likelihood.taped.tolist() if std[i] > notes.LITTLE * likelihood.tape_std_m]
    said = {
        **together,
        **dict.fromkeys(little, notes.HARDLY),
        **dict.fromkeys(fit.at_bound, "at its bound"),
        **dict.fromkeys(fit.unknown, "not known"),
        **dict.fromkeys(fit.known, "held"),
    }
    reference, slope = reference_reading(scene, fit, values)
    reference_error = reference * float(np.sqrt(slope @ covariance @ slope))
    parameters = [
        FittedParameter(
            name, unit, float(start[i]), float(fitted[i]), float(errors[i]), said.get(i, "")
        )
        for i, (name, unit) in enumerate(zip(names, layout.units, strict=True))
        if i not in layout.lacking
    ]
    if fit.shaped:
        before, left = scene.prior.beam_shape_std, likelihood.shape_std
        parameters.append(FittedParameter(SHAPE_STD, "", before, left, fit.shape_error))
    there = [i for i in range(first) if i not in layout.lacking]
    before = scene.lamp.reference_counts
    parameters.append(FittedParameter(REFERENCE, "counts", before, reference, reference_error))
    outliers = ~likelihood.used & likelihood.works
    outliers[list(fit.outlying_images)] = False
    grid = (scene.array.detectors_per_side,) * 2
    found = scene
    try:
        found = calibrated_scene(scene, fit, fitted, reference, errors)
    except ValueError as error:
        if not reason:
            raise
        reason = f"{reason}; {error}"
    return Calibration(
        scene=found,
        parameters=(*parameters, *noise),
        shifts=fit.state.at.shifts[:, :5] if likelihood.pose_std is not None else np.zeros((0, 5)),
        gains=fitted[first:].reshape(grid),
        gain_std=errors[first:].reshape(grid),
        correlation=covariance[np.ix_(there, there)] / np.outer(std[there], std[there]),
        residuals=agreement.residuals,
        by_angle=residuals_by_angle(fit),
        used=likelihood.used,
        uncensored=agreement.uncensored,
        misfit=agreement.misfit,
        outliers=int(outliers.sum()),
        outlying_images=fit.outlying_images,
        notes=(*notes.notes_of(scene, fit, little), *of_noise),
        refusal=reason,
        clock=(0.0, math.inf) if rates is None else offset_step(fit, rates),
    )
