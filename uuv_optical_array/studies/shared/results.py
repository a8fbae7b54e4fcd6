"""Results of a study: those until Ctrl-C, and those that are kept in a CSV."""

import csv
import typing
from collections.abc import Iterable, Mapping
from itertools import takewhile
from pathlib import Path
from types import NoneType
from typing import Any, Generic, TypeVar

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


class Line:
    """A dataclass that is a line of a CSV, a field a column."""

    def columns(self) -> dict[str, Any]:
        """Return the values by column."""
        return dict(vars(self))


LineT = TypeVar("LineT", bound=Line)


def _value(hint: Any, text: str) -> Any:
    """Return the value of a field; an empty text is None where the field may be that."""
    kinds = {hint, *typing.get_args(hint)}
    if text == "" and NoneType in kinds:
        return None
    return next((number for number in (int, float) if number in kinds), str)(text)


def read(path: Path, kind: type[LineT]) -> tuple[dict[str, str], list[LineT]]:
    """Read a file of results: the origin that all its lines depend on, as text, and the lines.

    A file that does not exist has neither. A ValueError says that a line is damaged, or of another
    origin than the first.
    """
    hints = typing.get_type_hints(kind)
    origin: dict[str, str] = {}
    lines: list[LineT] = []
    if not path.exists():
        return origin, lines
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for number, columns in enumerate(csv.DictReader(file, strict=True), start=2):
                try:
                    lines.append(
                        kind(**{name: _value(of, columns[name]) for name, of in hints.items()})
                    )
                    if not all(map(str.isidentifier, columns)):
                        raise ValueError("no columns of ours")
                except (KeyError, TypeError, ValueError):
                    raise ValueError(f"line {number} is damaged") from None
                # The origin stands before the fields.
                before = takewhile(lambda name: name not in hints, columns)
                own = {name: columns[name] for name in before}
                if own != (origin or own):
                    raise ValueError(f"line {number} is of another run than the first")
                origin = own
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{path}: {error}; remove the file or name another") from None
    return origin, lines


class Results(Generic[LineT]):
    """The results of one run, in a CSV that is always whole; an existing file is taken over.

    `origin` is what all lines depend on; of a scene its fingerprint counts, not its name. A
    ValueError says that the file is damaged, or of another origin.
    """

    def __init__(self, path: Path, kind: type[LineT], origin: Mapping[str, Any]) -> None:
        there, self.lines = read(path, kind)
        differ = "; ".join(
            f"{name} is {there.get(name)} there and {value} here"
            for name, value in origin.items()
            if there and name != "scene" and there.get(name) != str(value)
        )
        if differ:
            error = f"{path}: holds results of another run: {differ}"
            raise ValueError(f"{error}; remove the file or name another")
        self.path, self.origin = path, origin

    def append(self, lines: Iterable[LineT]) -> None:
        """Add lines, all or none of them."""
        together = [*self.lines, *lines]
        rows = [{**self.origin, **line.columns()} for line in together]
        files.write_text(self.path, csv_text(list(rows[0]) if rows else [], rows))
        self.lines = together
