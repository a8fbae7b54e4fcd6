"""The measurements of `tradeoff` and `advise`: error and time of each setting, into a CSV file.

A setting is a method, an array and the size of its table. A run that was stopped goes on with the
settings that are missing in its file.
"""

import dataclasses
import math
import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from uuv_optical_array.cli import progress
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import METHODS, Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward import working_volume
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.shared import errors, published
from uuv_optical_array.studies.shared.results import Line, Results

SETTINGS_CSV = "tradeoff.csv"
SEED = 1
Mode = Literal["quick", "full"]

# Our methods have a table of any size, the published ones that of their publication.
LOOK_UP, MOMENTS = "look_up", "moments"
PUBLISHED: tuple[str, ...] = (LOOK_UP, MOMENTS)
ALL_METHODS = (*PUBLISHED, *METHODS)
SIDES = (3, 5, 7, 21)
SHAPES: tuple[Shape, ...] = ("curved", "planar")
# Values along each of the five axes: 1e3, 8e3, 1e5, 1e6 and 1e7 poses.
STEPS: tuple[int, ...] = (4, 6, 10, 16, 25)
FRAMES: dict[Mode, int] = {"quick": 300, "full": 1000}
QUICK_LOOK_UP_SIDE = 7
# A setting that leaves more frames than this without a pose has no fair error, and is no choice.
MOST_WITHOUT_POSE = 0.01
# Work as a number of rows of a table: the images of a calibration, a look-up, and a frame.
OTHER_WORK = {
    MOMENTS: published.SAMPLES * 435,
    LOOK_UP: math.prod(span.number for span in vars(published.GRID).values()),
}
FRAME_WORK = 300


class Group(NamedTuple):
    """Settings that share an array and a table, and are measured in turn, frame by frame."""

    shape: Shape
    detectors_per_side: int
    steps: int  # values along each axis of the table; 0: published methods have their own
    methods: tuple[str, ...]  # all of ours, or a published one

    def scene(self, scene: Scene) -> Scene:
        """Return the scene with this array, and with a table of the working volume."""
        array = scene.array.with_shape(self.shape)
        array = dataclasses.replace(array, detectors_per_side=self.detectors_per_side, wiring=None)
        table = working_volume.volume_table(self.steps) if self.steps else scene.table
        return dataclasses.replace(scene, array=array, table=table)

    def work(self, frames: int) -> int:
        """Estimate how much work it is to measure so many frames."""
        own = OTHER_WORK.get(self.methods[0], self.steps**5)
        return own + frames * len(self.methods) * FRAME_WORK


def plan(scene: Scene, mode: Mode) -> list[Group]:
    """List the groups of a run, those of the scene's own array first."""
    own = scene.array
    sides = sorted({*SIDES, own.detectors_per_side}, key=lambda n: (n != own.detectors_per_side, n))
    groups = []
    for shape in sorted(SHAPES, key=lambda shape: shape != own.shape):
        for side in sides:
            steps, methods = STEPS, PUBLISHED
            if mode == "quick":
                steps = STEPS[2:3]
                if shape == own.shape:
                    steps = STEPS[:4] if side == own.detectors_per_side else STEPS[:3]
                if shape != "planar" or side > QUICK_LOOK_UP_SIDE:
                    methods = (MOMENTS,)
            groups += [Group(shape, side, n, METHODS) for n in steps]
            groups += [Group(shape, side, 0, (method,)) for method in methods]
    return groups


def this_machine() -> str:
    """Name the processor and the number of its cores: times hold for one machine."""
    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            name = next(line.partition(":")[2] for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return f"{' '.join(name.split())}, {os.cpu_count()} cores"


def origin_of(scene: Scene, mode: Mode, seed: int = SEED) -> dict[str, Any]:
    """Return what a measurement made now depends on beside its setting."""
    about = {"scene": scene.name, "fingerprint": scene.fingerprint, "machine": this_machine()}
    return {**about, "mode": mode, "frames": FRAMES[mode], "seed": seed}


@dataclass(frozen=True)
class Measurement(Line):
    """The measured error and time of one setting, which is as in `Group`.

    Errors and bounds are RMS distances, and angles of pitch and yaw together: nan where no frame
    got a pose, inf where a pose is unobservable.
    """

    method: str
    shape: Shape
    detectors_per_side: int
    steps: int
    table_rows: int
    without_pose: float  # share of the frames
    position_m: float
    angle_deg: float
    bound_position_m: float  # by Cramer and Rao, of the image alone
    bound_angle_deg: float
    floor_position_m: float  # with the volume known, as `known_volume_std`
    floor_angle_deg: float
    median_ms: float  # from image to pose
    p99_ms: float
    model_ms: float  # of a forward model of the scene's own array, timed between the frames
    models: float  # `median_ms` over it, which hardly depends on how busy the machine is
    build_s: float  # of table or calibration
    load_average: float

    @property
    def label(self) -> str:
        """The setting in words."""
        side = self.detectors_per_side
        table = f", table {self.table_rows:.0e}".replace("e+0", "e") if self.table_rows else ""
        return f"{self.method}, {self.shape} {side} x {side}{table}"

    @property
    def effort(self) -> tuple[float, ...]:
        """The order of settings: fewest detectors, smallest table, least time."""
        return self.detectors_per_side, self.table_rows, self.median_ms


def _answers(
    scene: Scene, methods: Sequence[str], rng: np.random.Generator
) -> tuple[dict[str, errors.Answer], int]:
    """Return how each method of a group answers, and the rows of its table, if any."""
    if methods == (MOMENTS,):
        try:
            moments = published.calibrate(ForwardModel(scene), rng).pose
        except (np.linalg.LinAlgError, ValueError):
            return {MOMENTS: _no_calibration}, 0
        return {MOMENTS: lambda image: (moments(image), math.nan)}, 0
    if methods == (LOOK_UP,):
        table = build_table(published.lookup_scene(scene))
        look_up = published.LookUp(table).pose
        return {LOOK_UP: lambda image: (look_up(image), math.nan)}, len(table.poses)
    table = build_table(scene)
    ours: dict[str, errors.Answer] = {
        name: errors.answer_of(Estimator(table, name).wait()) for name in METHODS
    }
    return ours, len(table.poses)


def _no_calibration(image: Array) -> tuple[Array, float]:
    raise NoPose("no calibration: the array cannot be calibrated at the paper's poses")


def measure(scene: Scene, group: Group, frames: int, seed: int) -> list[Measurement]:
    """Measure the settings of a group; an array sees the same images in every group."""
    yardstick, scene = ForwardModel(scene), group.scene(scene)
    model, side = ForwardModel(scene), group.detectors_per_side
    rng = np.random.default_rng([seed, side, SHAPES.index(group.shape)])
    poses = working_volume.lit_poses(model, frames, rng)
    images = model.expose(poses, rng)
    began = time.perf_counter()
    answers, rows = _answers(scene, group.methods, rng)
    build_s = time.perf_counter() - began
    results = errors.frame_errors(answers, yardstick, poses, images)
    if any(len(result.errors) < frames for result in results.values()):
        raise KeyboardInterrupt  # cut short, so no measurement
    bound = cramer_rao_bound(model, poses)
    floor = working_volume.known_volume_std(bound.information)
    least = *errors.position_and_angle(bound.std), *errors.position_and_angle(floor)
    measured = []
    for method, result in results.items():
        setting = method, group.shape, side, group.steps, rows, float((~result.posed).mean())
        off = errors.position_and_angle(result.errors[result.posed])
        times = *result.frame_ms, result.model_ms, result.frame_ms[0] / result.model_ms, build_s
        measured.append(Measurement(*setting, *off, *least, *times, os.getloadavg()[0]))
    return measured


def measure_missing(scene: Scene, groups: Sequence[Group], results: Results[Measurement]) -> bool:
    """Measure the groups that the results lack, with progress, and say whether all is there.

    Ctrl-C ends it with the groups before it; it is raised where there are none.
    """
    rows = results.lines
    measured = {(row.method, row.shape, row.detectors_per_side, row.steps) for row in rows}
    left = [g for g in groups if not {(method, *g[:3]) for method in g.methods} <= measured]
    if not left:
        return True
    folder, frames, seed = results.path.parent, results.origin["frames"], results.origin["seed"]
    folder.mkdir(parents=True, exist_ok=True)
    count, total = sum(len(g.methods) for g in groups), sum(g.work(frames) for g in left)
    already = f", {len(rows)} are there" if rows else ""
    print(f"{count} settings{already}; into {folder}", file=sys.stderr)
    try:
        with progress.counter(100, "%") as bar:
            for group in left:
                side, table = group.detectors_per_side, f" {group.steps}^5" * (group.steps > 0)
                bar.set_description(f"{group.methods[-1]} {group.shape} {side} x {side}{table}")
                results.append(measure(scene, group, frames, seed))
                bar.update(100 * group.work(frames) / total)
    except KeyboardInterrupt:
        if not results.lines:
            raise
        return False
    return True
