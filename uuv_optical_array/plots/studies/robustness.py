"""The picture of a robustness study: a row a kind of mismatch."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uuv_optical_array.plots.style import mark, plain_log_ticks, save
from uuv_optical_array.studies.robustness.study import FAR_M

ANSWERED, FALSE, EXCUSED = "#1f6fb4", "#c8401e", "#e0a080"
# Key of a row, marker, colour and label of the errors.
ERRORS = (
    ("rms_range_m", "o", "#1f6fb4", "range (m)"),
    ("rms_across_m", "s", "#2c9c5a", "across (m)"),
    ("rms_angle_deg", "^", "#e08a00", "angle (deg)"),
)
ROW_INCHES = 0.27
SHADED = "0.94"  # behind what is within the prior


def _percent(left: Axes, right: Axes, y: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Draw the shares answered and false, as bars and in figures."""
    answered = np.array([row["answered"] / row["frames"] for row in rows])
    false, excused = (
        np.array([row[key] / row["answered"] if row["answered"] else np.nan for row in rows])
        for key in ("beyond_6_sigma", "indistinguishable")
    )
    left.barh(y, 100 * answered, color=ANSWERED)
    right.barh(y, 100 * false, color=FALSE)
    right.barh(y, 100 * excused, color=EXCUSED)
    for panel, shares in ((left, answered), (right, false)):
        for at, share in zip(y, 100 * shares, strict=True):
            text = f"{share:.0f}" if share in (0, 100) else f"{share:.1f}"
            panel.text(103, at, "-" if np.isnan(share) else text, va="center", fontsize=9)
        panel.set(xlim=(0, 122), xticks=[0, 25, 50, 75, 100])
    left.set_xlabel("answered, of all (%)")
    right.set_xlabel("beyond 6 sigma, of answered (%)")


def draw_robustness(rows: Sequence[dict[str, Any]], about: str, path: Path) -> None:
    """Draw shares answered and false, and errors, a row a kind.

    Parameters
    ----------
    rows
        As `KindResult.as_object` returns them, at least one.
    about
        For the title.
    path
        Picture, written whole or not at all.
    """
    figure = Figure(figsize=(14, 2.4 + ROW_INCHES * max(len(rows), 12)), layout="constrained")
    grid = figure.subplots(1, 3, sharey=True, width_ratios=(1, 1, 1.5))
    y = np.arange(len(rows))
    _percent(grid[0], grid[1], y, rows)
    for key, marker, colour, _ in ERRORS:
        errors = [np.nan if row[key] is None else row[key] for row in rows]
        grid[2].plot(errors, y, marker, color=colour, ms=6, alpha=0.85)
    grid[2].axvline(FAR_M, color="k", lw=0.8, ls=":")
    grid[2].set(xscale="log", xlabel="RMS error of the answered, m or deg")
    plain_log_ticks(grid[2].xaxis)
    for axes in grid:
        for at, row in zip(y, rows, strict=True):
            if row["within_twice_prior"]:
                axes.axhspan(at - 0.5, at + 0.5, color=SHADED, lw=0, zorder=0)
        axes.grid(axis="x", alpha=0.4)
        axes.set_axisbelow(True)
        axes.tick_params(axis="y", length=0)
    grid[0].set_yticks(y, [row["kind"] for row in rows], fontsize=10)
    grid[0].set_ylim(len(rows) - 0.5, -0.5)
    handles = [
        mark("answered", "s", color=ANSWERED, ms=9),
        mark("beyond 6 of its own sigma", "s", color=FALSE, ms=9),
        mark("the same, of an image as honest ones are", "s", color=EXCUSED, ms=9),
        *(mark(label, marker, color=colour) for _, marker, colour, label in ERRORS),
        mark("within twice the prior", "s", color="0.85", ms=9),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=10)
    figure.suptitle(f"Where the sea is not the scene: {about}", fontsize=13)
    save(figure, path)
