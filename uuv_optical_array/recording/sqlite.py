"""SQLite files of which the end is missing, because the disk was full or a copy was broken off.

The header says how many pages there are (https://www.sqlite.org/fileformat.html). With pages of
zeros in place of those that are missing, a table is read in its order up to the first of these.
"""

import shutil
import sqlite3
from contextlib import closing, suppress
from pathlib import Path

MAGIC = b"SQLite format 3\0"


def _size(path: Path) -> int:
    """Return the size that the header of a database states, bytes; 0 where there is none."""
    with path.open("rb") as file:
        head = file.read(100)
    if len(head) < 100 or not head.startswith(MAGIC):
        return 0
    page = int.from_bytes(head[16:18], "big")
    return (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")


def is_cut_off(path: Path) -> bool:
    """Say whether a file is a database that is shorter than it states."""
    return path.stat().st_size < _size(path)


def mend(path: Path, target: Path) -> None:
    """Write the rows that are whole to a database of their own.

    Parameters
    ----------
    path
        A file for which `is_cut_off` holds.
    target
        The file to write.
    """
    filled = target.with_suffix(".filled")
    shutil.copyfile(path, filled)
    with filled.open("r+b") as file:
        file.truncate(_size(path))
    with closing(sqlite3.connect(filled)) as source, closing(sqlite3.connect(target)) as whole:
        # What can be read comes before the error.
        with suppress(sqlite3.DatabaseError):
            tables = "SELECT name, sql FROM sqlite_master WHERE type = 'table'"
            for name, layout in source.execute(tables).fetchall():
                whole.execute(layout)
                with suppress(sqlite3.DatabaseError):
                    for row in source.execute(f'SELECT * FROM "{name}"'):
                        whole.execute(
                            f'INSERT INTO "{name}" VALUES ({",".join("?" * len(row))})', row
                        )
        whole.commit()
    filled.unlink()
