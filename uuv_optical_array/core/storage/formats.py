"""Results as text: columns for people, JSON and CSV for other programs."""

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Return mappings, sequences and arrays as JSON holds them, ``None`` for what is not finite."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def json_text(value: Any) -> str:
    """Return a value as one line of JSON, by `plain`."""
    return json.dumps(plain(value), allow_nan=False)


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows as CSV below the columns' names; ValueError for a row with another column."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def cell(value: Any) -> str:
    """Return a value as a cell of a table, a number to three digits, ``-`` for ``None``."""
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def columns(rows: Iterable[Sequence[object]], left: int = 1) -> str:
    """Return rows of cells as text in columns, of which the first ones are aligned to the left."""
    cells = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip_longest(*cells, fillvalue="")]
    lines = (
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=False))
        )
        for row in cells
    )
    return "\n".join(line.rstrip() for line in lines)
