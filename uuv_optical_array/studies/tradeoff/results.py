"""What the trade-off measures, as lines of its two CSV files."""

import dataclasses
import os
import platform
import statistics
import typing
from collections.abc import Sequence
from dataclasses import dataclass

from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.results import Flat, differences

Mode = typing.Literal["quick", "full"]
SETTINGS_CSV, TABLES_CSV = "tradeoff.csv", "tables.csv"


def this_machine() -> str:
    """Name the processor and the number of its cores: times hold for one machine."""
    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            name = next(line.partition(":")[2] for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return f"{' '.join(name.split())}, {os.cpu_count()} cores"


def load_average() -> float:
    """Return how many processes wanted to run, on average over the last minute."""
    return os.getloadavg()[0]


@dataclass(frozen=True)
class Origin:
    """What a measurement depends on beside its setting.

    Parameters
    ----------
    scene
        Its name, which does not count.
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
    def here(cls, scene: Scene, mode: Mode, frames: int, seed: int) -> "Origin":
        """Return the origin of what is measured now."""
        return cls(scene.name, scene.fingerprint, this_machine(), mode, frames, seed)

    def same_place(self, scene: Scene) -> bool:
        """Say whether this is the scene and this machine."""
        here = dataclasses.replace(self, fingerprint=scene.fingerprint, machine=this_machine())
        return not differences(self, here)


@dataclass(frozen=True)
class Measurement(Flat):
    """One setting and what was measured of it.

    Parameters
    ----------
    method, shape, detectors_per_side, steps
        The setting, as in `Group`.
    table_rows
        Poses in the table that was used.
    without_pose
        Share of frames that got no pose.
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
        One forward model with Jacobian of `frame_errors.MODEL_POSES` poses, of the scene's own
        array, timed between the frames, median.
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
    def label(self) -> str:
        """The setting in words."""
        side = self.detectors_per_side
        table = f", table {self.table_rows:.0e}".replace("e+0", "e") if self.table_rows else ""
        return f"{self.method}, {self.shape} {side} x {side}{table}"


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


@dataclass(frozen=True)
class TableCost(Flat):
    """What a table costs where it is used.

    Parameters
    ----------
    steps, table_rows
        Values along each axis; poses that have light.
    build_s
        Time to compute it, s.
    file_mb
        Size on disk, MB.
    load_s
        From an empty process with its modules loaded to a ready estimator, s.
    memory_mb, peak_mb
        What the ready estimator holds, and held at most while it got ready, MB.
    load_average
        Of the machine over a minute, when it was measured.
    """

    steps: int
    table_rows: int
    build_s: float
    file_mb: float
    load_s: float
    memory_mb: float
    peak_mb: float
    load_average: float
