"""The picture of a choice of designs."""

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.working_volume import GUESSED, SPECIFIED
from uuv_optical_array.plots import style
from uuv_optical_array.studies.designs.choice import Choice
from uuv_optical_array.studies.designs.scores import ScoredDesign
from uuv_optical_array.studies.shared.separation import MOVES, THRESHOLD_DEG

# Score, axis label, the specification, and what is known without light.
BOUNDS = {
    "position_m": ("bound on position, RMS (m)", SPECIFIED[0], GUESSED[0]),
    "angle_deg": ("bound on angle, RMS (deg)", SPECIFIED[1], GUESSED[1]),
}
BESIDE: dict[Shape, float] = {"planar": -0.2, "curved": 0.0}  # where a shape is drawn


def draw(choice: Choice, about: str) -> Any:
    """Draw bounds against detectors, numbered as in `Choice.table`, and the paper's criterion."""
    rows, width_m = choice.rows, choice.scene.array.width_m
    figure = style.new_figure(16, 7)
    *by_detectors, criterion = figure.subplots(1, 3)
    for axes, name in zip(by_detectors, BOUNDS, strict=True):
        _all_designs(axes, choice, name)
    _dots(criterion, [min(row.shift_deg, row.yaw_deg) for row in rows], rows, "angle_deg")
    criterion.axvline(THRESHOLD_DEG, color="k", lw=1)
    criterion.set_xlabel(f"spectral angle of {' or '.join(MOVES)}, the lesser, 4 to 8 m (deg)")
    criterion.set_title(f"right of {THRESHOLD_DEG:g} deg the paper's criterion is met", fontsize=11)
    handles, labels = by_detectors[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=11, frameon=False)
    title = f"What to build: {len(rows)} designs of array and lamp, scene {choice.scene.name}"
    figure.suptitle(f"{title}, whose array is {width_m:g} m wide\n{about}", fontsize=13)
    return figure


def _dots(axes: Any, x: Sequence[float], rows: Sequence[ScoredDesign], name: str) -> None:
    """Draw a bound of designs as dots, coloured by their shape, and what it compares with."""
    for shape, colour in style.SHAPE_COLOURS.items():
        points = [(at, getattr(r, name)) for at, r in zip(x, rows, strict=True) if r.shape == shape]
        axes.plot(*np.reshape(points, (-1, 2)).T, "o", color=colour, ms=3, alpha=0.5, label=shape)
    label, wanted, free = BOUNDS[name]
    paper = {"color": style.SPECIFIED, "label": "specification of the paper"}
    axes.axhline(wanted, ls="--", lw=1.4, zorder=1, **paper)
    axes.axhline(free, color="0.5", ls=":", lw=1.4, zorder=1, label="no measurement at all")
    axes.set(yscale="log", ylabel=label)
    style.plain_log_ticks(axes.yaxis)
    axes.grid(alpha=0.3, lw=0.5)


def _all_designs(axes: Any, choice: Choice, name: str) -> None:
    """Draw every design by its number of detectors, the fronts, and numbers of what fits."""
    rows, bound = choice.rows, operator.attrgetter(name)
    sides = sorted({row.detectors_per_side for row in rows})

    def place(row: ScoredDesign) -> float:
        return sides.index(row.detectors_per_side) + BESIDE[row.shape]

    _dots(axes, [place(row) for row in rows], rows, name)
    axes.set_xticks(range(len(sides)), [f"{n} x {n}" for n in sides])
    axes.set(xlim=(-0.5, len(sides) - 0.5), xlabel="detectors")
    for front_name, dashes, label in (
        ("fits", "-", "front 'fits': no wider than the scene's"),
        ("any", "--", "front 'any': of any width"),
    ):
        # Of each number of detectors the best; the last of a key stays.
        on_front = sorted(choice.fronts[front_name], key=bound, reverse=True)
        best = {row.detectors_per_side: row for row in on_front}
        line = [best[side] for side in sorted(best)]
        axes.plot([*map(place, line)], [*map(bound, line)], "ko", ls=dashes, lw=1.2, label=label)
    own, ring = choice.papers, {"marker": "o", "ms": 7, "mfc": "none", "mec": "k", "ls": ""}
    about = "the paper's array with the scene's lamp"
    axes.plot([*map(place, own)], [*map(bound, own)], label=about, **ring)
    named = [*choice.fronts["fits"], *own]
    points = {n: (place(r), bound(r)) for n, r in enumerate(choice.numbered, 1) if r in named}
    style.number_points(axes, points)
