"""A table of measured places: where the array was when images were taken, and how well it is known.

It takes the place of both odometries, as on a rail in a tank.
"""

import csv
import dataclasses
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import IN_DEGREES, Array
from uuv_optical_array.recording.images import Recording

POSE = ("x_m", "y_m", "z_m", "pitch_deg", "yaw_deg")
STDS = tuple(name.replace("_m", "_std_m").replace("_deg", "_std_deg") for name in POSE)
SPANS = (("image", "last_image"), ("time_s", "until_s"))
LEAST_STD = 1e-6  # m and rad: what a table calls exact
NEAR_S = 0.5  # an image of a time is at most so far from it


class Places(NamedTuple):
    """Images at measured places.

    - recording: the images that the table names, with their poses.
    - stds: of the poses, m and rad, shape ``(m, 5)``.
    - numbers: the place of each image, its row of the table from 0 on, shape ``(m,)``.
    """

    recording: Recording
    stds: Array
    numbers: NDArray[np.intp]


def with_places(recording: Recording, path: Path) -> Places:
    """Return the images of a recording that a table names, with the places that it gives them.

    The table is CSV. Its columns are ``image``, the number of an image from 0 on, or ``time_s``,
    seconds after the first image; ``x_m``, ``y_m``, ``z_m``, ``pitch_deg`` and ``yaw_deg`` of
    ``base_link`` in ``beacon``; ``x_std_m`` to ``yaw_std_deg``, how well each is known; and
    perhaps ``last_image`` or ``until_s``, where all images of a row share the place and its error,
    and ``roll_deg``. Lines that begin with # are comments.

    ValueError for a table that cannot be read, a column that is missing or not known, a number
    that is none, an error below 0, and a row without images or with those of another row; OSError
    for a file that cannot be opened.
    """
    seconds = (recording.stamps_ns - recording.stamps_ns[0]) * 1e-9
    chosen: dict[int, int] = {}
    rows = list(_rows(path))
    for place, (line, row) in enumerate(rows):
        images = _images(row, seconds)
        if not images:
            raise ValueError(
                f"{path}: line {line}: no image of it; the bag has {len(seconds)} in "
                f"{seconds[-1]:.1f} s"
            )
        if twice := [image for image in images if image in chosen]:
            raise ValueError(f"{path}: line {line}: image {twice[0]} is that of another line, too")
        chosen |= dict.fromkeys(images, place)
    index = np.array(sorted(chosen), dtype=np.intp)
    numbers = np.array([chosen[i] for i in index.tolist()], dtype=np.intp)
    values = [row for _, row in rows]
    poses, stds = (
        np.array([[row[name] for name in names] for row in values])[numbers] / IN_DEGREES
        for names in (POSE, STDS)
    )
    rolls = np.radians([row.get("roll_deg", 0.0) for row in values])[numbers]
    kept = dataclasses.replace(
        recording,
        images=recording.images[index],
        poses=poses,
        rolls=rolls,
        stamps_ns=recording.stamps_ns[index],
    )
    return Places(kept, np.maximum(stds, LEAST_STD), numbers)


def _rows(path: Path) -> list[tuple[int, dict[str, float]]]:
    """Return the numbers of each row by column, with its line in the file."""
    text = path.read_text(encoding="utf-8").splitlines()
    lines = [(i, line) for i, line in enumerate(text, start=1) if line.strip() and line[0] != "#"]
    table = list(csv.reader(line for _, line in lines))
    head = [name.strip() for name in table[0]] if table else []
    begin = next((span[0] for span in SPANS if span[0] in head), None)
    needed = (begin or "image or time_s", *POSE, *STDS)
    if missing := [name for name in needed if name not in head]:
        raise ValueError(
            f"{path}: no column {', '.join(missing)}; see `uuv_array calibrate --help`"
        )
    known = {*needed, "roll_deg", *(last for first, last in SPANS if first == begin)}
    if strange := [name for name in head if name not in known]:
        raise ValueError(f"{path}: column {strange[0]}: not known; it may have {sorted(known)}")
    rows = []
    for (number, _), cells in zip(lines[1:], table[1:], strict=True):
        row = {}
        for name, cell in zip(head, cells, strict=False):
            try:
                row[name] = float(cell)
            except ValueError:
                row[name] = math.nan
            if not math.isfinite(row[name]) or ("_std_" in name and row[name] < 0):
                least = " of 0 or more" if "_std_" in name else ""
                raise ValueError(f"{path}: line {number}: {name}: {cell!r}; give a number{least}")
        if len(cells) != len(head):
            raise ValueError(f"{path}: line {number}: {len(cells)} cells for {len(head)} columns")
        rows.append((number, row))
    if not rows:
        raise ValueError(f"{path}: no place in it; give one a line")
    return rows


def _images(row: dict[str, float], seconds: Array) -> list[int]:
    """Return the images of a row, by number or by time."""
    if "image" in row:
        first, last = row["image"], row.get("last_image", row["image"])
        return [i for i in range(len(seconds)) if first <= i <= last]
    first = row["time_s"]
    if "until_s" in row:
        return np.flatnonzero((seconds >= first) & (seconds <= row["until_s"])).tolist()
    nearest = int(np.abs(seconds - first).argmin())
    return [nearest] if abs(seconds[nearest] - first) <= NEAR_S else []
