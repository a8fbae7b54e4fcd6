"""Approaches to a lamp, as Eren et al. (2017) simulate them, and their errors by every method.

A follower closes from 8.5 m to 4.5 m at 0.5 m/s and takes 41 images. In each run the water's
temperature (and so the detectors' gain) and its attenuation are off by unknown constants. Published
are mean errors at the end and 95 % errors at the start and at the end.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Literal, NamedTuple

import numpy as np
from numpy.random import Generator

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.studies.docking_smoother import DockingSettings, Motion, bound, smoothed
from uuv_optical_array.studies.shared.published import calibrate, dead_reckoned

FAR_M, NEAR_M, SPEED_M_PER_S, RATE_HZ = 8.5, 4.5, 0.5, 5.0
STEP_S = 1 / RATE_HZ
FRAMES = round((FAR_M - NEAR_M) / SPEED_M_PER_S * RATE_HZ) + 1
TIMES_S = STEP_S * np.arange(FRAMES)
RANGES_M = FAR_M - SPEED_M_PER_S * TIMES_S
TURN_RATE_DEG_PER_S = 10.0
NOISE_COUNTS = 0.01 * 1023.0  # 1 % of full scale
AVERAGED = 10
# 2 mV of 576 mV for each degree by which the water's temperature is off.
GAIN_PER_C = -2 / 576
TEMPERATURE_C, K_PER_M = 3.0, 0.015

Noise = Literal["uniform", "gaussian", "averaged"]
# The aim is this many times smaller than the published errors at the end: position, angles.
AIM = np.array([5, 5, 5, 1, 1])


class Case(NamedTuple):
    """A case: attenuation that estimators assume, true poses ``(FRAMES, 5)``, published errors.

    These are the mean at the end, and 95 % at the start and at the end: x, y, z in m, pitch and yaw
    in deg; nan where the paper gives none.
    """

    k_per_m: float
    path: Array
    mean_end: Array
    start_95: Array
    end_95: Array


def _path(start: tuple[float, float], pitch_deg: Array, yaw_deg: Array) -> Array:
    """Follow the heading from y, z = `start`, with a constant speed towards the lamp."""
    poses = np.zeros((FRAMES, 5))
    poses[:, PITCH], poses[:, YAW] = np.radians(pitch_deg), np.radians(yaw_deg)
    heading = rotation_matrix(poses[:, PITCH], poses[:, YAW])[..., 0]
    slope = heading[:, 1:] / heading[:, :1]
    steps = SPEED_M_PER_S * STEP_S * (slope[1:] + slope[:-1]) / 2
    poses[:, 0] = -RANGES_M
    poses[:, 1:3] = start
    poses[1:, 1:3] += np.cumsum(steps, axis=0)
    return poses


def _cases() -> dict[str, Case]:
    nan, level = float("nan"), np.zeros(FRAMES)
    # The paper's frame has y to starboard and z down. It does not say when a zigzag turns: here
    # once, half-way.
    half = TIMES_S[-1] / 2
    yaw = np.clip((TIMES_S - half) * TURN_RATE_DEG_PER_S, -10.0, 10.0)
    dive, zigzag = _path((0.0, 0.0), level + 10.0, level), _path((-0.2, 0.1), level, yaw)
    in_dive = [0.02, 0.02, 0.18, 5, 1], [0.83, 0.18, 0.22, 2, nan], [0.43, 0.20, 0.28, 1, 1]
    in_zigzag = [0.13, 0.13, 0.05, 3, 4], [0.83, 0.18, 0.20, 2, 3], [0.46, 0.30, 0.28, 1, 1]
    in_murk = [0.26, 0.17, 0.01, 3, 4], [nan] * 5, [0.36, 0.80, 0.86, 8, 9]
    return {
        "dive": Case(0.09, dive, *np.array(in_dive)),
        "zigzag": Case(0.09, zigzag, *np.array(in_zigzag)),
        "zigzag, murky": Case(0.2, zigzag, *np.array(in_murk)),
    }


CASES = _cases()


class Choices(NamedTuple):
    """What the paper leaves open.

    Noise of 1 % is uniform from 0 to 1 % of full scale, Gaussian with that standard deviation, or
    the mean of `AVERAGED` uniform ones. `offset_share` is the standard deviation of temperature and
    attenuation as a share of what they are off "by up to": 0.5 where that is the 95 % point.
    """

    noise: Noise = "uniform"
    offset_share: float = 1.0


def assumed_scene(scene: Scene, case: Case, choices: Choices) -> Scene:
    """Return the scene that the estimators assume, with the uncertainty of its settings.

    The lamp of the tank stays the same, whatever the water. The mean of unipolar noise is an
    ambient level, its spread a Gaussian one. ValueError for a scene without attenuation.
    """
    if "attenuation" not in scene.effects:
        raise ValueError(f"scene {scene.name}: no effects.attenuation; add it")
    width = NOISE_COUNTS
    level, sigma = (0.0, width) if choices.noise == "gaussian" else (width / 2, width / 12**0.5)
    if choices.noise == "averaged":
        # The scene adds a whole rounding to a mean of which each reading was rounded.
        sigma = ((sigma**2 + 1 / 12) / AVERAGED - 1 / 12) ** 0.5
    settings = scene.settings()
    settings["effects"]["ambient"] = {"level_counts": 0.0}
    # The reading that the same lamp gives in the water of the case.
    lamp = settings["lamp"]
    aligned = np.array([-lamp["reference_range_m"], 0.0, 0.0, 0.0, 0.0])
    off = {"attenuation.k_per_m": np.array(case.k_per_m - scene.effects["attenuation"]["k_per_m"])}
    dark = ForwardModel(scene_from_settings(settings, scene.name))
    lamp["reference_counts"] = float(dark.light(aligned, 0.0, off).max())
    settings["effects"]["attenuation"]["k_per_m"] = case.k_per_m
    settings["effects"]["ambient"]["level_counts"] = level
    settings["effects"]["sensor_noise"] = {"sigma_counts": sigma}
    settings["prior"] = {
        "lamp_power_std": choices.offset_share * TEMPERATURE_C * abs(GAIN_PER_C),
        "k_std_per_m": choices.offset_share * K_PER_M,
    }
    return scene_from_settings(settings, scene.name)


def draw_offsets(choices: Choices, runs: int, rng: Generator) -> dict[str, Array]:
    """Draw the offsets of each run: of the logarithm of the gain, and of the attenuation, 1/m."""
    degrees = rng.normal(0.0, choices.offset_share * TEMPERATURE_C, runs)
    return {
        "lamp.power": np.log1p(GAIN_PER_C * degrees),
        "attenuation.k_per_m": rng.normal(0.0, choices.offset_share * K_PER_M, runs),
    }


def expose(
    model: ForwardModel, path: Array, offsets: dict[str, Array], noise: Noise, rng: Generator
) -> Array:
    """Expose all images of n runs with `draw_offsets`, counts, ``(n, frames, side, side)``."""
    shape = (len(offsets["lamp.power"]), len(path))
    spread = {name: np.broadcast_to(off[:, None], shape) for name, off in offsets.items()}
    light = model.light(np.broadcast_to(path, (*shape, 5)), 0.0, spread)
    if noise == "gaussian":
        return model.converted(light + NOISE_COUNTS * rng.standard_normal(light.shape))
    total, readings = np.zeros_like(light), AVERAGED if noise == "averaged" else 1
    for _ in range(readings):
        # The mean of unipolar noise is in the light, as an ambient level.
        total += model.converted(light + NOISE_COUNTS * (rng.random(light.shape) - 0.5))
    return total / readings


BATCH = 20
# The simulated vehicle holds its speed and does not drift.
DOCKING = DockingSettings(speed_walk_m_per_s=0.005, slip_m=0.005)
METHODS = ("moments", "least_squares", "tracker", "docking")


class ApproachErrors(NamedTuple):
    """The errors in n runs of a case, m and rad.

    `errors` are estimate less truth by method, ``(n, FRAMES, 5)``, nan without a pose. `bound` is
    the Cramer-Rao bound of a single frame with the prior of lamp and water, `run_bound` that of all
    frames so far and the motion of `DOCKING`, both ``(FRAMES, 5)``.
    """

    errors: Mapping[str, Array]
    bound: Array
    run_bound: Array

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return len(self.errors[METHODS[0]])

    def mean(self, method: str) -> Array:
        """Mean error, frame by frame, shape ``(FRAMES, 5)``."""
        return np.asarray(np.nanmean(self.errors[method], axis=0))

    def percentile_95(self, method: str, about_mean: bool = False) -> Array:
        """95 % of the absolute errors, frame by frame, shape ``(FRAMES, 5)``."""
        errors = np.abs(self.errors[method] - (self.mean(method) if about_mean else 0.0))
        # The slow way only where a frame has no pose.
        percentile = np.nanpercentile if np.isnan(errors).any() else np.percentile
        return np.asarray(percentile(errors, 95, axis=0))

    def ratio(self, method: str) -> Array:
        """RMS error over the bound of a single frame, frame by frame, shape ``(FRAMES, 5)``."""
        return np.sqrt(np.nanmean(self.errors[method] ** 2, axis=0)) / self.bound

    def without_pose(self, method: str) -> int:
        """Count the frames without a pose."""
        return int(np.isnan(self.errors[method][..., 0]).sum())


def simulate(
    scene: Scene,
    case: Case,
    choices: Choices,
    runs: int,
    rng: Generator,
    done: Callable[[int], object] = lambda runs: None,
    batch: int = BATCH,
) -> ApproachErrors:
    """Run a case by every method, `batch` runs at a time.

    `rng` is the source of calibration, offsets and noise; `done` is called with the number of runs
    after every batch. Ctrl-C ends it with the complete batches, and is raised before the first.
    """
    model = ForwardModel(assumed_scene(scene, case, choices))
    moments = calibrate(model, rng)
    estimator = Estimator(model.scene, "least_squares").wait()
    motion = Motion(model, STEP_S, DOCKING)
    batches: list[dict[str, Array]] = []
    try:
        for start in range(0, runs, batch):
            count = min(batch, runs - start)
            offsets = draw_offsets(choices, count, rng)
            images = expose(model, case.path, offsets, choices.noise, rng)
            single, tracked = _by_least_squares(estimator, images)
            docking = by_docking(motion, images, single[:, 0])
            poses = (dead_reckoned(moments.poses(images)), single, tracked, docking)
            batches.append({m: p - case.path for m, p in zip(METHODS, poses, strict=True)})
            done(count)
    except KeyboardInterrupt:
        if not batches:
            raise
    return ApproachErrors(
        {method: np.concatenate([errors[method] for errors in batches]) for method in METHODS},
        cramer_rao_bound(model, case.path).std,
        bound(motion, case.path),
    )


def _by_least_squares(estimator: Estimator, images: Array) -> tuple[Array, Array]:
    """Estimate all frames of all runs, as single images and as a track."""
    scene, runs = estimator.scene, len(images)
    single, tracked = np.full((runs, FRAMES, 5), np.nan), np.full((runs, FRAMES, 5), np.nan)
    parameters = key_parameters(images, scene.full_scale_counts, scene.signature.peak)
    for run_number in range(runs):
        tracker = Tracker(TrackerSettings())
        for frame, time_s in enumerate(TIMES_S):
            at = run_number, frame
            with suppress(NoPose):
                estimate = estimator.estimate(images[at], parameters[at])
                single[at] = estimate.pose
                stamp_ns = round(time_s * 1e9)
                tracked[at] = tracker.update(stamp_ns, estimate.pose, estimate.covariance).pose
    return single, tracked


def by_docking(motion: Motion, images: Array, first: Array) -> Array:
    """Smooth all runs at once; a run without a `first` pose, shape ``(n, 5)``, gets none."""
    poses, started = np.full((len(images), FRAMES, 5), np.nan), ~np.isnan(first[:, 0])
    if started.any():
        poses[started], _, _ = smoothed(motion, images[started], first[started])
    return poses
