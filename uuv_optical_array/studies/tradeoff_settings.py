"""The settings that `tradeoff` and `advise` compare, and the lines of their CSV file.

A setting is a method, an array and the size of its table.
"""

import dataclasses
import os
import platform
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from uuv_optical_array.estimation.estimator import METHODS
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import volume_table
from uuv_optical_array.studies.results import Flat, differences

Mode = Literal["quick", "full"]

# Our methods have a table of any size, the published ones that of their publication.
LOOK_UP, MOMENTS = "look_up", "moments"
PUBLISHED = (LOOK_UP, MOMENTS)
ALL_METHODS = (*PUBLISHED, *METHODS)
SIDES = (3, 5, 7, 21)
SHAPES: tuple[Shape, ...] = ("curved", "planar")
# Values along each of the five axes: 1e3, 8e3, 1e5, 1e6 and 1e7 poses.
STEPS = (4, 6, 10, 16, 25)
FRAMES: dict[Mode, int] = {"quick": 300, "full": 1000}
QUICK_STEPS, QUICK_OWN_STEPS = (10,), (4, 6, 10, 16)
QUICK_LOOK_UP_SIDE = 7
QUICK_LEAVES_OUT = (
    "left out but for --full: tables of 1e7 poses, of 1e6 but on the scene's own array, of 1e3 and "
    "8e3 on arrays of the other shape, and the look-up but on planar arrays up to 7 x 7"
)
# A setting that leaves more frames than this without a pose has no fair error, and is no choice.
MOST_WITHOUT_POSE = 0.01


@dataclass(frozen=True)
class Group:
    """Settings that share an array and a table, and are measured together, frame by frame in turn.

    Parameters
    ----------
    shape, detectors_per_side
        The array.
    steps
        Values along each axis of the table; 0 for published methods, which have their own.
    methods
        Of `ALL_METHODS`.
    """

    shape: Shape
    detectors_per_side: int
    steps: int
    methods: tuple[str, ...]

    def scene(self, scene: Scene) -> Scene:
        """Return the scene with this array, and with a table of the working volume."""
        array = dataclasses.replace(
            scene.array.with_shape(self.shape),
            detectors_per_side=self.detectors_per_side,
            wiring=None,
        )
        table = volume_table(self.steps) if self.steps else scene.table
        return dataclasses.replace(scene, array=array, table=table)


def plan(scene: Scene, mode: Mode) -> list[Group]:
    """List the groups of a run, those of the scene's own array first."""
    own = scene.array
    sides = sorted({*SIDES, own.detectors_per_side}, key=lambda n: (n != own.detectors_per_side, n))
    groups = []
    for shape in sorted(SHAPES, key=lambda shape: shape != own.shape):
        for side in sides:
            steps: tuple[int, ...] = STEPS
            methods: tuple[str, ...] = PUBLISHED
            if mode == "quick":
                steps = QUICK_STEPS
                if shape == own.shape:
                    steps = QUICK_OWN_STEPS if side == own.detectors_per_side else STEPS[:3]
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


@dataclass(frozen=True)
class Origin:
    """What a measurement depends on beside its setting.

    Parameters
    ----------
    scene
        Its name, which is not compared.
    fingerprint
        Of the scene.
    machine
        As `this_machine`.
    mode
        ``quick`` or ``full``.
    frames
        Images for each setting.
    seed
        Of poses and noise.
    """

    scene: str
    fingerprint: str
    machine: str
    mode: str
    frames: int
    seed: int

    @classmethod
    def here(cls, scene: Scene, mode: Mode, seed: int) -> "Origin":
        """Return the origin of what is measured now."""
        return cls(scene.name, scene.fingerprint, this_machine(), mode, FRAMES[mode], seed)

    def is_here(self, scene: Scene) -> bool:
        """Say whether this is the scene and this machine."""
        here = dataclasses.replace(self, fingerprint=scene.fingerprint, machine=this_machine())
        return not differences(self, here)


@dataclass(frozen=True)
class Measurement(Flat):
    """The measured error and time of one setting.

    Parameters
    ----------
    method, shape, detectors_per_side, steps
        The setting, as in `Group`.
    table_rows
        Poses in the table that was used.
    without_pose
        Share of frames without a pose.
    position_m, angle_deg
        Root mean square of the distance between estimate and truth, and of the angle: pitch and
        yaw errors as a root sum of squares; nan where no frame got a pose.
    bound_position_m, bound_angle_deg
        The same of the Cramer-Rao bound of the image alone; inf where a pose is unobservable.
    floor_position_m, floor_angle_deg
        The same with the volume known: a Gaussian prior of its variance.
    median_ms, p99_ms
        From image to pose.
    model_ms
        One forward model with Jacobian of `errors.MODEL_POSES` poses, of the scene's own array,
        timed between the frames, median.
    models
        `median_ms` over `model_ms`: a time that hardly depends on how busy the machine is.
    build_s
        Building table or calibration.
    load_average
        Of the machine over a minute, when it was measured.
    """

    method: str
    shape: Shape
    detectors_per_side: int
    steps: int
    table_rows: int
    without_pose: float
    position_m: float
    angle_deg: float
    bound_position_m: float
    bound_angle_deg: float
    floor_position_m: float
    floor_angle_deg: float
    median_ms: float
    p99_ms: float
    model_ms: float
    models: float
    build_s: float
    load_average: float

    @property
    def setting(self) -> tuple[str, str, int, int]:
        """The setting, for comparison."""
        return self.method, self.shape, self.detectors_per_side, self.steps

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


def at_one_speed(rows: Sequence[Measurement]) -> list[Measurement]:
    """Return rows with times as if the machine had been as fast for all as for the median one."""
    model_ms = statistics.median([row.model_ms for row in rows]) if rows else 0.0
    return [
        dataclasses.replace(
            row,
            median_ms=row.median_ms * model_ms / row.model_ms,
            p99_ms=row.p99_ms * model_ms / row.model_ms,
            model_ms=model_ms,
        )
        for row in rows
    ]
