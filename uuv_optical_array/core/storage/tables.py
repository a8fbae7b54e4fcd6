"""Tables that people write, as CSV of an editor or a spreadsheet."""

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path


def read(path: Path) -> tuple[list[str], Iterator[tuple[int, dict[str, str]]]]:
    """Return the columns of a table, and what yields each row: its line, and its cells by column.

    It is UTF-8, with a byte order mark or without. Blank rows and comments, whose first cell begins
    with ``#``, in quotes or not, are left out, and so are empty cells at the end of rows.
    ValueError, with file and line, for what is no such table; of rows, of columns twice and of
    columns without names once the rows are taken. OSError for a file that cannot be opened.
    """
    (_, head), *table = rows(path) or [(0, [])]
    columns = _without_empty(head)
    return columns, _rows(path, columns, table)


def rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return each row that is neither blank nor a comment, the first as the others: line and cells.

    ValueError and OSError are those of `read`.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: {error}; give a table as CSV in UTF-8") from None
    lines = csv.reader(text.splitlines(keepends=True), strict=True)
    found = []
    try:
        for cells in lines:
            cells = [cell.strip() for cell in cells]
            if any(cells) and not cells[0].startswith("#"):
                found.append((lines.line_num, cells))
    except csv.Error as error:
        raise ValueError(f"{path}: line {lines.line_num}: {error}") from None
    return found


def _rows(
    path: Path, columns: list[str], table: list[tuple[int, list[str]]]
) -> Iterator[tuple[int, dict[str, str]]]:
    if len(columns) == 1 and ";" in columns[0]:
        raise ValueError(f"{path}: columns {columns[0]}; separate cells by commas")
    if columns and all(number(name) for name in columns):
        raise ValueError(
            f"{path}: columns {', '.join(columns)}; the first row, which is no comment, names them"
        )
    if twice := [name or "without a name" for name, n in Counter(columns).items() if n > 1]:
        raise ValueError(f"{path}: columns {', '.join(twice)} more than once; keep one of each")
    for line, cells in table:
        yield line, _row(path, line, columns, cells)


def _row(path: Path, line: int, columns: Sequence[str], cells: list[str]) -> dict[str, str]:
    cells = cells[: len(columns)] + _without_empty(cells[len(columns) :])
    if len(cells) != len(columns):
        raise ValueError(f"{path}: line {line}: {len(cells)} cells; give {len(columns)}, as above")
    return dict(zip(columns, cells, strict=True))


def number(text: str) -> bool:
    """Say whether a cell is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _without_empty(cells: Sequence[str]) -> list[str]:
    """Return cells without the empty ones at their end."""
    last = max((i for i, cell in enumerate(cells, 1) if cell), default=0)
    return list(cells[:last])
