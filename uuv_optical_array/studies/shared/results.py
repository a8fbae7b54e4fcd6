"""Results of a study: those until Ctrl-C, and those that are kept in a CSV."""

import csv
import typing
from collections.abc import Iterable, Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar

from uuv_optical_array.core.storage import files
from uuv_optical_array.core.storage.formats import csv_text

T = TypeVar("T")
# Costs that differ by less than 10 % count as equal: that is noise, or not worth a decision.
STEP = 1.1


def until_interrupted(results: Iterable[T]) -> tuple[list[T], bool]:
    """Return the results until Ctrl-C, which is raised where there are none, and whether all."""
    collected: list[T] = []
    try:
        for result in results:
            collected.append(result)
    except KeyboardInterrupt:
        if not collected:
            raise
        return collected, False
    return collected, True


def _value(hint: Any, text: str) -> Any:
    """Return the value of a field; an empty text is None where the field may be that."""
    kinds = {hint, *typing.get_args(hint)}
    if text == "" and NoneType in kinds:
        return None
    return next((number for number in (int, float) if number in kinds), str)(text)


def read(path: Path, kind: type[T]) -> tuple[dict[str, str], list[T]]:
    """Read a file of results: the origin that all its lines depend on, as text, and the lines.

    A file that does not exist has neither. ValueError for a line damaged or of another origin.
    """
    hints = typing.get_type_hints(kind)
    origin: dict[str, str] = {}
    lines: list[T] = []
    if not path.exists():
        return origin, lines
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file, strict=True):
                line = kind(**{name: _value(of, row[name]) for name, of in hints.items()})
                own = dict(takewhile(lambda column: column[0] not in hints, row.items()))
                if own != (origin or own):
                    raise ValueError
                origin = own
                lines.append(line)
    except (csv.Error, KeyError, TypeError, ValueError):
        what = f"line {len(lines) + 2} is damaged, or of another run than the first"
        raise ValueError(f"{path}: {what}; remove the file or name another") from None
    return origin, lines


def write(path: Path, origin: Mapping[str, Any], lines: Sequence[Mapping[str, Any]]) -> None:
    """Write a file of results, whole or not at all; a line's values are by their columns."""
    files.write_text(path, csv_text([*origin, *lines[0]], [{**origin, **line} for line in lines]))
