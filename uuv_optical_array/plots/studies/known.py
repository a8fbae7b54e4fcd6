"""The picture of what it costs to know less of the sea: errors beside the bound."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uuv_optical_array.core.geometry import DOF_NAMES
from uuv_optical_array.plots.style import mark, save

COLOURS = {"exactly": "#1f6fb4", "calibrated": "#2c9c5a", "as_bought": "#e08a00"}
BAR = 0.26
# Panels: the degrees of freedom and their unit.
PANELS = ((slice(0, 3), "m"), (slice(3, 5), "deg"))


def draw_known(rows: Sequence[dict[str, Any]], about: str, path: Path) -> None:
    """Draw RMS errors as bars and the bound of each as a line across its bar.

    Parameters
    ----------
    rows
        With ``known``, and the values of `studies.accuracy.as_object`, at least one.
    about
        For the title.
    path
        Picture, written whole or not at all.
    """
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    grid = figure.subplots(1, 2, width_ratios=(3, 2))
    for axes, (dofs, unit) in zip(grid, PANELS, strict=True):
        names = DOF_NAMES[dofs]
        for i, row in enumerate(rows):
            at = np.arange(len(names)) + (i - (len(rows) - 1) / 2) * BAR
            errors, bounds = (list(row[key].values())[dofs] for key in ("rms_error", "rms_bound"))
            axes.bar(at, errors, 0.9 * BAR, color=COLOURS[row["known"]])
            axes.hlines(bounds, at - 0.5 * BAR, at + 0.5 * BAR, color="k", lw=1.6)
            for x, error in zip(at, errors, strict=True):
                axes.annotate(
                    f"{error:.2g}", (x, error), (0, 3), textcoords="offset points", ha="center"
                )
        axes.set_xticks(range(len(names)), names)
        axes.set_ylabel(f"RMS error ({unit})")
        axes.margins(y=0.12)
        axes.spines[["top", "right"]].set_visible(False)
    handles = [mark(row["known"], "s", color=COLOURS[row["known"]], ms=9) for row in rows]
    handles.append(mark("Cramer-Rao bound", "_", color="k", ms=12))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    figure.suptitle(f"Errors by how well the sea is known: {about}")
    save(figure, path)
