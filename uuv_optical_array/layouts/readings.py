"""Tables of readings and places, as people have them, as a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import IN_DEGREES, Array
from uuv_optical_array.core.storage import tables
from uuv_optical_array.layouts.detectors import Layout, number_in
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.places import LEAST_STD, POSE, STDS

TIME, ROLL = "time_s", "roll_deg"
NAMES = (*POSE, *STDS, ROLL)  # what may be given of a place
PARTS = (*POSE, ROLL)
LARGEST_M, LARGEST_DEG = 1000.0, 360.0  # of a place; more is in another unit
LARGEST_S = 9e9  # a stamp has to fit into nanoseconds


@dataclass(frozen=True)
class Table:
    """Rows of a table of numbers.

    - path: of the file.
    - seconds: of each row, s, ascending, or its number; shape ``(m,)``.
    - readings: in the file's unit, shape ``(m, L, n)``; of 0 detectors in a table of poses.
    - told: columns of `NAMES`, shape ``(m,)`` each, m and deg, nan in empty cells.
    - timed: whether it has times.
    """

    path: Path
    seconds: Array
    readings: Array
    told: Mapping[str, Array]
    timed: bool


def read_table(path: Path, names: Sequence[str] = (), lamps: int = 1) -> Table:
    """Read a table that has readings in the columns `names`, or of several lamps ``NAME.i``.

    It may have `TIME` and any column of `NAMES`; others are not read. ValueError, with the line,
    for a column that is missing, or a cell that is no number; empty ones are allowed of places.
    """
    head, table = tables.read(path)
    wanted = [f"{name}.{i}" for i in range(lamps) for name in names] if lamps > 1 else [*names]
    if missing := [name for name in wanted if name not in head]:
        of_lamps = " (NAME.0 is of the first lamp)" if lamps > 1 else ""
        raise ValueError(
            f"{path}: no column {', '.join(missing[:8])}{', ...' * (len(missing) > 8)} of a "
            f"detector{of_lamps}; its columns are {', '.join(head) or 'none'}"
        )
    timed, there = TIME in head, [name for name in NAMES if name in head]
    seconds, readings, told = [], [], []
    for line, cells in table:
        at = f"{path}: line {line}"
        if timed:
            seconds.append(number_in(cells[TIME], f"{at}: {TIME}"))
        readings.append([number_in(cells[name], f"{at}: {name}") for name in wanted])
        told.append([_place(cells[name], f"{at}: {name}", name) for name in there])
        if timed and not 0 <= seconds[-1] <= LARGEST_S:
            raise ValueError(f"{at}: {TIME}: {seconds[-1]:g}; give seconds from 0 to {LARGEST_S:g}")
        if timed and seconds[-1] < max(seconds):
            raise ValueError(
                f"{at}: {TIME}: {seconds[-1]:g} comes after {max(seconds):g}; sort the rows by it"
            )
    if not readings:
        raise ValueError(f"{path}: no row below the columns; give one at least")
    columns = np.array(told, dtype=float).reshape(len(readings), len(there)).T
    return Table(
        path,
        np.array(seconds) if timed else np.arange(len(readings), dtype=float),
        np.array(readings, dtype=float).reshape(len(readings), lamps, len(names)),
        dict(zip(there, columns, strict=True)),
        timed,
    )


def _place(cell: str, where: str, name: str) -> float:
    if not cell:
        return np.nan
    value = number_in(cell, where)
    largest = LARGEST_M if name.endswith("_m") else LARGEST_DEG
    low = 0.0 if name in STDS else -largest
    if not low <= value <= largest:
        raise ValueError(f"{where}: {value:g}; it must be from {low:g} to {largest:g}")
    return value


@dataclass(frozen=True)
class Told:
    """What is given of places: poses and their errors, m and rad, nan where nothing is.

    The shapes are ``(m, 5)``; of the rolls, rad, ``(m,)``.
    """

    poses: Array
    stds: Array
    rolls: Array


def told_of(columns: Mapping[str, Array], count: int) -> Told:
    """Return what columns give of `count` rows."""

    def of(names: Sequence[str]) -> Array:
        none = np.full(count, np.nan)
        return np.column_stack([columns.get(name, none) for name in names]) / IN_DEGREES

    rolls = np.radians(columns.get(ROLL, np.full(count, np.nan)))
    return Told(of(POSE), np.maximum(of(STDS), LEAST_STD), rolls)


def recording_of(table: Table, layout: Layout, counts_per_unit: float) -> Recording:
    """Return readings as images of a layout's grid, with the poses of their own table.

    ValueError for readings beyond full scale, as of a unit that is not the scene's.
    """
    told = told_of(table.told, len(table.seconds))
    readings = table.readings * counts_per_unit
    full = layout.scene.full_scale_counts
    limited = "adc" in layout.scene.effects or "saturation" in layout.scene.effects
    if limited and (over := int((readings > full).sum())):
        brightest = readings.max() / counts_per_unit
        raise ValueError(
            f"{table.path}: {over} readings are above full scale, {full:g} counts, at "
            f"{counts_per_unit:g} counts a unit; the largest is {brightest:g}; set "
            "counts_per_unit, or the scene's adc and saturation"
        )
    return Recording(
        layout.images(readings),
        told.poses,
        np.nan_to_num(told.rolls),
        stamps_of(table.seconds),
    )


def stamps_of(seconds: Array) -> NDArray[np.int64]:
    """Return times, s, in whole ns."""
    return np.rint(seconds * 1e9).astype(np.int64)


class Course:
    """Poses by time of a table that gives some or all of their parts, interpolated."""

    def __init__(self, table: Table, max_gap_s: float) -> None:
        if not table.timed:
            raise ValueError(f"{table.path}: no column {TIME}; give the time of each pose")
        parts = [name for name in PARTS if name in table.told]
        if not parts:
            raise ValueError(f"{table.path}: has none of {', '.join(PARTS)}; give one at least")
        self._max_gap_s = max_gap_s
        # Columns of a pose that it gives.
        self.parts = [i for i, name in enumerate(POSE) if name in parts]
        self._samples = {}
        for name in parts:
            known = ~np.isnan(table.told[name])
            times, values = table.seconds[known], table.told[name][known]
            if len(times) < 2 or times[0] == times[-1]:
                raise ValueError(
                    f"{table.path}: {name}: {len(times)} values; give values at two times or more"
                )
            if not name.endswith("_m"):
                values = np.unwrap(values, period=360.0)
            self._samples[name] = times, values

    def at(self, stamps_ns: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return poses and rolls, m and rad, at stamps; nan outside, in long gaps, or not given.

        A vehicle whose roll is not given does not roll.
        """
        seconds = stamps_ns * 1e-9
        columns = {}
        for name, (times, values) in self._samples.items():
            after = np.clip(np.searchsorted(times, seconds), 1, len(times) - 1)
            apart = times[after] - times[after - 1]
            there = (seconds >= times[0]) & (seconds <= times[-1]) & (apart <= self._max_gap_s)
            columns[name] = np.where(there, np.interp(seconds, times, values), np.nan)
        columns.setdefault(ROLL, np.zeros(len(seconds)))
        told = told_of(columns, len(seconds))
        return told.poses, told.rolls
