"""What the pictures have in common: colours, marks, axes, and how one is written."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from uuv_optical_array.core import files
from uuv_optical_array.forward.array import Shape

SHAPE_COLOURS: dict[Shape, str] = {"planar": "#c8401e", "curved": "#1f6fb4"}
SPECIFIED = "#2c9c5a"
IMAGES = "magma"  # colours of what the array reads


def plain_log_ticks(axis: Axis) -> None:
    """Mark 1, 2 and 5 of each decade, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def mark(label: str, marker: str = "o", **style: Any) -> Line2D:
    """Return a mark for a legend, without a line where none is asked for."""
    return Line2D([], [], **{"color": "0.4", "lw": 0, "marker": marker, "label": label, **style})


def apart(heights: Sequence[float], gap: float) -> list[float]:
    """Move sorted heights apart by at least `gap`, with the least sum of squared moves."""
    # Pool adjacent violators: a group that touches is moved as one, about its mean.
    groups: list[tuple[float, int]] = []
    for i, height in enumerate(heights):
        mean, count = height - i * gap, 1
        while groups and groups[-1][0] >= mean:
            before, many = groups.pop()
            mean, count = (before * many + mean * count) / (many + count), many + count
        groups.append((mean, count))
    level = [mean for mean, count in groups for _ in range(count)]
    return [mean + i * gap for i, mean in enumerate(level)]


def number_label(
    axes: Axes,
    number: int,
    point: tuple[float, float],
    place: tuple[float, float],
    ha: Literal["center", "right"] = "center",
) -> None:
    """Write the number of a point in a box, at a place in fractions of the axes."""
    axes.annotate(
        str(number),
        point,
        xytext=place,
        textcoords="axes fraction",
        ha=ha,
        va="center",
        fontsize=9,
        fontweight="bold",
        zorder=5,
        bbox={"boxstyle": "round,pad=0.15", "fc": "w", "ec": "k", "lw": 0.6},
        arrowprops={"arrowstyle": "-", "lw": 0.6, "shrinkA": 0, "shrinkB": 2},
    )


def save(figure: Figure, path: Path) -> None:
    """Write a figure as its suffix says, PNG, SVG or PDF, whole or not at all."""
    with files.whole_file(path) as scratch:
        figure.savefig(scratch, format=path.suffix[1:].lower(), dpi=90)
