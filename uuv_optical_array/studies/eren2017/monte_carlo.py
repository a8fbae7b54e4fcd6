"""The Monte Carlo of approaches: the published method and ours on the same images."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import IN_DEGREES, Array
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.docking_smoother import DockingSettings, DockingSmoother
from uuv_optical_array.studies.eren2017.approach import (
    CASES,
    FRAMES,
    RANGES_M,
    STEP_S,
    TIMES_S,
    Case,
    Choices,
    believed,
    draw_offsets,
    expose,
)
from uuv_optical_array.studies.errors import by_column
from uuv_optical_array.studies.published import (
    MomentCalibration,
    calibrate,
    dead_reckoned,
    measure_moments,
)

BATCH = 20
# The simulated vehicle holds its speed and does not drift.
DOCKING = DockingSettings(speed_walk_m_per_s=0.005, slip_m=0.005)
METHODS = ("moments", "least_squares", "tracker", "docking")
SIGMA_95 = 1.96
WIDE_BEAM_DEG = 15.0


@dataclasses.dataclass(frozen=True)
class ApproachErrors:
    """What a case showed, over n runs.

    Parameters
    ----------
    errors
        By method, estimate less truth, m and rad, shape ``(n, FRAMES, 5)``; nan without a pose.
    bound
        Least standard deviation by a single frame with what is known of the water, the
        Cramer-Rao bound, m and rad, shape ``(FRAMES, 5)``.
    run_bound
        The same by all frames so far and what `DOCKING` says of the motion.
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
    rng: np.random.Generator,
    done: Callable[[int], object] = lambda runs: None,
) -> ApproachErrors:
    """Run a case; an interrupt ends it with the runs it has.

    Parameters
    ----------
    scene
        The tank.
    case, choices
        What to run.
    runs
        How many, >= 1.
    rng
        Source of calibration, offsets and noise.
    done
        Called with the number of runs after every batch.

    Returns
    -------
    ApproachErrors
        Of every method in `METHODS`.

    Raises
    ------
    KeyboardInterrupt
        Before the first batch was done.
    """
    sea = believed(scene, case, choices)
    model = ForwardModel(sea)
    moments = calibrate(model, rng)
    estimator = Estimator(sea, "least_squares").wait()
    batches: dict[str, list[Array]] = {method: [] for method in METHODS}
    try:
        for start in range(0, runs, BATCH):
            count = min(BATCH, runs - start)
            offsets = draw_offsets(choices, count, rng)
            images = expose(model, case.path, offsets, choices.noise, rng)
            found = {"moments": by_moments(moments, images)}
            found["least_squares"], found["tracker"] = by_least_squares(estimator, images)
            docking = DockingSmoother(model, STEP_S, DOCKING)
            found["docking"] = by_docking(docking, images, found["least_squares"][:, 0])
            for method, poses in found.items():
                batches[method].append(poses - case.path)
            done(count)
    except KeyboardInterrupt:
        if not batches[METHODS[-1]]:
            raise
    whole = len(batches[METHODS[-1]])
    return ApproachErrors(
        {method: np.concatenate(errors[:whole]) for method, errors in batches.items()},
        cramer_rao_bound(model, case.path).std,
        DockingSmoother(model, STEP_S, DOCKING).bound(case.path),
    )


def by_moments(calibration: MomentCalibration, images: Array) -> Array:
    """Estimate all frames of all runs by image moments, shape ``(n, FRAMES, 5)``."""
    return dead_reckoned(calibration.poses(measure_moments(images, calibration.spacing_m)))


def by_least_squares(estimator: Estimator, images: Array) -> tuple[Array, Array]:
    """Estimate all frames of all runs, each by itself and as a track."""
    scene, runs = estimator.scene, len(images)
    single, tracked = np.full((runs, FRAMES, 5), np.nan), np.full((runs, FRAMES, 5), np.nan)
    parameters = key_parameters(images, scene.full_scale_counts, scene.signature.peak)
    for run in range(runs):
        tracker = Tracker(TrackerSettings())
        for frame in range(FRAMES):
            with suppress(NoPose):
                estimate = estimator.estimate(images[run, frame], parameters[run, frame])
                single[run, frame] = estimate.pose
                stamp_ns = round(TIMES_S[frame] * 1e9)
                track = tracker.update(stamp_ns, estimate.pose, estimate.covariance)
                tracked[run, frame] = track.pose
    return single, tracked


def by_docking(docking: DockingSmoother, images: Array, first: Array) -> Array:
    """Smooth all runs at once; a run without a `first` pose, shape ``(n, 5)``, gets none."""
    poses = np.full((len(images), FRAMES, 5), np.nan)
    begun = np.flatnonzero(~np.isnan(first[:, 0]))
    if len(begun):
        for frame in range(FRAMES):
            poses[begun, frame], _ = docking.update(images[begun, frame], first[begun])
    return poses


def alternatives(scene: Scene) -> dict[str, tuple[Scene, Choices]]:
    """Return the choices that are compared where the paper leaves one open, by name."""
    wide = dataclasses.replace(
        scene, lamp=dataclasses.replace(scene.lamp, beam_sigma_deg=WIDE_BEAM_DEG)
    )
    return {
        "as by default": (scene, Choices()),
        "noise gaussian": (scene, Choices("gaussian")),
        "noise averaged": (scene, Choices("averaged")),
        "offsets half": (scene, Choices(offset_share=0.5)),
        f"beam {WIDE_BEAM_DEG:g} deg": (wide, Choices()),
    }


def all_cases(
    scene: Scene,
    choices: Choices,
    runs: int,
    seed: int,
    done: Callable[[int], object] = lambda runs: None,
) -> Iterator[tuple[str, ApproachErrors]]:
    """Run case after case; an interrupt ends it with the runs it has.

    Parameters
    ----------
    scene, choices, runs, done
        As in `simulate`.
    seed
        Of the random numbers, the same in every case.

    Yields
    ------
    str
        Name of the case, of `CASES`.
    ApproachErrors
        What it showed; the last one perhaps of fewer runs.
    """
    for name, case in CASES.items():
        try:
            found = simulate(scene, case, choices, runs, np.random.default_rng(seed), done)
        except KeyboardInterrupt:
            return
        yield name, found
        if found.runs < runs:
            return


def as_object(case: Case, found: ApproachErrors) -> dict[str, Any]:
    """Return a case as plain values, in m and deg."""
    methods = {}
    for method in METHODS:
        ends = found.percentile_95(method) * IN_DEGREES
        about_mean = found.percentile_95(method, about_mean=True) * IN_DEGREES
        ratio = found.ratio(method)
        methods[method] = {
            "mean_end": by_column(found.mean(method)[-1] * IN_DEGREES),
            "start_95": by_column(ends[0]),
            "end_95": by_column(ends[-1]),
            "start_95_about_mean": by_column(about_mean[0]),
            "end_95_about_mean": by_column(about_mean[-1]),
            "ratio_to_bound": {
                f"{metres:g} m": by_column(ratio[frame])
                for frame, metres in list(enumerate(RANGES_M.round(1)))[::5]
            },
            "without_pose": found.without_pose(method),
        }
    published = case.published
    return {
        "runs": found.runs,
        "published": {name: by_column(values) for name, values in vars(published).items()},
        "aim_end_95": by_column(published.aim),
        "methods": methods,
        "bound_end_95": by_column(SIGMA_95 * found.bound[-1] * IN_DEGREES),
        "run_bound_end_95": by_column(SIGMA_95 * found.run_bound[-1] * IN_DEGREES),
    }
