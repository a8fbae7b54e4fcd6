"""The picture of the paper's figures: our curves, and what the paper's text states of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.plots.style import SHAPE_COLOURS, save
from uuv_optical_array.studies.eren2016.figures import FAR, STATEMENTS, STEPS
from uuv_optical_array.studies.separation import THRESHOLD_DEG, UNITS, Conditions, Motion

# Where a panel has room for what the text states, in fractions of it.
FREE = {
    ("5a", "above"): (0.02, 0.52),
    ("5a", "below"): (0.6, 0.1),
    ("5b", "above"): (0.02, 0.72),
    ("5b", "below"): (0.6, 0.08),
    ("6b", "above"): (0.6, 0.08),
    ("6e", "above"): (0.6, 0.08),
}
AXES: dict[Motion, str] = {"shift": "shift to starboard (m)", "yaw": "yaw (deg)"}


def draw_paper(
    curves: Sequence[tuple[str, Conditions, Array]], scene_name: str, path: Path
) -> None:
    """Draw the three figures, panel by panel as in the paper, with what its text states.

    Parameters
    ----------
    curves
        Panel, conditions and angles in deg at `STEPS`.
    scene_name
        For the title.
    path
        Picture, written whole or not at all.
    """
    figure = Figure(figsize=(10.5, 12.8), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=[1, 0.95])
    fourth, fifth = upper.subfigures(1, 2)
    by_panel: dict[str, Axes] = {}
    for part, letters, number in ((fourth, "ab", "4"), (fifth, "ab", "5"), (lower, "abcdef", "6")):
        grid = part.subplots(2, len(letters) // 2, sharey="row", squeeze=False)
        by_panel |= {f"{number}{x}": a for x, a in zip(letters, grid.flat, strict=True)}
        for axes in grid[:, 0]:
            axes.set_ylabel("spectral angle (deg)")
    fourth.suptitle("Fig. 4: planar and curved, 21 x 21, 4 m")
    fifth.suptitle("Fig. 5: curved arrays by detectors in a row, 4 m")
    lower.suptitle("Fig. 6: curved arrays by range, coloured as in (a)")
    for panel, axes in by_panel.items():
        own = [(conditions, angles) for name, conditions, angles in curves if name == panel]
        motion = own[0][0].motion
        for (_, angles), (name, colour) in zip(own, _styles(panel, own), strict=True):
            axes.plot(STEPS[motion], angles, color=colour, lw=1.8, label=name)
        _stated(axes, panel, motion)
        side = own[0][0].side
        title = f"({panel[1]})" + (f" {side} x {side}" if panel[0] == "6" else "")
        axes.set_title(title, loc="left", fontsize=11)
        axes.set(xlabel=AXES[motion], xlim=(0, STEPS[motion][-1]))
        axes.set_ylim(0, 80 if motion == "shift" else 60)
        axes.grid(alpha=0.3)
    for panel in ("4a", "4b", "5a", "6a"):
        by_panel[panel].legend(loc="upper left", fontsize=9, ncols=2 if panel == "5a" else 1)
    figure.suptitle(
        f"Eren et al. (2016), Figs 4 to 6: our curves (scene {scene_name}); in black, what the "
        "text states",
        fontsize=13,
    )
    save(figure, path)


def _styles(panel: str, own: Sequence[tuple[Conditions, Array]]) -> list[tuple[str, Any]]:
    """Return label and colour of each curve of a panel."""
    if panel[0] == "4":
        return [(conditions.shape, SHAPE_COLOURS[conditions.shape]) for conditions, _ in own]
    colours = colormaps["turbo" if panel[0] == "5" else "plasma"](np.linspace(0.05, 0.9, len(own)))
    return [
        (f"{c.side} x {c.side}" if panel[0] == "5" else f"{c.range_m:g} m", colour)
        for (c, _), colour in zip(own, colours, strict=True)
    ]


def _stated(axes: Axes, panel: str, motion: Motion) -> None:
    """Mark what the paper's text states of a panel."""
    if panel == "4a":
        axes.axvspan(FAR[0], FAR[-1], color="0.9", zorder=0)
        axes.text(0.765, 4, "stated: curved\n2 deg better", ha="center", fontsize=10)
    if panel[0] == "5":
        axes.axhline(THRESHOLD_DEG, color="k", lw=1, ls="--")
    for statement in STATEMENTS:
        if statement.figure != panel or statement.paper is None or panel == "4a":
            continue
        step, angle = statement.conditions[f"{motion}_{UNITS[motion]}"], statement.paper
        if statement.relation == "is":
            axes.plot(step, angle, "o", color="k", ms=6, zorder=4)
            # The curved array's angles are above the planar one's here.
            above = statement.conditions["array"] == "curved"
            axes.annotate(
                f"{angle:g}",
                (step, angle),
                (-9, 7) if above else (9, -9),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize=9,
            )
            continue
        up = statement.relation == "above"
        # A bar with an arrowhead to the side on which the curve should be.
        axes.plot(step, angle, "k_", ms=12, mew=2, zorder=4)
        axes.plot(step, angle + (3 if up else -3), "^" if up else "v", color="k", ms=5, zorder=4)
        side, range_m = (statement.conditions[key] for key in ("detectors_per_side", "range_m"))
        which = f"{side} x {side}" if panel[0] == "5" else f"{range_m:g} m"
        axes.annotate(
            f"{which}: {statement.label}",
            (step, angle),
            FREE[panel, statement.relation],
            textcoords="axes fraction",
            va="center",
            fontsize=9,
            zorder=5,
            arrowprops={"arrowstyle": "-", "lw": 0.7, "color": "0.3", "shrinkB": 4},
        )
