"""What the pictures have in common: colours, marks, axes, and how one is written."""

import os
from pathlib import Path
from typing import Any

from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from uuv_optical_array.forward.array import Shape

SHAPE_COLOURS: dict[Shape, str] = {"planar": "#c8401e", "curved": "#1f6fb4"}
SPECIFIED = "#2c9c5a"
NUMBER_BOX = {"fc": "w", "ec": "k", "lw": 0.6}  # about the number of a point


def plain_log_ticks(axis: Axis) -> None:
    """Mark 1, 2 and 5 of each decade, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def mark(label: str, marker: str = "o", **style: Any) -> Line2D:
    """Return a mark for a legend, without a line where none is asked for."""
    return Line2D([], [], **{"color": "0.4", "lw": 0, "marker": marker, "label": label, **style})


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    scratch = path.with_name(f".{path.name}.part")
    try:
        figure.savefig(scratch, format="png", dpi=90)
        os.replace(scratch, path)
    finally:
        scratch.unlink(missing_ok=True)
