"""How much memory there is, and how much a signature table takes."""

import os
from pathlib import Path

import numpy as np

# What a row takes in a node, at its peak: the parameters, the matched vectors as such and at length
# one, the k-d tree, and its place in the grid. docs/how_to/tables.md has the measurement.
BYTES_A_ROW = 40 + 48 + 48 + 40 + 8
NODE_BYTES = 250_000_000  # the node without a table
KEPT_BYTES = 1 << 24  # glibc takes no more than twice that
CGROUP = Path("/sys/fs/cgroup/memory.max")  # what a container may take


def machine_bytes() -> int:
    """Return the memory of this machine, or of the container this runs in, bytes."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        return min(total, int(CGROUP.read_text()))
    except (OSError, ValueError):  # no container, or "max"
        return total


def serving_bytes(rows: int) -> int:
    """Return the memory that a process needs to search a table of so many rows, bytes."""
    return NODE_BYTES + BYTES_A_ROW * rows


def gigabytes(count: float) -> str:
    """Return a number of bytes as it is printed."""
    digits = ".1e" if count >= 1e15 else ",.1f" if count >= 1e10 else ".2f"
    return f"{count / 1e9:{digits}} GB"


def shortfall(rows: int) -> str | None:
    """Say why this machine cannot serve a table, or ``None`` where it can.

    Parameters
    ----------
    rows
        Rows of the table, >= 0.

    Returns
    -------
    str or None
        What it needs, what there is, and the cure.
    """
    need, have = serving_bytes(rows), machine_bytes()
    if need <= have:
        return None
    most = max(0, have - NODE_BYTES) // BYTES_A_ROW
    return (
        f"{rows:,} rows need {gigabytes(need)} of memory to be searched, this machine has "
        f"{gigabytes(have)}; take a coarser grid, of at most {most:,} rows"
    )


def keep_freed() -> None:
    """Let the C library keep the memory of freed arrays of up to 16 MB for the next ones.

    Else each block of work gets fresh pages from the system, which costs as much time as the work.
    glibc raises its threshold to the size of the largest array that was freed; this one is never
    touched, so that it takes no memory.
    """
    np.empty(KEPT_BYTES, dtype=np.uint8)
