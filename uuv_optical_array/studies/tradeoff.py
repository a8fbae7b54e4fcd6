"""``uuv_array study tradeoff``: measure what accuracy costs in time, by method and table."""

import argparse
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.working_volume import SPECIFICATION, volume_spread
from uuv_optical_array.plots.style import (
    METHOD_COLOURS,
    apart,
    mark,
    new_figure,
    number_label,
    save,
)
from uuv_optical_array.studies.shared.pareto import STEP, pareto_front
from uuv_optical_array.studies.shared.tradeoff_measurement import (
    MOST_WITHOUT_POSE,
    QUICK_LEAVES_OUT,
    SEED,
    SETTINGS_CSV,
    Measurement,
    Mode,
    TradeoffRun,
    at_one_speed,
    plan,
)

DESCRIPTION = """\
Measure error and time per frame of every method (sam, sam_interpolated, least_squares, and the
published look-up and moments) on arrays of 3, 5, 7 and 21 detectors a side, planar and curved, with
tables of 1e3 to 1e7 poses. Errors are of random poses 4 to 8 m behind the lamp, +-0.9 m and
+-20 deg; times are from an image to its pose. The results, with the time to build each table, go
into a CSV file and a picture in the output folder. A stopped run goes on where it was. See
docs/results/tradeoff.md."""

EPILOG = """\
examples:
  uuv_array study tradeoff                   some settings of the reference scene: a few minutes
  uuv_array study tradeoff --full            all of them; says first how long that takes
  uuv_array study tradeoff --scene sea.yaml  your own scene, into sea.tradeoff/
Ctrl-C ends it early and draws the settings that are measured."""

ERRORS = {
    "position": ("position_m", "RMS position error (m)", 0),
    "angle": ("angle_deg", "RMS angle error (deg)", 1),
}


def fronts(rows: Sequence[Measurement]) -> dict[str, NDArray[np.bool_]]:
    """Find which rows are on each Pareto front, by ``position`` and ``angle``, shape ``(n,)``.

    The costs are the median time, in forward models, and one of the two errors. The middle of the
    volume is an estimate without any measurement, so a setting has to be better than that, and one
    that leaves frames without a pose is on no front. Time and error are rounded to steps of 10 %.
    Of settings that are then equal, only the one of least effort is on the front.
    """
    on_front = {}
    for name, (column, _, which) in ERRORS.items():
        costs = [
            (row.models, getattr(row, column))
            if row.without_pose <= MOST_WITHOUT_POSE
            else (np.inf, np.inf)
            for row in rows
        ]
        steps = np.round(np.log(np.reshape(costs, (-1, 2))) / np.log(STEP))
        steps[~(steps[:, 1] < np.round(np.log(volume_spread()[which]) / np.log(STEP)))] = np.inf
        simplest: dict[tuple[float, ...], int] = {}
        for i in sorted(pareto_front(steps).nonzero()[0], key=lambda i: rows[i].effort):
            simplest.setdefault(tuple(steps[i]), i)
        on_front[name] = np.isin(np.arange(len(rows)), list(simplest.values()))
    return on_front


def numbered(rows: Sequence[Measurement]) -> list[int]:
    """Return the places in `rows` of the settings on any front, the fastest first."""
    on_front = np.any(list(fronts(rows).values()), axis=0)
    return sorted(on_front.nonzero()[0].tolist(), key=lambda i: rows[i].models)


def as_object(rows: Sequence[Measurement]) -> dict[str, Any]:
    """Return settings as plain values, and which are on a front."""
    return {
        "settings": [row.columns() for row in rows],
        "fronts": {
            name: [rows[i].label for i in front.nonzero()[0]]
            for name, front in fronts(rows).items()
        },
    }


def report(rows: Sequence[Measurement]) -> str:
    """Return the table of the settings on a front, with times at one speed of the machine."""
    rows = at_one_speed(rows)
    line = "{:>3} {:<46}{:>9}{:>8}{:>9}{:>9}{:>8}  {}"
    lines = [line.format("no", "setting", "position", "angle", "median", "99 %", "models", "front")]
    lines.append(line.format("", "", "m", "deg", "ms", "ms", "", ""))
    on_front = fronts(rows)
    for number, i in enumerate(numbered(rows), start=1):
        row = rows[i]
        errors = f"{row.position_m:.3f}", f"{row.angle_deg:.2f}"
        times = f"{row.median_ms:.2f}", f"{row.p99_ms:.2f}", f"{row.models:.1f}"
        names = " and ".join(name for name, front in on_front.items() if front[i])
        lines.append(line.format(number, row.label, *errors, *times, names))
    return "\n".join(lines)


MARKERS: dict[Shape, str] = {"curved": "o", "planar": "s"}
SPECIFIED = (float(SPECIFICATION[0]), float(SPECIFICATION[3]))
FLOOR_GAP, LABEL_GAP = 0.035, 0.05  # of the axes' height, between two labels
MARGIN, LABELS_AT = 0.3, 0.25  # of the axes' width, left of all points: for words and numbers


def draw(rows: Sequence[Measurement], about: str) -> Any:
    """Draw errors against time, every setting a point; return the figure."""
    rows = at_one_speed(rows)
    figure = new_figure(14, 9.6)
    grid = figure.add_gridspec(2, 2, height_ratios=[3, 1])
    for place, name in enumerate(ERRORS):
        _draw_panel(figure.add_subplot(grid[0, place]), rows, name)
    key = figure.add_subplot(grid[1, 0])
    key.set_axis_off()
    words: dict[str, Any] = {"family": "monospace", "fontsize": 7.5, "linespacing": 1.35}
    key.text(-0.07, 1, report(rows), va="top", in_layout=False, **words)
    _draw_legend(figure.add_subplot(grid[1, 1]), rows)
    figure.suptitle(f"What accuracy costs in time\n{about}", fontsize=12)
    return figure


def _size(side: int) -> float:
    """Area of a marker, larger for more detectors."""
    return 16.0 * (side - 1) ** 0.75


def _series(rows: Sequence[Measurement]) -> dict[tuple[str, Shape, int], list[Measurement]]:
    """Return the settings that differ by their table alone, smallest first."""
    series: dict[tuple[str, Shape, int], list[Measurement]] = {}
    for row in sorted(rows, key=lambda row: row.table_rows):
        series.setdefault((row.method, row.shape, row.detectors_per_side), []).append(row)
    return series


def _draw_panel(axes: Any, rows: Sequence[Measurement], name: str) -> None:
    from uuv_optical_array.plots import style

    column, label, which = ERRORS[name]
    best = [row for row, on in zip(rows, fronts(rows)[name], strict=True) if on]
    for (method, shape, side), tables in _series(rows).items():
        x, y = ([getattr(row, key) for row in tables] for key in ("median_ms", column))
        colour = style.METHOD_COLOURS[method]
        axes.plot(x, y, color=colour, lw=0.8, alpha=0.4, zorder=2)
        for row, a, b in zip(tables, x, y, strict=True):
            posed, on_front = row.without_pose <= MOST_WITHOUT_POSE, row in best
            if on_front:
                axes.plot([a, row.p99_ms], [b, b], color=colour, lw=1.4, alpha=0.6, zorder=2.6)
            axes.scatter(
                a,
                b,
                s=_size(side),
                marker=MARKERS[shape],
                facecolor=colour if posed else "none",
                edgecolor="w" if posed else colour,
                linewidth=0.6 if posed else 1.1,
                alpha=1.0 if on_front else 0.45,
                zorder=4 if on_front else 3,
            )
    model_ms = rows[0].model_ms
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel(f"time from image to pose, median (ms; a forward model takes {model_ms:.2g})")
    axes.set_ylabel(label, fontsize=12)
    fastest = min(row.median_ms for row in rows)
    slowest = 1.3 * max(*(row.median_ms for row in rows), *(row.p99_ms for row in best))
    axes.set_xlim(slowest * (0.85 * fastest / slowest) ** (1 / (1 - MARGIN)), slowest)
    unit = "m" if name == "position" else "deg"
    specified, guessed = SPECIFIED[which], volume_spread()[which]
    for value, text, line, colour in (
        (specified, f"specification, {specified:g} {unit}", "--", style.SPECIFIED),
        (guessed, "no measurement at all", ":", "0.4"),
    ):
        axes.axhline(value, color=colour, ls=line, lw=1.5, zorder=1)
        place = axes.get_yaxis_transform()
        offset = {"xytext": (0, 3), "textcoords": "offset points"}
        axes.annotate(text, (0.01, value), xycoords=place, **offset, fontsize=9, color=colour)
    _draw_front(axes, rows, name)
    axes.grid(alpha=0.3, which="both", lw=0.4)
    for axis in (axes.xaxis, axes.yaxis):
        style.plain_log_ticks(axis)
    above = axes.secondary_xaxis("top", functions=(_inverse, _inverse))
    above.set_xlabel("frames per second")
    above.xaxis.set_major_formatter("{x:g}")
    _draw_floors(axes, rows, name)


def _inverse(values: ArrayLike) -> Array:
    """Turn ms into frames per second, and back."""
    with np.errstate(divide="ignore"):
        return 1e3 / np.asarray(values, dtype=float)


def _heights(axes: Any, values: Sequence[float]) -> list[float]:
    """Return values of the vertical axis as fractions of its height."""
    low, high = np.log(axes.get_ylim())
    return [float((np.log(value) - low) / (high - low)) for value in values]


def _draw_floors(axes: Any, rows: Sequence[Measurement], name: str) -> None:
    """Mark each array's bound on the right edge, the labels spread so that none overlaps."""
    column = f"floor_{ERRORS[name][0]}"
    bounds = {(row.shape, row.detectors_per_side): getattr(row, column) for row in rows}
    items = sorted(bounds.items(), key=lambda item: item[1])
    heights = _heights(axes, [bound for _, bound in items])
    places = apart(heights, FLOOR_GAP)
    outside = {"transform": axes.transAxes, "clip_on": False}
    words = {"transform": axes.transAxes, "fontsize": 8.5}
    for ((shape, side), _), at, place in zip(items, heights, places, strict=True):
        axes.plot([0.965, 1.0, 1.03], [at, at, place], color="0.15", lw=1.3, **outside)
        axes.plot(1.045, place, MARKERS[shape], mfc="w", mec="0.15", ms=5, **outside)
        axes.text(1.065, place, f"{side}", va="center", **words)
    top = max(places) + 1.1 * FLOOR_GAP
    axes.text(1.085, top, "bound of\neach array", ha="center", va="bottom", color="0.15", **words)


def _draw_front(axes: Any, rows: Sequence[Measurement], name: str) -> None:
    """Draw the front as steps, its points with their numbers."""
    column = ERRORS[name][0]
    on_front = fronts(rows)[name]
    members = [(number, rows[i]) for number, i in enumerate(numbered(rows), 1) if on_front[i]]
    x, y = ([getattr(row, key) for _, row in members] for key in ("median_ms", column))
    axes.step(x, y, where="post", color="k", lw=1.0, zorder=2.5)
    # Labels stand in a column left of all points, spread so that none overlaps.
    members.sort(key=lambda member: float(getattr(member[1], column)))
    heights = _heights(axes, [getattr(row, column) for _, row in members])
    for (number, row), place in zip(members, apart(heights, LABEL_GAP), strict=True):
        number_label(axes, number, (row.median_ms, getattr(row, column)), (LABELS_AT, place))


def _draw_legend(axes: Any, rows: Sequence[Measurement]) -> None:

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


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "reference")
    parser.add_argument(
        "--full", action="store_true", help="every method, array and table, and more frames"
    )
    options.add_json(parser)
    outputs.add_folder(
        parser, "folder of CSV file and picture, .png and .pdf (default: SCENE.tradeoff here)"
    )


def run(args: argparse.Namespace) -> int:
    """Measure what is missing, and draw and print the results."""
    scene = options.scene_of(args)
    mode: Mode = get_args(Mode)[args.full]
    folder = outputs.folder_to_write(args.output or f"{scene.name}.tradeoff", "--output")
    measured = TradeoffRun(scene, mode, SEED, folder, plan(scene, mode))
    complete = measured.measure()
    rows = measured.rows
    loads = [row.load_average for row in rows]
    origin = measured.origin
    about = (
        f"scene {scene.name}, {origin.frames} frames each; {origin.machine}, "
        f"load average {min(loads):.1f} to {max(loads):.1f}"
    )

    figure = draw(rows, about)
    pictures = [folder / f"tradeoff{suffix}" for suffix in (".png", ".pdf")]
    for picture in pictures:
        save(figure, picture)
    without = sum(row.without_pose > MOST_WITHOUT_POSE for row in rows)
    lines = [
        f"{about}\n\nPareto-optimal settings in time and error:\n{report(rows)}\n",
        f"{without} of {len(rows)} settings left more than 1 % of frames without a pose",
        *([QUICK_LEAVES_OUT] if mode == "quick" else []),
        f"file: {folder / SETTINGS_CSV}",
        f"pictures: {', '.join(map(str, pictures))}",
    ]
    result = {"complete": complete, **vars(origin), **as_object(rows)}
    result["pictures"] = [*map(str, pictures)]
    missing = f"{len(rows)} of {measured.count} settings; run it again to go on"
    return outputs.finish(args, result, "\n".join(lines), "" if complete else missing)
