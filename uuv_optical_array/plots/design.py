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
from uuv_optical_array.plots.style import (
    SHAPE_COLOURS,
    SPECIFIED,
    apart,
    mark,
    number_label,
    plain_log_ticks,
    save,
)
from uuv_optical_array.studies.design.fronts import fronts, numbered, standing
from uuv_optical_array.studies.design.study import DesignStudy, ScoredDesign
from uuv_optical_array.studies.shared.separation import THRESHOLD_DEG
from uuv_optical_array.studies.shared.working_volume import SPECIFICATION, volume_spread

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
LABEL_GAP = 0.034  # between labels, of the height of the axes
CLOSE_UP_SIDE = 5


def _dots(
    axes: Axes, x: Sequence[float], rows: Sequence[ScoredDesign], name: str, colour: Any
) -> None:
    """Draw designs: hollow where the criterion fails, full at 4 m, a star from 4 to 8 m."""
    points = np.reshape(
        [(at, getattr(r.score, name)) for at, r in zip(x, rows, strict=True)], (-1, 2)
    )
    near, far = (
        np.array([getattr(r.score, key) for r in rows], bool)
        for key in ("resolved_at_4m", "resolved_4_to_8m")
    )
    looks: list[tuple[Any, dict[str, Any]]] = [
        (~near, {"marker": "o", "s": 17, "facecolor": "w", "edgecolor": colour}),
        (near & ~far, {"marker": "o", "s": 17, "facecolor": colour, "edgecolor": colour}),
        (far, {"marker": "*", "s": 48, "facecolor": colour, "edgecolor": "w", "linewidth": 0.4}),
    ]
    for which, look in looks:
        axes.scatter(*points[which].T, zorder=3, alpha=0.85, **{"linewidth": 0.8, **look})


def _levels(axes: Axes, name: str) -> None:
    """Draw the specification and what is known without light, and set up the axis of bounds."""
    label, wanted = BOUNDS[name]
    free = volume_spread()[list(BOUNDS).index(name)]
    axes.axhline(wanted, color=SPECIFIED, ls="--", lw=1.4, zorder=1)
    axes.axhline(free, color="0.5", ls=":", lw=1.4, zorder=1)
    axes.set(yscale="log", ylabel=label)
    plain_log_ticks(axes.yaxis)
    axes.grid(alpha=0.3, lw=0.5)


def _all_designs(axes: Axes, study: DesignStudy, rows: Sequence[ScoredDesign], name: str) -> None:
    sides = sorted({row.design.detectors_per_side for row in rows})
    widths = sorted({row.design.width_m for row in rows})

    def place(row: ScoredDesign) -> float:
        share = (widths.index(row.design.width_m) + 0.5) / len(widths) - 0.5
        return sides.index(row.design.detectors_per_side) + CENTRE[row.design.shape] + BAND * share

    for shape, colour in SHAPE_COLOURS.items():
        of_shape = [row for row in rows if row.design.shape == shape]
        _dots(axes, [place(row) for row in of_shape], of_shape, name, colour)
    _levels(axes, name)
    unit = "m" if name == "position_m" else "deg"
    free = volume_spread()[list(BOUNDS).index(name)]
    for value, text, colour in (
        (BOUNDS[name][1], f"specification,\n{BOUNDS[name][1]:g} {unit}", SPECIFIED),
        (free, "no measure-\nment at all", "0.35"),
    ):
        axes.annotate(
            text,
            (1, value),
            xycoords=axes.get_yaxis_transform(),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            color=colour,
        )
    for i in range(1, len(sides)):
        axes.axvline(i - 0.5, color="0.85", lw=0.8, zorder=0)
    axes.grid(visible=False, axis="x")
    axes.set_xticks(range(len(sides)), [f"{n} x {n}\n{n * n}" for n in sides])
    axes.set(xlim=(-0.5, len(sides) - 0.5), xlabel="detectors")
    named = numbered(study, rows)
    for style, found in zip(("-", (0, (1, 1)), "--"), fronts(study, rows).values(), strict=True):
        best = [
            min(
                (row for row in found if row.design.detectors_per_side == side),
                key=lambda row: getattr(row.score, name),
            )
            for side in sorted({row.design.detectors_per_side for row in found})
        ]
        x = [place(row) for row in best]
        axes.plot(x, [getattr(row.score, name) for row in best], "k", ls=style, lw=1, zorder=2.5)
    low, high = np.log(axes.get_ylim())
    for i, side in enumerate(sides):
        of_side = sorted(
            (row for row in named if row.design.detectors_per_side == side),
            key=lambda row: getattr(row.score, name),
        )
        heights = [(np.log(getattr(row.score, name)) - low) / (high - low) for row in of_side]
        for row, height in zip(of_side, apart(heights, LABEL_GAP), strict=True):
            point = place(row), getattr(row.score, name)
            at = (i + 0.5 + LANE) / len(sides), height
            number_label(axes, named.index(row) + 1, point, at, ha="right")


def _nearest(values: set[Any], wanted: float) -> Any:
    return min(values, key=lambda value: abs(value - wanted))


def _lines(
    axes: Axes,
    rows: Sequence[ScoredDesign],
    name: str,
    x: Callable[[ScoredDesign], float],
    groups: dict[str, tuple[Any, list[ScoredDesign]]],
) -> None:
    for label, (colour, group) in groups.items():
        group = sorted(group, key=x)
        places = [x(row) for row in group]
        values = [getattr(row.score, name) for row in group]
        axes.plot(places, values, color=colour, lw=1.3, label=label, zorder=2)
        _dots(axes, places, group, name, colour)
    _levels(axes, name)
    values = [getattr(row.score, name) for row in rows]
    axes.set_ylim(
        min(values) / 1.5,
        max(*values, volume_spread()[list(BOUNDS).index(name)]) * 1.3,
    )


def _close_up(axes: Sequence[Axes], study: DesignStudy, rows: Sequence[ScoredDesign]) -> None:
    """Draw one number of detectors: against the lamp's beam, and against the sphere."""
    own = study.scene.array
    side = _nearest({row.design.detectors_per_side for row in rows}, CLOSE_UP_SIDE)
    width = _nearest({row.design.width_m for row in rows}, own.width_m)
    sigma = _nearest({row.design.beam_sigma_deg for row in rows}, study.scene.lamp.beam_sigma_deg)
    close = [row for row in rows if row.design.detectors_per_side == side]
    by_lamp: dict[str, tuple[Any, list[ScoredDesign]]] = {}
    radii = sorted({row.design.radius_m for row in close if row.design.radius_m})
    shades = matplotlib.colormaps["viridis"](np.linspace(0, 0.85, len(radii)))
    for radius, shade in zip(radii, shades, strict=True):
        found = [r for r in close if (r.design.radius_m, r.design.width_m) == (radius, width)]
        if found:
            by_lamp[f"radius {radius:g} m"] = shade, found
    flat = [r for r in close if (r.design.radius_m, r.design.width_m) == (None, width)]
    if flat:
        by_lamp["planar"] = SHAPE_COLOURS["planar"], flat
    by_sphere: dict[str, tuple[Any, list[ScoredDesign]]] = {}
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
            by_sphere[f"{size:g} m wide"] = shade, found
    for i, name in enumerate(BOUNDS):
        for at, groups, label, title in (
            (i, by_lamp, "standard deviation of the beam (deg)", f"{side} x {side}, {width:g} m"),
            (2 + i, by_sphere, "radius of the sphere (m)", f"{side} x {side}, beam {sigma:g} deg"),
        ):
            key = _sigma if at < 2 else _radius
            _lines(axes[at], close, name, key, groups)
            axes[at].set(xscale="log", xlabel=label, title=f"{title}: {name.split('_')[0]}")
            ticks = sorted({key(row) for _, group in groups.values() for row in group})
            axes[at].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            axes[at].xaxis.set_minor_locator(NullLocator())
            if groups and at % 2 == 0:
                axes[at].legend(fontsize=8, loc="best", framealpha=0.8)


def _sigma(row: ScoredDesign) -> float:
    return row.design.beam_sigma_deg


def _radius(row: ScoredDesign) -> float:
    return row.design.radius_m or 0.0


def _criterion(axes: Axes, rows: Sequence[ScoredDesign]) -> None:
    """Draw what the criterion and the bound say of each design."""
    for shape, colour in SHAPE_COLOURS.items():
        of_shape = [row for row in rows if row.design.shape == shape]
        least = [float(np.min([row.score.shift_deg, row.score.yaw_deg])) for row in of_shape]
        _dots(axes, least, of_shape, "angle_deg", colour)
    _levels(axes, "angle_deg")
    axes.axvline(THRESHOLD_DEG, color="k", lw=1)
    axes.set_xlabel("least spectral angle of 0.2 m and 10 deg, 4 to 8 m (deg)")
    axes.set_title("the criterion, and what is known")


def _key(axes: Axes, study: DesignStudy, rows: Sequence[ScoredDesign]) -> None:
    """List the designs that are named, and what each is worth."""
    axes.set_axis_off()
    line = "{:>2}  {:<6}{:>8}{:>7}{:>7}{:>6}{:>9}{:>7}  {:<9}{}"
    lines = [
        line.format("", "", "", "width", "radius", "beam", "position", "angle", "15 deg", "front"),
        line.format("", "", "", "m", "m", "deg", "m", "deg", "at", ""),
    ]
    told = zip(numbered(study, rows), standing(study, rows), strict=True)
    for number, ((design, score), where) in enumerate(told, start=1):
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
                where,
            )
        )
    axes.text(0, 1, "\n".join(lines), family="monospace", fontsize=8.5, va="top", linespacing=1.25)


def _legend(axes: Axes, width_m: float) -> None:
    axes.set_axis_off()
    handles = [
        *(
            mark(f"{shape}; wider arrays to the right", color=colour)
            for shape, colour in SHAPE_COLOURS.items()
        ),
        mark("0.2 m and 10 deg below 15 deg of spectral angle at 4 m", mfc="w"),
        mark("above it at 4 m, which is where the paper decides"),
        mark("above it from 4 to 8 m", "*", ms=9),
        mark(f"front 'fits': no wider than {width_m:g} m", "", color="k", lw=1),
        mark("front 'resolved': of these, 15 deg at 4 m", "", color="k", lw=1, ls=(0, (1, 1))),
        mark("front 'any': of any width", "", color="k", lw=1, ls="--"),
    ]
    axes.legend(handles=handles, loc="upper left", fontsize=9.5, frameon=False)


def draw_designs(study: DesignStudy, rows: Sequence[ScoredDesign], path: Path) -> None:
    """Draw a study.

    Parameters
    ----------
    study, rows
        What was scored, at least one design.
    path
        PNG, SVG or PDF file, written whole or not at all.
    """
    figure = Figure(figsize=(16, 14), layout="constrained")
    parts: Any = figure.subfigures(3, 1, height_ratios=[6, 3.5, 4])
    for axes, name in zip(parts[0].subplots(1, 2), BOUNDS, strict=True):
        _all_designs(axes, study, rows, name)
    _close_up(parts[1].subplots(1, 4), study, rows)
    left, middle, right = parts[2].subplots(1, 3, gridspec_kw={"width_ratios": [1.65, 1, 0.95]})
    _key(left, study, rows)
    _criterion(middle, rows)
    _legend(right, study.scene.array.width_m)
    figure.suptitle(
        f"What to build: {len(rows)} designs of array and lamp, scene {study.scene.name}\n"
        f"lamp power: {study.power}; mount: {study.mount}; {study.poses} poses, seed {study.seed}",
        fontsize=13,
    )
    save(figure, path)
