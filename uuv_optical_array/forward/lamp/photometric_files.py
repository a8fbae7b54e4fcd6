"""Photometric files of lamps: IES LM-63, of 1986 to 2019, and EULUMDAT.

Read are the intensities by the angle off the axis, which is the file's nadir, in planes about it.
"""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import Array

LDT_HEAD, LDT_LAMPS_AT, LDT_PER_LAMP, LDT_RATIOS = 26, 25, 6, 10  # lines of EULUMDAT


class Photometry(NamedTuple):
    """What a photometric file says: angles off the axis, deg, and intensities by planes.

    Intensities have shape ``(planes, angles)``, in a unit of the file's; shares are those of each
    plane in the mean about the axis.
    """

    angles_deg: Array
    intensities: Array
    shares: Array

    @property
    def mean(self) -> Array:
        """Intensity about the axis over that on it, by the angle."""
        mean: Array = self.shares @ self.intensities
        return mean / mean[0]

    @property
    def half_width_deg(self) -> float:
        """Where the mean is half of that on the axis, deg."""
        mean = self.mean
        first = int((mean <= 0.5).argmax())
        if first == 0:
            raise ValueError("the light nowhere falls to half of that on the axis; give a beam")
        pair = slice(first - 1, first + 1)
        return float(np.interp(-0.5, -mean[pair], self.angles_deg[pair]))


def read(path: Path) -> Photometry:
    """Read a photometric file; ValueError, with what is wrong, for another one."""
    text = path.read_text(encoding="latin-1")
    suffix = path.suffix.lower()
    if suffix not in (".ies", ".ldt"):
        raise ValueError("is neither an .ies (LM-63) nor an .ldt (EULUMDAT) file")
    try:
        found = _read_ies(text) if suffix == ".ies" else _read_ldt(text)
    except (IndexError, OverflowError):
        raise ValueError("ends before its table of intensities; download it again") from None
    angles, intensities, _ = found
    if np.any(np.diff(angles) <= 0) or not np.isfinite(intensities).all():
        raise ValueError("has angles that do not rise, or intensities that are no numbers")
    if angles[0] != 0 or angles[-1] < 1 or not (intensities[:, 0] > 0).all():
        raise ValueError(
            f"has its light from {angles[0]:g} to {angles[-1]:g} deg, none on the axis at 0; turn "
            "the lamp so that its beam points down"
        )
    return found


def _numbers(text: str) -> list[float]:
    words = re.split(r"[\s,;]+", text.strip())
    try:
        return [float(word) for word in words if word]
    except ValueError as error:
        raise ValueError(f"has no number where one should be ({error})") from None


def _read_ies(text: str) -> Photometry:
    found = re.search(r"^\s*TILT\s*=\s*(.*)$", text, re.MULTILINE | re.IGNORECASE)
    if not found:
        raise ValueError("has no line TILT=, which LM-63 requires")
    numbers = _numbers(text[found.end() :])
    if found.group(1).strip().upper() == "INCLUDE":
        numbers = numbers[2 + 2 * int(numbers[1]) :]  # how the flux changes with a tilt
    vertical, horizontal, kind = int(numbers[3]), int(numbers[4]), int(numbers[5])
    if kind != 1:
        raise ValueError(
            f"is of photometric type {'CBA'[kind - 1] if kind in (2, 3) else kind}; convert it to "
            "type C, with its planes about the beam's axis"
        )
    body = numbers[13:]
    angles, planes = body[:vertical], body[vertical : vertical + horizontal]
    table = body[vertical + horizontal : vertical + horizontal + vertical * horizontal]
    if vertical < 2 or horizontal < 1 or len(table) < vertical * horizontal:
        raise IndexError
    intensities = np.reshape(table, (horizontal, vertical))
    return Photometry(np.array(angles), intensities, _shares(planes))


def _read_ldt(text: str) -> Photometry:
    lines = [line.strip().replace(",", ".") for line in text.splitlines()]
    symmetry, count, rows = (int(_numbers(lines[k])[0]) for k in (2, 3, 5))
    sets = int(_numbers(lines[LDT_LAMPS_AT])[0])
    start = LDT_HEAD + LDT_PER_LAMP * sets + LDT_RATIOS
    numbers = _numbers("\n".join(lines[start:]))
    planes, angles = numbers[:count], np.array(numbers[count : count + rows])
    # Which planes the symmetry leaves, by how many they are: all, one, a half or a quarter.
    written = {0: count, 1: 1, 2: count // 2 + 1, 3: count // 2 + 1, 4: count // 4 + 1}
    if symmetry not in written:
        raise ValueError(f"has the symmetry {symmetry}, which EULUMDAT does not know")
    kept = written[symmetry]
    table = numbers[count + rows : count + rows + kept * rows]
    if rows < 2 or count < 1 or len(table) < kept * rows:
        raise IndexError
    shown = planes[:kept] if symmetry != 3 else [360 / count * k for k in range(kept)]
    return Photometry(angles, np.reshape(table, (kept, rows)), _shares(shown))


def _shares(planes_deg: Any) -> Array:
    """Return the share of each plane about the axis: those on a symmetry's edge count half."""
    planes = np.asarray(planes_deg, dtype=float)
    if len(planes) == 1:
        return np.ones(1)
    if np.any(np.diff(planes) <= 0):
        raise ValueError("has planes that do not rise")
    span = planes[-1] - planes[0]
    steps = np.diff(planes)
    # All around without the first plane once more: the gap to it is one step, too.
    if span > 180 and span < 360:
        steps = np.append(steps, 360 - span)
        shares = (steps + np.roll(steps, 1)) / 2
    else:
        shares = (np.append(steps, 0.0) + np.append(0.0, steps)) / 2
    return np.asarray(shares / shares.sum())
