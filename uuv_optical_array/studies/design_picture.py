"""The picture of a design study: bounds against detectors, lamp, size and radius."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.working_volume import SPECIFICATION, volume_spread
from uuv_optical_array.plots.style import (
    SHAPE_COLOURS,
    SPECIFIED,
    apart,
    mark,
    new_figure,
    number_label,
    plain_log_ticks,
    shades,
)
from uuv_optical_array.studies.design_score import Choice, DesignStudy, ScoredDesign
from uuv_optical_array.studies.design_sweep import Design
from uuv_optical_array.studies.shared.separation import THRESHOLD_DEG

# Score, axis label, and the specification.
BOUNDS = {
    "position_m": ("bound on position, RMS (m)", float(SPECIFICATION[0])),
    "angle_deg": ("bound on angle, RMS (deg)", float(SPECIFICATION[3])),
}
# Where the shapes of a number of detectors are, how wide each is, and where labels end, of the
# distance between two numbers of detectors.
CENTRE: dict[Shape, float] = {"planar": -0.3, "curved": 0.04}
BAND = 0.3
LANE = 0.485
LABEL_GAP = 0.045  # between labels, of the height of the axes
CLOSE_UP_SIDE = 5


def draw(choice: Choice) -> Any:
    """Draw bounds against detectors, lamp, size and radius, and list the designs that fit."""
    study, rows = choice.study, choice.rows
    listed = [*choice.fronts["fits"], *choice.papers]
    named = {number: row for number, row in enumerate(choice.numbered, start=1) if row in listed}
    figure = new_figure(14, 13)
    parts: Any = figure.subfigures(3, 1, height_ratios=[5, 4, 2.4])
    for axes, name in zip(parts[0].subplots(1, 2), BOUNDS, strict=True):
        _all_designs(axes, choice, named, name)
    by_beam, by_radius, criterion = parts[1].subplots(1, 3)
    _close_up(by_beam, by_radius, study, rows)
    _dots(criterion, [min(row.shift_deg, row.yaw_deg) for row in rows], rows, "angle_deg")
    _levels(criterion, "angle_deg")
    criterion.axvline(THRESHOLD_DEG, color="k", lw=1)
    criterion.set_xlabel("least spectral angle of 0.2 m and 10 deg, 4 to 8 m (deg)")
    criterion.set_title(f"the paper's criterion, {THRESHOLD_DEG:g} deg, and the bound")
    left, right = parts[2].subplots(1, 2, gridspec_kw={"width_ratios": [2.2, 1]})
    left.set_axis_off()
    table = choice.table(named)
    size = 7.5 * min(1.0, 135 / max(map(len, table.splitlines())))
    words: dict[str, Any] = {"family": "monospace", "fontsize": size, "linespacing": 1.3}
    left.text(0, 1, table, va="top", in_layout=False, **words)
    right.set_axis_off()
    handles = [
        *(mark(f"{s}; wider arrays to the right", color=c) for s, c in SHAPE_COLOURS.items()),
        mark(f"front 'fits': no wider than {study.scene.array.width_m:g} m, numbered", "",
             color="k", lw=1.2),
        mark("front 'any': of any width", "", color="k", lw=1.2, ls="--"),
        mark("specification of the paper", "", color=SPECIFIED, lw=1.4, ls="--"),
        mark("no measurement at all", "", color="0.5", lw=1.4, ls=":"),
    ]  # fmt: skip
    right.legend(handles=handles, loc="upper left", fontsize=10, frameon=False)
    figure.suptitle(
        f"What to build: {len(rows)} designs of array and lamp, scene {study.scene.name}\n"
        f"lamp power: {study.power}; mount: {study.mount}; {study.poses} poses, seed {study.seed}",
        fontsize=13,
    )
    return figure


def _levels(axes: Any, name: str) -> None:
    """Draw the specification and what is known without light, and set up the axis of bounds."""
    label, wanted = BOUNDS[name]
    free = volume_spread()[list(BOUNDS).index(name)]
    axes.axhline(wanted, color=SPECIFIED, ls="--", lw=1.4, zorder=1)
    axes.axhline(free, color="0.5", ls=":", lw=1.4, zorder=1)
    axes.set(yscale="log", ylabel=label)
    plain_log_ticks(axes.yaxis)
    axes.grid(alpha=0.3, lw=0.5)


def _dots(axes: Any, x: Sequence[float], rows: Sequence[ScoredDesign], name: str) -> None:
    """Draw designs as pale dots, coloured by their shape."""
    colours = [SHAPE_COLOURS[row.shape] for row in rows]
    y = [getattr(row, name) for row in rows]
    axes.scatter(x, y, s=9, c=colours, alpha=0.3, lw=0, zorder=2)


def _all_designs(axes: Any, choice: Choice, named: dict[int, ScoredDesign], name: str) -> None:
    """Draw every design by its number of detectors, the fronts, and the numbers of the named."""
    rows = choice.rows
    sides = sorted({row.detectors_per_side for row in rows})
    widths = sorted({row.width_m for row in rows})

    def bound(row: ScoredDesign) -> float:
        return float(getattr(row, name))

    def place(row: ScoredDesign) -> float:
        share = (widths.index(row.width_m) + 0.5) / len(widths) - 0.5
        return sides.index(row.detectors_per_side) + CENTRE[row.shape] + BAND * share

    _dots(axes, [place(row) for row in rows], rows, name)
    _levels(axes, name)
    for i in range(1, len(sides)):
        axes.axvline(i - 0.5, color="0.85", lw=0.8, zorder=0)
    axes.grid(visible=False, axis="x")
    axes.set_xticks(range(len(sides)), [f"{n} x {n}" for n in sides])
    axes.set(xlim=(-0.5, len(sides) - 0.5), xlabel="detectors")
    for front_name, style in (("fits", "-"), ("any", "--")):
        # Of each number of detectors the best; the last of a key stays.
        on_front = sorted(choice.fronts[front_name], key=bound, reverse=True)
        best = {row.detectors_per_side: row for row in on_front}
        line = [best[side] for side in sorted(best)]
        axes.plot([*map(place, line)], [*map(bound, line)], "k", ls=style, lw=1.2, zorder=2.5)
    low, high = np.log(axes.get_ylim())
    for i, side in enumerate(sides):
        of_side = [(n, row) for n, row in named.items() if row.detectors_per_side == side]
        of_side.sort(key=lambda item: (bound(item[1]), item[0]))
        heights = [(np.log(bound(row)) - low) / (high - low) for _, row in of_side]
        for (number, row), height in zip(of_side, apart(heights, LABEL_GAP), strict=True):
            point = place(row), bound(row)
            axes.plot(*point, "o", color=SHAPE_COLOURS[row.shape], ms=6, mec="k", zorder=3)
            at = (i + 0.5 + LANE) / len(sides), height
            number_label(axes, number, point, at, ha="right")


def _close_up(
    by_beam: Any, by_radius: Any, study: DesignStudy, rows: Sequence[ScoredDesign]
) -> None:
    """Draw one number of detectors: against the lamp's beam, and against the sphere."""
    own = Design.of(study.scene)

    def nearest(name: str, wanted: float) -> Any:
        values = {getattr(row, name) for row in rows}
        return min(values, key=lambda value: abs(value - wanted))

    def same(*names: str) -> list[ScoredDesign]:
        """Return designs with the detectors and of the lamps that stand for all, and more alike."""
        alike = ["detectors_per_side", *names]
        return [r for r in rows if all(getattr(r, name) == stands[name] for name in alike)]

    stands = {name: nearest(name, getattr(own, name)) for name in ("width_m", "beam_sigma_deg")}
    stands["detectors_per_side"] = side = nearest("detectors_per_side", CLOSE_UP_SIDE)
    rings = "lamps", "spread_m", "tilt_deg"
    ring = min(rows, key=lambda row: [abs(getattr(row, n) - getattr(own, n)) for n in rings])
    stands |= {"ring": ring.ring, "lamps": ring.lamps}
    width, sigma = stands["width_m"], stands["beam_sigma_deg"]
    _lines(by_beam, same("width_m", "ring", "lamps"), "beam_sigma_deg", "radius_m",
           "radius {:g} m", "viridis")  # fmt: skip
    by_beam.set_xlabel("standard deviation of the beam (deg)")
    by_beam.set_title(f"{side} x {side} on {width:g} m")
    if len(study.sweep.lamps) > 1:
        of_array = [r for r in same("width_m", "beam_sigma_deg") if r.radius_m == own.radius_m]
        _lines(by_radius, of_array, "lamps", "ring", "{}", "viridis")
        by_radius.set_xlabel("lamps, so far from their middle and turned outwards")
        by_radius.set_title(f"{side} x {side} on {width:g} m, beam of {sigma:g} deg")
        return
    of_sigma = [row for row in same("beam_sigma_deg", "ring", "lamps") if row.radius_m]
    _lines(by_radius, of_sigma, "radius_m", "width_m", "{:g} m wide", "cividis")
    by_radius.set_xlabel("radius of the sphere (m)")
    by_radius.set_title(f"{side} x {side}, beam of {sigma:g} deg")


def _lines(
    axes: Any, rows: Sequence[ScoredDesign], x_name: str, group_name: str, label: str, cmap: str
) -> None:
    """Draw the bound on the position against a setting, a line for each value of another one."""
    from matplotlib.ticker import NullLocator

    lines: dict[Any, list[tuple[float, float]]] = {}
    for row in rows:
        point = getattr(row, x_name), row.position_m
        lines.setdefault(getattr(row, group_name), []).append(point)
    values = sorted(lines.keys() - {None})
    colours = dict(zip(values, shades(cmap, 0, 0.88, len(values)), strict=True))
    for value in values + [None] * (None in lines):
        x, y = np.transpose(sorted(lines[value]))
        text = "planar" if value is None else label.format(value)
        colour = SHAPE_COLOURS["planar"] if value is None else colours[value]
        axes.plot(x, y, "o-", color=colour, lw=1.5, ms=4, label=text)
    _levels(axes, "position_m")
    axes.set_xscale("log")
    ticks = sorted({getattr(row, x_name) for row in rows})
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.xaxis.set_minor_locator(NullLocator())
    if rows:
        few = len(lines) < 7
        axes.legend(fontsize=9 if few else 6, ncols=1 if few else 2, framealpha=0.85)
