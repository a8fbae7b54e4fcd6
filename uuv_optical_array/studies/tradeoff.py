"""``uuv_array study tradeoff``: measure what accuracy costs in time, by method and table.

Measure error and time per frame of every method (sam, sam_interpolated, least_squares, and the
published look-up and moments) on arrays of 3, 5, 7 and 21 detectors a side, planar and curved, with
tables of 1e3 to 1e7 poses. Errors are of random poses 4 to 8 m behind the lamp, +-0.9 m and
+-20 deg; times are from an image to its pose. The results, with the time to build each table, go
into a CSV file and a picture in the output folder. A stopped run goes on where it was. See
docs/results/tradeoff.md.

  uuv_array study tradeoff                   some settings of the reference scene
  uuv_array study tradeoff --full            all of them
  uuv_array study tradeoff --scene sea.yaml  your own scene, into sea.tradeoff/
Ctrl-C ends it early and draws the settings that are measured.
"""

import argparse
import dataclasses
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.forward.working_volume import SPECIFICATION, volume_spread
from uuv_optical_array.plots import style
from uuv_optical_array.studies.shared import tradeoff_measurement as measured
from uuv_optical_array.studies.shared.pareto import STEP, pareto_front
from uuv_optical_array.studies.shared.results import Results
from uuv_optical_array.studies.shared.tradeoff_measurement import Measurement, Mode, plan

QUICK_LEAVES_OUT = (
    "left out but for --full: tables of 1e7 poses, of 1e6 but on the scene's own array, of 1e3 and "
    "8e3 on arrays of the other shape, and the look-up but on planar arrays up to 7 x 7"
)
ERRORS = {
    "position": ("position_m", "RMS position error (m)", 0),
    "angle": ("angle_deg", "RMS angle error (deg)", 1),
}


def at_one_speed(rows: Sequence[Measurement]) -> list[Measurement]:
    """Return rows with times as if the machine had been as fast for all as for the median one."""
    model_ms = statistics.median([row.model_ms for row in rows]) if rows else 0.0
    scaled = []
    for row in rows:
        median_ms, p99_ms = (ms * model_ms / row.model_ms for ms in (row.median_ms, row.p99_ms))
        times: dict[str, Any] = {"median_ms": median_ms, "p99_ms": p99_ms, "model_ms": model_ms}
        scaled.append(dataclasses.replace(row, **times))
    return scaled


def fronts(rows: Sequence[Measurement]) -> dict[str, NDArray[np.bool_]]:
    """Find which rows are on each Pareto front, by ``position`` and ``angle``, shape ``(n,)``.

    The costs are the median time, in forward models, and one of the two errors. The middle of the
    volume is an estimate without any measurement, so a setting has to be better than that, and one
    that leaves frames without a pose is on no front. Time and error are rounded to steps of 10 %.
    Of settings that are then equal, only the one of least effort is on the front.
    """
    on_front = {}
    for name, (column, _, which) in ERRORS.items():
        costs = np.reshape([(row.models, getattr(row, column)) for row in rows], (-1, 2))
        costs[[row.without_pose > measured.MOST_WITHOUT_POSE for row in rows]] = np.inf
        steps = np.round(np.log(costs) / np.log(STEP))
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


def report(rows: Sequence[Measurement]) -> str:
    """Return the table of the settings on a front, with times at one speed of the machine."""
    rows = at_one_speed(rows)
    heads = ("no", "setting", "position", "angle", "median", "99 %", "models", "front")
    lines: list[tuple[object, ...]] = [heads, ("", "", "m", "deg", "ms", "ms")]
    on_front = fronts(rows)
    for number, i in enumerate(numbered(rows), start=1):
        row = rows[i]
        off = f"{row.position_m:.3f}", f"{row.angle_deg:.2f}"
        times = f"{row.median_ms:.2f}", f"{row.p99_ms:.2f}", f"{row.models:.1f}"
        names = " and ".join(name for name, front in on_front.items() if front[i])
        lines.append((number, row.label, *off, *times, names))
    return columns(lines, 2)


LABEL_GAP, LABELS_AT, MARGIN = 0.05, 0.3, 0.35  # of the axes, which leave room for numbers
PALE = 0.3  # how opaque the mark of a setting on no front is


def draw(rows: Sequence[Measurement], about: str) -> Any:
    """Draw errors against time, every setting a mark; return the figure."""
    rows = at_one_speed(rows)
    figure, mark = style.new_figure(14, 9.6), style.mark
    grid = figure.add_gridspec(2, 1, height_ratios=[3, 1])
    above = grid[0].subgridspec(1, 2)
    for i, name in enumerate(ERRORS):
        _draw_panel(figure.add_subplot(above[0, i]), rows, name)
    style.write_table(figure.add_subplot(grid[1]), report(rows), 8.5, 1.35)
    marks = {m: at for m, at in style.METHOD_MARKS.items() if any(row.method == m for row in rows)}
    handles = [
        *(mark(m, at, color=style.METHOD_COLOURS[m], ms=8) for m, at in marks.items()),
        mark("filled: curved array", "h", ms=8),
        mark("hollow: planar array", "h", mfc="none", ms=8),
        mark("pale: another setting is better", "h", alpha=PALE, ms=8),
        mark("front, numbered as below", "", color="k", lw=1.5),
        mark(f"over {measured.MOST_WITHOUT_POSE:.0%} without a pose", "x", color="0.5"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=10, frameon=False)
    figure.suptitle(f"What accuracy costs in time\n{about}", fontsize=12)
    return figure


def _draw_panel(axes: Any, rows: Sequence[Measurement], name: str) -> None:
    """Draw one of the errors of each setting, its front, and what it can be compared with."""
    column, title, which = ERRORS[name]
    on_front = fronts(rows)[name]
    for row, best in zip(rows, on_front, strict=True):
        colour = style.METHOD_COLOURS[row.method]
        look = {"marker": style.METHOD_MARKS[row.method], "fc": colour, "ec": colour, "s": 55}
        if row.without_pose > measured.MOST_WITHOUT_POSE:
            look = {"marker": "x", "color": "0.5", "s": 30}
        elif row.shape == "planar":
            look["fc"] = "none"
        alpha = 1.0 if best else PALE
        axes.scatter(row.median_ms, getattr(row, column), alpha=alpha, zorder=3, **look)
    axes.set(xscale="log", yscale="log", xlabel="median time of a frame (ms)", ylabel=title)
    low, high = np.log(axes.get_xlim())
    # Room for numbers left of all points.
    axes.set_xlim(np.exp(low - (high - low) * MARGIN / (1 - MARGIN)), np.exp(high))
    best = min(rows, key=lambda row: getattr(row, f"floor_{column}"))
    side, unit = best.detectors_per_side, column.rpartition("_")[2]
    wanted = float(SPECIFICATION[3 * which])
    for value, text, line, colour in (
        (wanted, f"{wanted:g} {unit}, wanted by the paper", "--", style.SPECIFIED),
        (volume_spread()[which], "no measurement at all", ":", "0.4"),
        (getattr(best, f"floor_{column}"), f"bound, {best.shape} {side} x {side}", "-.", "0.4"),
    ):
        axes.axhline(value, color=colour, ls=line, lw=1.5, zorder=1)
        words = {"xytext": (0, 3), "textcoords": "offset points", "fontsize": 9}
        axes.annotate(text, (0.01, value), xycoords=axes.get_yaxis_transform(), **words)
    members = {number: rows[i] for number, i in enumerate(numbered(rows), 1) if on_front[i]}
    points = {n: (row.median_ms, float(getattr(row, column))) for n, row in members.items()}
    axes.step(*zip(*points.values(), strict=True), where="post", color="k", lw=1.5, zorder=2.5)
    style.number_points(axes, points, LABELS_AT, LABEL_GAP)
    axes.grid(alpha=0.3, which="both", lw=0.4)
    for axis in (axes.xaxis, axes.yaxis):
        style.plain_log_ticks(axis)
    above = axes.secondary_xaxis("top", functions=(_inverse, _inverse))
    above.set_xlabel("frames per second")
    above.xaxis.set_major_formatter("{x:g}")


def _inverse(values: ArrayLike) -> Array:
    """Turn ms into frames per second, and back."""
    with np.errstate(divide="ignore"):
        return 1e3 / np.asarray(values, dtype=float)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "reference")
    about = "every method, array and table, and more frames"
    parser.add_argument("--full", action="store_true", help=about)
    options.add_json(parser)
    about = "folder of CSV file and picture, .png and .pdf (default: SCENE.tradeoff here)"
    outputs.add_folder(parser, about)


def run(args: argparse.Namespace) -> int:
    """Measure what is missing, and draw and print the results."""
    scene = options.scene_of(args)
    mode: Mode = get_args(Mode)[args.full]
    folder = outputs.folder_to_write(args.output or f"{scene.name}.tradeoff", "--output")
    results = Results(folder / measured.SETTINGS_CSV, Measurement, measured.origin_of(scene, mode))
    groups = plan(scene, mode)
    complete, rows = measured.measure_missing(scene, groups, results), results.lines
    loads, origin = [row.load_average for row in rows], results.origin
    load = f"load average {min(loads):.1f} to {max(loads):.1f}"
    about = f"scene {scene.name}, {origin['frames']} frames each; {origin['machine']}, {load}"
    pictures = [str(folder / f"tradeoff{suffix}") for suffix in (".png", ".pdf")]
    figure = draw(rows, about)
    for picture in pictures:
        style.save(figure, Path(picture))
    without = sum(row.without_pose > measured.MOST_WITHOUT_POSE for row in rows)
    lines = [
        f"{about}\n\nPareto-optimal settings in time and error:\n{report(rows)}\n",
        f"{without} of {len(rows)} settings left more than 1 % of frames without a pose",
        *([QUICK_LEAVES_OUT] if mode == "quick" else []),
        f"file: {folder / measured.SETTINGS_CSV}",
        f"pictures: {', '.join(pictures)}",
    ]
    labels = {name: [rows[i].label for i in on.nonzero()[0]] for name, on in fronts(rows).items()}
    result = {"complete": complete, **origin, "settings": [row.columns() for row in rows]}
    result |= {"fronts": labels, "pictures": pictures}
    count = sum(len(group.methods) for group in groups)
    missing = f"{len(rows)} of {count} settings; run it again to go on"
    return outputs.finish(args, result, "\n".join(lines), complete, missing)
