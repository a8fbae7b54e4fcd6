"""A table of measured places of the array, in place of both odometries, as on a rail in a tank."""

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import IN_DEGREES, Array
from uuv_optical_array.core.storage import tables
from uuv_optical_array.recording.images import Recording

POSE = ("x_m", "y_m", "z_m", "pitch_deg", "yaw_deg")
STDS = tuple(name.replace("_m", "_std_m").replace("_deg", "_std_deg") for name in POSE)
SPANS = (("image", "last_image"), ("time_s", "until_s"))
LEAST_STD = 1e-6  # m and rad: what a table calls exact
NEAR_S = 0.5  # an image of a time is at most so far from it


@dataclass(frozen=True)
class Places:
    """Rows of a table of places.

    - path: of the file.
    - rows: of each row its line in the file, and its numbers by column.
    """

    path: Path
    rows: Sequence[tuple[int, Mapping[str, float]]]


def read_places(path: Path) -> Places:
    """Read a table of places.

    It is CSV with the columns that the help of ``uuv_array calibrate`` explains; lines that begin
    with # are comments. ValueError, with the line, for any other table; OSError for a file that
    cannot be opened.
    """
    return Places(path, _rows(path))


def with_places(recording: Recording, places: Places) -> tuple[Recording, Array, NDArray[np.intp]]:
    """Return the images of a recording that a table names, with the poses that it gives them.

    With them come the poses' standard deviations, m and rad, ``(m, 5)``, and each image's place,
    its row of the table from 0 on, ``(m,)``. Images that no row names are counted as left out.
    ValueError, with the line, for a row without images or with those of another row.
    """
    path, rows = places.path, places.rows
    seconds = (recording.stamps_ns - recording.stamps_ns[0]) * 1e-9
    chosen: dict[int, int] = {}
    for place, (line, row) in enumerate(rows):
        images = _images(row, seconds)
        if not images or chosen.keys() & images:
            fault = "it has an image of another line" if images else "it has no image"
            held = f"the bag has {len(seconds)} in {seconds[-1]:.1f} s"
            raise ValueError(f"{path}: line {line}: {fault}; {held}")
        chosen |= dict.fromkeys(images, place)
    index = np.array(sorted(chosen), dtype=np.intp)
    refused = Counter(recording.refused)
    if unplaced := len(seconds) - len(index):
        refused[f"images of no line of {path.name}"] = unplaced
    numbers = np.array([chosen[i] for i in index.tolist()], dtype=np.intp)
    poses, stds = (
        np.array([[row[name] for name in names] for _, row in rows])[numbers] / IN_DEGREES
        for names in (POSE, STDS)
    )
    rolls = np.radians([row.get("roll_deg", 0.0) for _, row in rows])[numbers]
    kept = dataclasses.replace(
        recording,
        images=recording.images[index],
        poses=poses,
        rolls=rolls,
        stamps_ns=recording.stamps_ns[index],
        refused=refused,
        poses_at=None,
    )
    return kept, np.maximum(stds, LEAST_STD), numbers


def _rows(path: Path) -> list[tuple[int, dict[str, float]]]:
    """Return the numbers of each row by column, with its line in the file."""
    head, table = tables.read(path)
    begin, end = next((span for span in SPANS if span[0] in head), ("image or time_s", ""))
    needed = {begin, *POSE, *STDS}
    if needed - {*head} or {*head} - needed - {end, "roll_deg"}:
        raise ValueError(
            f"{path}: columns {', '.join(head) or 'none'}; give the columns "
            f"{', '.join((begin, *POSE, *STDS))}, perhaps {end or 'last_image'} and roll_deg"
        )
    rows = []
    for number, cells in table:
        try:
            row = {name: float(cell) for name, cell in cells.items()}
        except ValueError as error:
            raise ValueError(f"{path}: line {number}: {error}") from None
        for name, value in row.items():
            if not math.isfinite(value) or (name in STDS and value < 0):
                raise ValueError(
                    f"{path}: line {number}: {name}: {value}; give a number; an error is 0 or more"
                )
        rows.append((number, row))
    if not rows:
        raise ValueError(f"{path}: no place below the columns; give one at least")
    return rows


def _images(row: Mapping[str, float], seconds: Array) -> list[int]:
    if "image" in row:
        last = row.get("last_image", row["image"])
        return [i for i in range(len(seconds)) if row["image"] <= i <= last]
    if "until_s" in row:
        return np.flatnonzero((seconds >= row["time_s"]) & (seconds <= row["until_s"])).tolist()
    away = np.abs(seconds - row["time_s"])
    return [int(away.argmin())] if away.min() <= NEAR_S else []
