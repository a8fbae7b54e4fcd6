"""The picture of a design study: bounds against detectors, lamp, size and radius."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.working_volume import SPECIFICATION, volume_spread
from uuv_optical_array.plots.style import (
    SHAPE_COLOURS,
    SPECIFIED,
    apart,
    mark,
    number_label,
    plain_log_ticks,
    save,
)
from uuv_optical_array.studies.design.fronts import (
    fronts,
    is_papers_array,
    numbered,
    standing,
)
from uuv_optical_array.studies.design.study import DesignStudy, ScoredDesign
from uuv_optical_array.studies.separation import THRESHOLD_DEG

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
FRONTS = {"fits": "-", "any": "--"}  # those that are drawn, and their lines


def _listed(study: DesignStudy, rows: Sequence[ScoredDesign]) -> dict[int, ScoredDesign]:
    """Return the designs that are named, by the number that the command gives them."""
    fits = fronts(study, rows)["fits"]
    own = study.scene.lamp.beam_sigma_deg
    return {
        number: row
        for number, row in enumerate(numbered(study, rows), start=1)
        if row in fits or (is_papers_array(row.design) and row.design.beam_sigma_deg == own)
    }


def _levels(axes: Axes, name: str) -> None:
    """Draw the specification and what is known without light, and set up the axis of bounds."""
    label, wanted = BOUNDS[name]
    free = volume_spread()[list(BOUNDS).index(name)]
    axes.axhline(wanted, color=SPECIFIED, ls="--", lw=1.4, zorder=1)
    axes.axhline(free, color="0.5", ls=":", lw=1.4, zorder=1)
    axes.set(yscale="log", ylabel=label)
    plain_log_ticks(axes.yaxis)
    axes.grid(alpha=0.3, lw=0.5)


def _dots(axes: Axes, x: Sequence[float], rows: Sequence[ScoredDesign], name: str) -> None:
    """Draw designs as pale dots, coloured by their shape."""
    for shape, colour in SHAPE_COLOURS.items():
        points = [
            (place, getattr(row.score, name))
            for place, row in zip(x, rows, strict=True)
            if row.design.shape == shape
        ]
        at, values = np.reshape(points, (-1, 2)).T
        axes.scatter(at, values, s=9, color=colour, alpha=0.3, lw=0, zorder=2)


def _all_designs(axes: Axes, study: DesignStudy, rows: Sequence[ScoredDesign], name: str) -> None:
    """Draw every design by its number of detectors, the fronts, and the numbers of the named."""
    sides = sorted({row.design.detectors_per_side for row in rows})
    widths = sorted({row.design.width_m for row in rows})

    def place(row: ScoredDesign) -> float:
        share = (widths.index(row.design.width_m) + 0.5) / len(widths) - 0.5
        return sides.index(row.design.detectors_per_side) + CENTRE[row.design.shape] + BAND * share

    _dots(axes, [place(row) for row in rows], rows, name)
    _levels(axes, name)
    for i in range(1, len(sides)):
        axes.axvline(i - 0.5, color="0.85", lw=0.8, zorder=0)
    axes.grid(visible=False, axis="x")
    axes.set_xticks(range(len(sides)), [f"{n} x {n}" for n in sides])
    axes.set(xlim=(-0.5, len(sides) - 0.5), xlabel="detectors")
    found = fronts(study, rows)
    for front, style in FRONTS.items():
        best = [
            min(
                (row for row in found[front] if row.design.detectors_per_side == side),
                key=lambda row: getattr(row.score, name),
            )
            for side in sorted({row.design.detectors_per_side for row in found[front]})
        ]
        x = [place(row) for row in best]
        axes.plot(x, [getattr(row.score, name) for row in best], "k", ls=style, lw=1.2, zorder=2.5)
    named = _listed(study, rows)
    low, high = np.log(axes.get_ylim())
    for i, side in enumerate(sides):
        of_side = sorted(
            (item for item in named.items() if item[1].design.detectors_per_side == side),
            key=lambda item: float(getattr(item[1].score, name)),
        )
        heights = [(np.log(getattr(row.score, name)) - low) / (high - low) for _, row in of_side]
        for (number, row), height in zip(of_side, apart(heights, LABEL_GAP), strict=True):
            point = place(row), getattr(row.score, name)
            axes.plot(*point, "o", color=SHAPE_COLOURS[row.design.shape], ms=6, mec="k", zorder=3)
            at = (i + 0.5 + LANE) / len(sides), height
            number_label(axes, number, point, at, ha="right")


def _nearest(values: set[Any], wanted: float) -> Any:
    return min(values, key=lambda value: abs(value - wanted))


def _lines(
    axes: Axes,
    x: Callable[[ScoredDesign], float],
    groups: dict[str, tuple[Any, list[ScoredDesign]]],
) -> None:
    """Draw the bound on the position against something, a line a group."""
    for label, (colour, group) in groups.items():
        group = sorted(group, key=x)
        values = [row.score.position_m for row in group]
        axes.plot([x(row) for row in group], values, "o-", color=colour, lw=1.5, ms=4, label=label)
    _levels(axes, "position_m")
    axes.set_xscale("log")
    ticks = sorted({x(row) for _, group in groups.values() for row in group})
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.xaxis.set_minor_locator(NullLocator())
    if groups:
        axes.legend(fontsize=9, loc="best", framealpha=0.85)


def _close_up(
    by_beam: Axes, by_radius: Axes, study: DesignStudy, rows: Sequence[ScoredDesign]
) -> None:
    """Draw one number of detectors: against the lamp's beam, and against the sphere."""
    own = study.scene.array
    side = _nearest({row.design.detectors_per_side for row in rows}, CLOSE_UP_SIDE)
    width = _nearest({row.design.width_m for row in rows}, own.width_m)
    sigma = _nearest({row.design.beam_sigma_deg for row in rows}, study.scene.lamp.beam_sigma_deg)
    close = [row for row in rows if row.design.detectors_per_side == side]
    lamps: dict[str, tuple[Any, list[ScoredDesign]]] = {}
    radii = sorted({row.design.radius_m for row in close if row.design.radius_m})
    shades = matplotlib.colormaps["viridis"](np.linspace(0, 0.85, len(radii)))
    for radius, shade in zip(radii, shades, strict=True):
        found = [r for r in close if (r.design.radius_m, r.design.width_m) == (radius, width)]
        if found:
            lamps[f"radius {radius:g} m"] = shade, found
    flat = [r for r in close if (r.design.radius_m, r.design.width_m) == (None, width)]
    if flat:
        lamps["planar"] = SHAPE_COLOURS["planar"], flat
    spheres: dict[str, tuple[Any, list[ScoredDesign]]] = {}
    widths = sorted({row.design.width_m for row in close})
    shades = matplotlib.colormaps["cividis"](np.linspace(0, 0.9, len(widths)))
    for size, shade in zip(widths, shades, strict=True):
        found = [
            row
            for row in close
            if (row.design.width_m, row.design.beam_sigma_deg) == (size, sigma)
            and row.design.radius_m
        ]
        if found:
            spheres[f"{size:g} m wide"] = shade, found
    _lines(by_beam, lambda row: row.design.beam_sigma_deg, lamps)
    by_beam.set(
        xlabel="standard deviation of the beam (deg)", title=f"{side} x {side} on {width:g} m"
    )
    _lines(by_radius, lambda row: row.design.radius_m or 0.0, spheres)
    by_radius.set(
        xlabel="radius of the sphere (m)", title=f"{side} x {side}, beam of {sigma:g} deg"
    )


def _criterion(axes: Axes, rows: Sequence[ScoredDesign]) -> None:
    """Draw what the criterion and the bound say of each design."""
    _dots(axes, [min(row.score.shift_deg, row.score.yaw_deg) for row in rows], rows, "angle_deg")
    _levels(axes, "angle_deg")
    axes.axvline(THRESHOLD_DEG, color="k", lw=1)
    axes.set_xlabel("least spectral angle of 0.2 m and 10 deg, 4 to 8 m (deg)")
    axes.set_title(f"the paper's criterion, {THRESHOLD_DEG:g} deg, and the bound")


def _key(axes: Axes, study: DesignStudy, rows: Sequence[ScoredDesign]) -> None:
    """List the designs that are named, and what each is worth."""
    axes.set_axis_off()
    line = "{:>2}  {:<6}{:>8}{:>7}{:>7}{:>6}{:>10}{:>7}  {:<8}{}"
    lines = [
        line.format("", "", "", "width", "radius", "beam", "position", "angle", "15 deg", "front"),
        line.format("", "", "", "m", "m", "deg", "m", "deg", "at", ""),
    ]
    where = standing(study, rows)
    for number, row in _listed(study, rows).items():
        design, score = row.design, row.score
        lines.append(
            line.format(
                number,
                design.shape,
                f"{design.detectors_per_side} x {design.detectors_per_side}",
                f"{design.width_m:g}",
                "-" if design.radius_m is None else f"{design.radius_m:g}",
                f"{design.beam_sigma_deg:g}",
                f"{score.position_m:.3f}",
                f"{score.angle_deg:.2f}",
                score.resolved,
                where[number - 1],
            )
        )
    axes.text(0, 1, "\n".join(lines), family="monospace", fontsize=10, va="top", linespacing=1.3)


def _legend(axes: Axes, width_m: float) -> None:
    axes.set_axis_off()
    handles = [
        *(
            mark(f"{shape}; wider arrays to the right", color=colour)
            for shape, colour in SHAPE_COLOURS.items()
        ),
        mark(f"front 'fits': no wider than {width_m:g} m, numbered", "", color="k", lw=1.2),
        mark("front 'any': of any width", "", color="k", lw=1.2, ls="--"),
        mark("specification of the paper", "", color=SPECIFIED, lw=1.4, ls="--"),
        mark("no measurement at all", "", color="0.5", lw=1.4, ls=":"),
    ]
    axes.legend(handles=handles, loc="upper left", fontsize=10, frameon=False)


def draw_designs(study: DesignStudy, rows: Sequence[ScoredDesign], path: Path) -> None:
    """Draw a study.

    Parameters
    ----------
    study, rows
        What was scored, at least one design.
    path
        Picture, written whole or not at all.
    """
    figure = Figure(figsize=(14, 13), layout="constrained")
    parts: Any = figure.subfigures(3, 1, height_ratios=[5, 4, 2.4])
    for axes, name in zip(parts[0].subplots(1, 2), BOUNDS, strict=True):
        _all_designs(axes, study, rows, name)
    by_beam, by_radius, criterion = parts[1].subplots(1, 3)
    _close_up(by_beam, by_radius, study, rows)
    _criterion(criterion, rows)
    left, right = parts[2].subplots(1, 2, gridspec_kw={"width_ratios": [2.2, 1]})
    _key(left, study, rows)
    _legend(right, study.scene.array.width_m)
    figure.suptitle(
        f"What to build: {len(rows)} designs of array and lamp, scene {study.scene.name}\n"
        f"lamp power: {study.power}; mount: {study.mount}; {study.poses} poses, seed {study.seed}",
        fontsize=13,
    )
    save(figure, path)
