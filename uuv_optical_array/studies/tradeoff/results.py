"""What `tradeoff` measured, as CSV: every line names its run, and a file is always whole."""

import csv
import dataclasses
import io
import math
import os
import platform
import statistics
import typing
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from uuv_optical_array.core import files
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.scene import Scene

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
        return (self.fingerprint, self.machine) == (scene.fingerprint, this_machine())


@dataclass(frozen=True)
class Row:
    """One setting and what was measured of it: a line of the CSV.

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
        One forward model with Jacobian of `accuracy.MODEL_POSES` poses, of the scene's own array,
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

    def as_object(self) -> dict[str, Any]:
        """Return plain values; None is not known."""
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in vars(self).items()
        }

    @property
    def label(self) -> str:
        """The setting in words."""
        side = self.detectors_per_side
        table = f", table {self.table_rows:.0e}".replace("e+0", "e") if self.table_rows else ""
        return f"{self.method}, {self.shape} {side} x {side}{table}"


def at_one_speed(rows: Sequence[Row]) -> list[Row]:
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
class TableCost:
    """What a table costs where it is used: a line of the second CSV.

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


R = TypeVar("R", bound="Row | TableCost")


def _read(kind: type[Any], line: dict[str, str]) -> Any:
    hints = typing.get_type_hints(kind)
    return kind(
        **{
            field.name: hints[field.name](line[field.name])
            if hints[field.name] in (int, float)
            else line[field.name]
            for field in dataclasses.fields(kind)
        }
    )


def read_csv(path: Path, kind: type[R]) -> tuple[Origin | None, list[R]]:
    """Read a file of measurements.

    Parameters
    ----------
    path
        The file; one that is not there holds nothing.
    kind
        `Row` or `TableCost`.

    Returns
    -------
    origin : Origin or None
        Of all lines; None where there are none.
    rows : list
        The lines.

    Raises
    ------
    ValueError
        For a line that is damaged, or of another origin than the first.
    """
    if not path.exists():
        return None, []
    origins: list[Origin] = []
    rows: list[R] = []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for number, line in enumerate(csv.DictReader(file, strict=True), start=2):
                try:
                    origins.append(_read(Origin, line))
                    rows.append(_read(kind, line))
                except (KeyError, TypeError, ValueError):
                    raise ValueError(f"line {number} is no measurement") from None
                if origins[-1] != origins[0]:
                    raise ValueError(f"line {number} is of another run than the first")
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{path}: {error}; remove the file or name another --output") from None
    return (origins[0] if origins else None), rows


class Ledger(Generic[R]):
    """A CSV that grows, written anew as a whole each time.

    Parameters
    ----------
    path
        The file; where it exists, its rows are taken over.
    kind
        `Row` or `TableCost`.
    origin
        Of this run.

    Raises
    ------
    ValueError
        For a file of another run, or a damaged one.
    """

    def __init__(self, path: Path, kind: type[R], origin: Origin) -> None:
        there, rows = read_csv(path, kind)
        self.rows: list[R] = rows
        if there is not None:
            differ = [
                f"{field.name} {getattr(there, field.name)}, not {getattr(origin, field.name)}"
                for field in dataclasses.fields(Origin)
                if field.name != "scene"
                and getattr(there, field.name) != getattr(origin, field.name)
            ]
            if differ:
                raise ValueError(
                    f"{path}: holds measurements of another run ({'; '.join(differ)}); "
                    "remove the file or name another --output"
                )
        self.path, self.origin = path, origin
        self.kind: type[R] = kind

    def append(self, rows: Iterable[R]) -> None:
        """Add rows, all or none of them."""
        together = [*self.rows, *rows]
        text = io.StringIO()
        names = [field.name for kind in (Origin, self.kind) for field in dataclasses.fields(kind)]
        writer = csv.DictWriter(text, names, lineterminator="\n")
        writer.writeheader()
        for row in together:
            writer.writerow({**vars(self.origin), **vars(row)})
        files.write_text(self.path, text.getvalue())
        self.rows = together
