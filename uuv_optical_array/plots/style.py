"""What the pictures have in common: colours, marks, axes, images, and how one is written.

Matplotlib takes a second to import, so it is imported when something is drawn.
"""

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.array import Shape

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

# What a picture's name may end in, with what keeps the file the same from one run to the next.
KINDS: dict[str, dict[str, Any]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
SHAPE_COLOURS: dict[Shape, str] = {"planar": "#c8401e", "curved": "#1f6fb4"}
# One colour a method, in every picture.
METHOD_COLOURS = {
    "moments": "#8a8a8a",
    "look_up": "#7a4fa3",
    "sam": "#c8401e",
    "sam_interpolated": "#e0a800",
    "least_squares": "#1f6fb4",
    "tracker": "#2c9c5a",
    "docking": "#12305e",
}
# And one shape of its mark, which is distinct in grey, too.
METHOD_MARKS = {"moments": "v", "look_up": "D", "sam": "s", "sam_interpolated": "^"}
METHOD_MARKS |= {"least_squares": "o"}
SPECIFIED = "#2c9c5a"
IMAGES = "magma"  # colours of what the array reads
MOST_DECADES = 3  # of an axis that has room for more than one mark a decade
DPI = 90


def new_figure(width: float, height: float) -> "Figure":
    """Return an empty figure of a size in inches, which lays itself out."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def shades(cmap: str, first: float, last: float, count: int) -> Any:
    """Return colours of a colour map, evenly from one place in it to another, shape ``(n, 4)``."""
    from matplotlib import colormaps

    return colormaps[cmap](np.linspace(first, last, count))


def signed(value: float, digits: int) -> str:
    """Return a number with its sign and so many decimals; what rounds to zero has no sign."""
    rounded = round(float(value), digits) + 0.0
    return f"{rounded:+.{digits}f}" if rounded else f"{0.0:.{digits}f}"


def detector_ticks(*axes: "Axis", most: int = 6) -> None:
    """Mark whole rows or columns, from 0."""
    from matplotlib.ticker import MaxNLocator

    for axis in axes:
        axis.set_major_locator(MaxNLocator(most, integer=True, min_n_ticks=1))
        axis.set_major_formatter("{x:.0f}")


def array_image(axes: "Axes", image: Array, **style: Any) -> Any:
    """Draw an image of an array, counts, ``(rows, columns)``, rows from the top, as vectors.

    Style is that of `Axes.pcolormesh`, whose mesh is returned for a colour bar.
    """
    rows, columns = (np.arange(count + 1) - 0.5 for count in image.shape)
    mesh = axes.pcolormesh(columns, rows, image, cmap=IMAGES, **style)
    axes.set(xlim=columns[[0, -1]], ylim=rows[[-1, 0]], aspect="equal")
    detector_ticks(axes.xaxis, axes.yaxis)
    return mesh


def plain_log_ticks(axis: "Axis") -> None:
    """Mark 1, 2 and 5 of each decade as it is shown now, of many decades 1, as plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    few = high <= low * 10.0**MOST_DECADES
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def mark(label: str, marker: str = "o", **style: Any) -> "Line2D":
    """Return a mark for a legend, without a line where none is asked for."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **{"color": "0.4", "lw": 0, "marker": marker, "label": label, **style})


def number_points(axes: "Axes", points: Mapping[int, tuple[float, float]]) -> None:
    """Write the numbers of points in boxes beside them."""
    box = {"boxstyle": "round,pad=0.15", "fc": "w", "ec": "k", "lw": 0.6}
    words: dict[str, Any] = {"va": "center", "fontsize": 9, "fontweight": "bold", "bbox": box}
    for number, at in points.items():
        axes.annotate(str(number), at, (8, 0), textcoords="offset points", zorder=5, **words)


def write_table(axes: "Axes", text: str, size: float, spacing: float) -> None:
    """Write a table of text into the upper left corner of bare axes, beyond which it may reach."""
    axes.set_axis_off()
    words: dict[str, Any] = {"family": "monospace", "fontsize": size, "linespacing": spacing}
    axes.text(0, 1, text, va="top", in_layout=False, **words)


def draw_trial() -> None:
    """Draw a word as a trial; ValueError where Matplotlib cannot, before the work for a picture."""
    try:
        figure = new_figure(1, 1)
        figure.text(0, 0, "0")
        figure.savefig(BytesIO(), dpi=10)
    except Exception as error:  # Matplotlib's have any type
        words = " ".join(f"{type(error).__name__} {error}".split())
        raise ValueError(f"no picture can be drawn: {words}; repair Matplotlib") from error


def save(figure: "Figure", path: Path) -> None:
    """Write a figure, whole or not at all; ValueError where the name ends in none of `KINDS`."""
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise ValueError(
            f"{path}: not a kind of picture; use a name that ends in {', '.join(KINDS)}"
        )
    smaller: dict[str, Any] = {"pil_kwargs": {"optimize": True}} if kind == ".png" else {}
    with files.whole_file(path) as scratch:
        figure.savefig(scratch, format=kind[1:], dpi=DPI, metadata=KINDS[kind], **smaller)
