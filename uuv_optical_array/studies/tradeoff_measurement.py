"""The measurements of `tradeoff` and `advise`: error and time of each setting, into a CSV file.

A run that was stopped goes on with the settings that are missing in its file.
"""

import dataclasses
import math
import os
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from uuv_optical_array.cli import progress
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import METHODS, Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature_table import SignatureTable, build_table
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import known_volume_std, lit_poses
from uuv_optical_array.studies import published
from uuv_optical_array.studies.errors import Answer, answer_of, frame_errors, position_and_angle
from uuv_optical_array.studies.results import Results
from uuv_optical_array.studies.tradeoff_settings import (
    LOOK_UP,
    MOMENTS,
    SHAPES,
    STEPS,
    Group,
    Measurement,
    Mode,
    Origin,
)

SETTINGS_CSV = "tradeoff.csv"
# For the expected duration: a small sample, the images of a calibration and the rows of a look-up,
# which take as long as rows of a table, and the k-d tree of a table.
SAMPLE_FRAMES = 4
CALIBRATION_IMAGES = published.SAMPLES * 435
LOOK_UP_ROWS = math.prod(span.number for span in vars(published.GRID).values())
INDEX_S_PER_ROW = 1e-6


def _ours(table: SignatureTable, methods: Iterable[str]) -> dict[str, Answer]:
    """Return the answers of an estimator, with the default parameters of its node."""
    return {
        method: answer_of(Estimator(table, method).wait())  # type: ignore[arg-type]
        for method in methods
    }


def _moments(scene: Scene, rng: np.random.Generator) -> Answer:
    try:
        calibration = published.calibrate(ForwardModel(scene), rng)
    except (np.linalg.LinAlgError, ValueError) as error:
        reason = f"no calibration: {error}"

        def nothing(image: Array) -> tuple[Array, float]:
            raise NoPose(reason)

        return nothing
    return lambda image: (calibration.pose(image), math.nan)


def measure(scene: Scene, group: Group, frames: int, seed: int) -> list[Measurement]:
    """Measure the settings of a group.

    Parameters
    ----------
    scene
        The scene, whose array and table are replaced by those of the group.
    group
        What to measure.
    frames
        How many images, >= 1.
    seed
        Of poses and noise; an array sees the same images in every group.

    Returns
    -------
    list
        One for each of the group's methods.
    """
    yardstick, scene = ForwardModel(scene), group.scene(scene)
    side = group.detectors_per_side
    rng = np.random.default_rng([seed, side, SHAPES.index(group.shape)])
    model = ForwardModel(scene)
    poses = lit_poses(model, frames, rng)
    images = model.expose(poses, rng)
    began, rows = time.perf_counter(), 0
    if group.methods == (MOMENTS,):
        answers = {MOMENTS: _moments(scene, rng)}
        build_s = time.perf_counter() - began
    else:
        is_look_up = group.methods == (LOOK_UP,)
        table = build_table(published.lookup_scene(scene) if is_look_up else scene)
        build_s, rows = time.perf_counter() - began, len(table.poses)
        if is_look_up:
            look_up = published.LookUp(table)
            answers = {LOOK_UP: lambda image: (look_up.pose(image), math.nan)}
        else:
            answers = _ours(table, group.methods)
    results = frame_errors(answers, yardstick, poses, images)
    bound = cramer_rao_bound(model, poses)
    bound_position_m, bound_angle_deg = position_and_angle(bound.std)
    floor_position_m, floor_angle_deg = position_and_angle(known_volume_std(bound.information))
    measurements = []
    for method, result in results.items():
        if len(result.errors) < frames:  # cut short, so no measurement
            raise KeyboardInterrupt
        position_m, angle_deg = position_and_angle(result.errors[result.posed])
        median_ms, p99_ms = result.frame_ms
        measurements.append(
            Measurement(
                method=method,
                shape=group.shape,
                detectors_per_side=side,
                steps=group.steps,
                table_rows=rows,
                without_pose=float((~result.posed).mean()),
                position_m=position_m,
                angle_deg=angle_deg,
                bound_position_m=bound_position_m,
                bound_angle_deg=bound_angle_deg,
                floor_position_m=floor_position_m,
                floor_angle_deg=floor_angle_deg,
                median_ms=median_ms,
                p99_ms=p99_ms,
                model_ms=result.model_ms,
                models=median_ms / result.model_ms,
                build_s=build_s,
                load_average=os.getloadavg()[0],
            )
        )
    return measurements


def expected_s(scene: Scene, groups: Sequence[Group], frames: int) -> list[float]:
    """Estimate how long each group takes, s, from a small sample of each array."""
    samples: dict[tuple[Shape, int], tuple[float, float]] = {}
    rng = np.random.default_rng(0)
    expected = []
    for group in groups:
        key = group.shape, group.detectors_per_side
        if key not in samples:
            model = ForwardModel(dataclasses.replace(group, steps=min(STEPS)).scene(scene))
            poses = lit_poses(model, SAMPLE_FRAMES, rng)
            began = time.perf_counter()
            table = build_table(model.scene)
            row_s = (time.perf_counter() - began) / len(table.poses)
            images = model.expose(poses, rng)
            results = frame_errors(_ours(table, METHODS), model, poses, images)
            samples[key] = row_s, sum(float(r.frame_s.mean()) for r in results.values())
        row_s, frame_s = samples[key]
        if group.methods == (MOMENTS,):
            expected.append(CALIBRATION_IMAGES * row_s)
        elif group.methods == (LOOK_UP,):
            expected.append(LOOK_UP_ROWS * row_s)
        else:
            rows_s = group.steps**5 * (row_s + INDEX_S_PER_ROW)
            expected.append(rows_s + frames * frame_s)
    return expected


class TradeoffRun:
    """A run of measurements in a folder, finished or not.

    Parameters
    ----------
    scene, mode, seed
        What is measured.
    folder
        Where its CSV file is; made where it is missing.
    groups
        The plan of the run.

    Raises
    ------
    ValueError
        Where the file is of another run.
    """

    def __init__(
        self, scene: Scene, mode: Mode, seed: int, folder: Path, groups: Sequence[Group]
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.scene, self.folder, self.groups = scene, folder, groups
        self.origin = Origin.here(scene, mode, seed)
        self._settings = Results(folder / SETTINGS_CSV, Measurement, self.origin)

    @property
    def rows(self) -> list[Measurement]:
        """The settings that are measured."""
        return self._settings.lines

    @property
    def count(self) -> int:
        """How many settings there are to measure."""
        return sum(len(group.methods) for group in self.groups)

    def missing(self) -> list[Group]:
        """Return the groups that are not measured yet."""
        measured = {row.setting for row in self.rows}

        def settings(group: Group) -> set[tuple[str, str, int, int]]:
            array = group.shape, group.detectors_per_side, group.steps
            return {(method, *array) for method in group.methods}

        return [group for group in self.groups if not settings(group) <= measured]

    def measure(self) -> None:
        """Measure what is missing, with progress; an interrupt leaves the groups before it."""
        groups = self.missing()
        if not groups:
            return
        durations_s = expected_s(self.scene, groups, self.origin.frames)
        total_s = sum(durations_s)
        already = f", {len(self.rows)} are there" if self.rows else ""
        minutes = math.ceil(total_s / 60)
        print(
            f"{self.count} settings{already}; about {minutes} min; into {self.folder}",
            file=sys.stderr,
        )
        with progress.counter(100, "%", expected_s=total_s) as bar:
            for group, seconds in zip(groups, durations_s, strict=True):
                side, table = group.detectors_per_side, f" {group.steps}^5" if group.steps else ""
                bar.set_description(f"{group.methods[-1]} {group.shape} {side} x {side}{table}")
                origin = self.origin
                self._settings.append(measure(self.scene, group, origin.frames, origin.seed))
                bar.update(100 * seconds / total_s)
