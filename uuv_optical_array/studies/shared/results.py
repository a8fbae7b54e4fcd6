"""Results of a study: those until Ctrl-C, and those that are kept in a CSV."""

import csv
import dataclasses
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

from uuv_optical_array.core.storage import files
from uuv_optical_array.core.storage.formats import csv_text

T = TypeVar("T")
RunT = TypeVar("RunT")


def until_interrupted(results: Iterable[T]) -> list[T]:
    """Return the results until Ctrl-C, which is raised where there are none."""
    collected: list[T] = []
    try:
        for result in results:
            collected.append(result)
    except KeyboardInterrupt:
        if not collected:
            raise
    return collected


class Line:
    """A dataclass that is a line of a CSV, a field a column."""

    def columns(self) -> dict[str, Any]:
        """Return the values by column."""
        return dict(vars(self))


LineT = TypeVar("LineT", bound=Line)


def read_fields(kind: type[T], columns: Mapping[str, str]) -> T:
    """Make a dataclass of the texts of a line; an empty text is None.

    A KeyError, TypeError or ValueError says that a column is missing, cut off, or no number.
    """
    values: dict[str, Any] = {}
    for name, hint in typing.get_type_hints(kind).items():
        kinds = {hint, *typing.get_args(hint)}
        text = columns[name]
        if text is None:
            raise TypeError(f"{name} is cut off")
        if text == "" and type(None) in kinds:
            values[name] = None
        else:
            values[name] = next((number for number in (int, float) if number in kinds), str)(text)
    return kind(**values)


def read(path: Path, run: type[RunT], line: type[LineT]) -> tuple[RunT | None, list[LineT]]:
    """Read a file of results: the run that all its lines depend on, and the lines.

    A file that does not exist has neither. A ValueError says that a line is damaged, or of another
    run than the first.
    """
    if not path.exists():
        return None, []
    runs: list[RunT] = []
    lines: list[LineT] = []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for number, columns in enumerate(csv.DictReader(file, strict=True), start=2):
                try:
                    runs.append(read_fields(run, columns))
                    lines.append(read_fields(line, columns))
                except (KeyError, TypeError, ValueError):
                    raise ValueError(f"line {number} is damaged") from None
                if runs[-1] != runs[0]:
                    raise ValueError(f"line {number} is of another run than the first")
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{path}: {error}; remove the file or name another") from None
    return (runs[0] if runs else None), lines


def differences(there: Any, here: Any) -> list[str]:
    """Say in which fields two runs differ; a scene counts by its fingerprint, not its name."""
    return [
        f"{field.name} is {getattr(there, field.name)} there and {getattr(here, field.name)} here"
        for field in dataclasses.fields(here)
        if field.name != "scene" and getattr(there, field.name) != getattr(here, field.name)
    ]


class Results(Generic[RunT, LineT]):
    """The results of one run, in a CSV that is always whole; an existing file is taken over.

    A ValueError says that the file is damaged, or holds results of another `run`, which is what all
    lines depend on.
    """

    def __init__(self, path: Path, line: type[LineT], run: RunT) -> None:
        existing, self.lines = read(path, type(run), line)
        if existing is not None and (differ := differences(existing, run)):
            raise ValueError(
                f"{path}: holds results of another run: {'; '.join(differ)}; "
                "remove the file or name another"
            )
        self.path, self.run = path, run

    def append(self, lines: Iterable[LineT]) -> None:
        """Add lines, all or none of them."""
        together = [*self.lines, *lines]
        rows = [{**vars(self.run), **line.columns()} for line in together]
        files.write_text(self.path, csv_text(list(rows[0]) if rows else [], rows))
        self.lines = together
