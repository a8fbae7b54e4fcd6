"""The pictures of `tradeoff`: error against time, and what a table costs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.working_volume import SPECIFICATION, volume_spread
from uuv_optical_array.plots.style import (
    METHOD_COLOURS,
    SPECIFIED,
    apart,
    mark,
    number_label,
    plain_log_ticks,
    save,
)
from uuv_optical_array.studies.tradeoff.fronts import MOST_WITHOUT_POSE, fronts, numbered
from uuv_optical_array.studies.tradeoff.results import Measurement, TableCost, at_one_speed

MARKERS: dict[Shape, str] = {"curved": "o", "planar": "s"}
SIDE_COLOURS = ("#9ecae1", "#4292c6", "#08519c", "#08204a", "#000000")
ERRORS = {
    "position": ("position_m", "RMS position error (m)", 0),
    "angle": ("angle_deg", "RMS angle error (deg)", 1),
}
WANTED = (float(SPECIFICATION[0]), float(SPECIFICATION[3]))
FLOOR_GAP, LABEL_GAP = 0.035, 0.05  # of the axes' height, between two labels
MARGIN, LABELS_AT = 0.3, 0.25  # of the axes' width, left of all points: kept for words and numbers


def _size(side: int) -> float:
    """Area of a marker, larger for more detectors."""
    return 16.0 * (side - 1) ** 0.75


def _floors(axes: Axes, rows: Sequence[Measurement], name: str) -> None:
    """Mark each array's bound on the right edge, the labels spread so that none overlaps."""
    bounds = {
        (row.shape, row.detectors_per_side): getattr(row, f"floor_{ERRORS[name][0]}")
        for row in rows
    }
    low, high = np.log(axes.get_ylim())
    items = sorted(bounds.items(), key=lambda item: item[1])
    heights = [float((np.log(bound) - low) / (high - low)) for _, bound in items]
    places = apart(heights, FLOOR_GAP)
    for ((shape, side), _), at, place in zip(items, heights, places, strict=True):
        axes.plot(
            [0.965, 1.0, 1.03],
            [at, at, place],
            color="0.15",
            lw=1.3,
            transform=axes.transAxes,
            clip_on=False,
        )
        axes.plot(
            1.045,
            place,
            MARKERS[shape],
            mfc="w",
            mec="0.15",
            ms=5,
            transform=axes.transAxes,
            clip_on=False,
        )
        axes.text(1.065, place, f"{side}", transform=axes.transAxes, va="center", fontsize=8.5)
    axes.text(
        1.085,
        max(places) + 1.1 * FLOOR_GAP,
        "bound of\neach array",
        transform=axes.transAxes,
        ha="center",
        va="bottom",
        fontsize=8.5,
        color="0.15",
    )


def _series(rows: Sequence[Measurement]) -> dict[tuple[str, Shape, int], list[Measurement]]:
    """Return the settings that differ by their table alone, smallest first."""
    series: dict[tuple[str, Shape, int], list[Measurement]] = {}
    for row in sorted(rows, key=lambda row: row.table_rows):
        series.setdefault((row.method, row.shape, row.detectors_per_side), []).append(row)
    return series


def _panel(axes: Axes, rows: Sequence[Measurement], name: str) -> None:
    column, label, which = ERRORS[name]
    chosen = fronts(rows)[name]
    best = [row for row, on in zip(rows, chosen, strict=True) if on]
    for (method, shape, side), tables in _series(rows).items():
        x, y = ([getattr(row, key) for row in tables] for key in ("median_ms", column))
        colour = METHOD_COLOURS[method]
        axes.plot(x, y, color=colour, lw=0.8, alpha=0.4, zorder=2)
        for row, a, b in zip(tables, x, y, strict=True):
            fair = row.without_pose <= MOST_WITHOUT_POSE
            if row in best:
                axes.plot([a, row.p99_ms], [b, b], color=colour, lw=1.4, alpha=0.6, zorder=2.6)
            axes.scatter(
                a,
                b,
                s=_size(side),
                marker=MARKERS[shape],
                facecolor=colour if fair else "none",
                edgecolor="w" if fair else colour,
                linewidth=0.6 if fair else 1.1,
                alpha=1.0 if row in best else 0.45,
                zorder=4 if row in best else 3,
            )
    model_ms = rows[0].model_ms
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel(f"time from image to pose, median (ms; a forward model takes {model_ms:.2g})")
    axes.set_ylabel(label, fontsize=12)
    axes.axhline(WANTED[which], color=SPECIFIED, ls="--", lw=1.6, zorder=1)
    axes.axhline(volume_spread()[which], color="0.5", ls=":", lw=1.4, zorder=1)
    fastest = min(row.median_ms for row in rows)
    slowest = 1.3 * max(*(row.median_ms for row in rows), *(row.p99_ms for row in best))
    axes.set_xlim(slowest * (0.85 * fastest / slowest) ** (1 / (1 - MARGIN)), slowest)
    unit = "m" if name == "position" else "deg"
    for value, text, colour in (
        (WANTED[which], f"specification, {WANTED[which]:g} {unit}", SPECIFIED),
        (volume_spread()[which], "no measurement at all", "0.4"),
    ):
        axes.annotate(
            text,
            (0.01, value),
            xycoords=axes.get_yaxis_transform(),
            xytext=(0, 3),
            textcoords="offset points",
            ha="left",
            va="bottom",
            fontsize=9,
            color=colour,
        )
    _front(axes, rows, name)
    axes.grid(alpha=0.3, which="both", lw=0.4)
    for axis in (axes.xaxis, axes.yaxis):
        plain_log_ticks(axis)
    above = axes.secondary_xaxis("top", functions=(_inverse, _inverse))
    above.set_xlabel("frames per second")
    above.xaxis.set_major_formatter("{x:g}")
    _floors(axes, rows, name)


def _inverse(values: ArrayLike) -> Array:
    """Turn ms into frames per second, and back."""
    with np.errstate(divide="ignore"):
        return 1e3 / np.asarray(values, dtype=float)


def _front(axes: Axes, rows: Sequence[Measurement], name: str) -> None:
    """Draw the front as steps, its points with their numbers."""
    column = ERRORS[name][0]
    on = fronts(rows)[name]
    members = [(number, rows[i]) for number, i in enumerate(numbered(rows), start=1) if on[i]]
    x, y = ([getattr(row, key) for _, row in members] for key in ("median_ms", column))
    axes.step(x, y, where="post", color="k", lw=1.0, zorder=2.5)
    # Labels stand in a column left of all points, spread so that none overlaps.
    low, high = np.log(axes.get_ylim())
    members.sort(key=lambda member: float(getattr(member[1], column)))
    heights = [float((np.log(getattr(row, column)) - low) / (high - low)) for _, row in members]
    for (number, row), place in zip(members, apart(heights, LABEL_GAP), strict=True):
        number_label(axes, number, (row.median_ms, getattr(row, column)), (LABELS_AT, place))


def _key(axes: Axes, rows: Sequence[Measurement]) -> None:
    """List the settings on a front, and what they cost."""
    axes.set_axis_off()
    line = "{:>2}  {:<16} {:<14} {:>9} {:>7} {:>7} {:>7} {:>7}"
    lines = [
        line.format("", "on a front", "array", "table", "m", "deg", "ms", "99 %"),
    ]
    for number, i in enumerate(numbered(rows), start=1):
        row = rows[i]
        lines.append(
            line.format(
                number,
                row.method,
                f"{row.shape} {row.detectors_per_side}x{row.detectors_per_side}",
                f"{row.table_rows:,}" if row.table_rows else "-",
                f"{row.position_m:.3f}",
                f"{row.angle_deg:.2f}",
                f"{row.median_ms:.2f}",
                f"{row.p99_ms:.2f}",
            )
        )
    axes.text(0, 1, "\n".join(lines), family="monospace", fontsize=9.5, va="top", linespacing=1.35)


def _legend(axes: Axes, rows: Sequence[Measurement]) -> None:
    axes.set_axis_off()

    methods = [method for method in METHOD_COLOURS if any(row.method == method for row in rows)]
    sides = sorted({row.detectors_per_side for row in rows})
    left = [mark(method, color=METHOD_COLOURS[method]) for method in methods]
    left += [mark(f"{shape} array", marker) for shape, marker in MARKERS.items()]
    right = [mark(f"{side} x {side} detectors", ms=_size(side) ** 0.5) for side in sides]
    right += [
        mark("over 1 % of frames without a pose", mfc="none"),
        mark("pale: on neither front", alpha=0.4),
        mark("to the right, on the front: the 99th percentile", "", lw=1.4, alpha=0.6),
        mark("joined: tables of 1e3 poses and more", "", lw=0.8),
        mark("front: nothing is faster and better by 10 %", "", color="k", lw=1),
    ]
    about: dict[str, Any] = {"loc": "upper left", "fontsize": 9.5, "frameon": False}
    first = axes.legend(handles=left, bbox_to_anchor=(0, 1.05), **about)
    axes.legend(handles=right, bbox_to_anchor=(0.3, 1.05), **about)
    axes.add_artist(first)


def draw_tradeoff(rows: Sequence[Measurement], about: str, path: Path) -> None:
    """Draw errors against time, every setting a point.

    Parameters
    ----------
    rows
        At least one.
    about
        For the title.
    path
        Picture, written whole or not at all.
    """
    rows = at_one_speed(rows)
    figure = Figure(figsize=(14, 9.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=[3, 1])
    for place, name in enumerate(ERRORS):
        _panel(figure.add_subplot(grid[0, place]), rows, name)
    _key(figure.add_subplot(grid[1, 0]), rows)
    _legend(figure.add_subplot(grid[1, 1]), rows)
    figure.suptitle(f"What accuracy costs in time\n{about}", fontsize=12)
    save(figure, path)


def draw_table_cost(
    costs: Sequence[TableCost], rows: Sequence[Measurement], about: str, path: Path
) -> None:
    """Draw what a table costs by its size.

    Parameters
    ----------
    costs
        Of tables of one array, at least one.
    rows
        Settings, of which the time to build the tables of every array is taken.
    about
        For the title.
    path
        Picture, written whole or not at all.
    """
    figure = Figure(figsize=(12, 7.5), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True)
    costs = sorted(costs, key=lambda cost: cost.table_rows)
    size = [cost.table_rows for cost in costs]
    build, disk, load, memory = grid.ravel()
    sides = sorted({row.detectors_per_side for row in rows})
    for (method, shape, side), tables in _series(rows).items():
        if method == "sam":
            build.plot(
                [row.table_rows for row in tables],
                [row.build_s for row in tables],
                marker=MARKERS[shape],
                mfc="none" if shape == "planar" else None,
                color=SIDE_COLOURS[sides.index(side) % len(SIDE_COLOURS)],
            )
    for side in sides:
        colour = SIDE_COLOURS[sides.index(side) % len(SIDE_COLOURS)]
        build.plot([], [], "o-", color=colour, label=f"{side} x {side}")
    disk.plot(size, [cost.file_mb for cost in costs], "o-", color="0.2")
    load.plot(size, [cost.load_s for cost in costs], "o-", color="0.2")
    memory.plot(size, [cost.memory_mb for cost in costs], "o-", color="0.2", label="ready")
    memory.plot(
        size, [cost.peak_mb for cost in costs], "o--", color="0.6", label="most, while it starts"
    )
    for axes, title in (
        (build, "time to build, at the first start (s)"),
        (disk, "size on disk (MB)"),
        (load, "time to open, at every start (s)"),
        (memory, "memory of the estimator (MB)"),
    ):
        axes.set(xscale="log", yscale="log", title=title)
        low, high = np.log10(axes.get_ylim())
        axes.set_ylim(10.0 ** np.floor(low), 10.0 ** np.ceil(high))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.grid(alpha=0.3, which="both", lw=0.4)
    build.legend(fontsize=9, title="circles curved, squares planar")
    memory.legend(fontsize=9)
    for axes in grid[1]:
        axes.set_xlabel("poses in the table")
    figure.suptitle(f"What a table costs by its size\n{about}", fontsize=12)
    save(figure, path)
