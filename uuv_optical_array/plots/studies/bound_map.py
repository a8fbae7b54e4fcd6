"""The picture of the Cramer-Rao bound over the working volume."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.text import Text

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.working_volume import SPECIFICATION
from uuv_optical_array.plots.style import SHAPE_COLOURS, drop_overlapping, save
from uuv_optical_array.studies.limits.bound_map import BoundMap

# What a row of the picture shows: the worst of these degrees of freedom.
ROWS = {"x, along the beam (m)": [0], "y and z, across (m)": [1, 2], "pitch and yaw (deg)": [3, 4]}
CROWDED_M, LABELLED_M = 0.15, 0.6  # off the beam's axis: least, and wanted
EDGE = 0.06  # of the map's width, free of labels
LEVELS = np.outer(10.0 ** np.arange(-3, 4), [1, 3]).ravel()


def _curves(axes: Axes, behind_m: Array, bounds: dict[Shape, Array], wanted: float) -> None:
    low, high = wanted / 1000, wanted * 100
    for shape, bound in bounds.items():
        shown = np.minimum(bound, 10 * high)  # what is unobservable runs out of the picture
        colour, middle = SHAPE_COLOURS[shape], shown[:, shown.shape[1] // 2]
        axes.fill_between(
            behind_m, shown.min(axis=1), shown.max(axis=1), color=colour, alpha=0.25, lw=0
        )
        axes.plot(behind_m, middle, color=colour, lw=2, label=shape)
    axes.axhline(wanted, color="k", lw=1.5, ls="--", label=f"specification, {wanted:g}")
    axes.set(yscale="log", xlim=(behind_m[0], behind_m[-1]), ylim=(low, high))
    axes.grid(alpha=0.4)


def _map(
    axes: Axes, found: BoundMap, bound: Array, wanted: float, norm: LogNorm
) -> tuple[Any, list[Text]]:
    """Draw the bound from above; return the mesh, and the labels of its contours."""
    # Where nothing is observable the hatched ground shows.
    axes.patch.set(facecolor="0.85", hatch="xx", edgecolor="0.6")
    known = np.where(np.isfinite(bound), bound, np.nan).T
    x, y = found.behind_m, found.aside_m
    mesh = axes.pcolormesh(
        x, y, known / wanted, norm=norm, cmap="RdYlBu_r", shading="nearest", rasterized=True
    )
    labels: list[Text] = []
    round_levels = [level for level in LEVELS if 0.01 < level / wanted < 100 and level != wanted]
    low = known.min(initial=np.inf, where=np.isfinite(known))
    high = known.max(initial=-np.inf, where=np.isfinite(known))
    for levels, width, style in (([wanted], 2.0, "--"), (round_levels, 0.6, "-")):
        # Matplotlib before 3.8 draws a line of its own where no level is inside.
        if inside := [level for level in levels if low < level < high]:
            lines = axes.contour(
                x, y, known, inside, colors="k", linewidths=width, linestyles=style
            )
            places = _label_places(lines.allsegs, x)
            labels += axes.clabel(lines, fmt="%g", fontsize=9, inline=False, manual=places)
    for label in labels:
        label.set_bbox({"boxstyle": "round,pad=0.1", "fc": "w", "ec": "none", "alpha": 0.75})
    return mesh, labels


def _label_places(
    contours: Sequence[Sequence[Array]], behind_m: Array
) -> list[tuple[float, float]]:
    """Return where contours are labelled: off the edges and the beam's axis, where they may meet.

    Parameters
    ----------
    contours
        Pieces of each contour, shape ``(k, 2)``, m.
    behind_m
        Of the map, ascending.
    """
    room = EDGE * (behind_m[-1] - behind_m[0])
    places = []
    for piece in (piece for pieces in contours for piece in pieces):
        piece = piece[(piece[:, 0] > behind_m[0] + room) & (piece[:, 0] < behind_m[-1] - room)]
        for port in (True, False):
            off = piece[(piece[:, 1] > CROWDED_M) if port else (piece[:, 1] < -CROWDED_M)]
            if len(off):
                x, y = off[np.abs(np.abs(off[:, 1]) - LABELLED_M).argmin()].tolist()
                places.append((x, y))
    return places


def draw_bound_map(found: BoundMap, scene_name: str, path: Path) -> None:
    """Draw the bound over the working volume, for each shape of the array.

    Parameters
    ----------
    found
        The bounds.
    scene_name
        For the title.
    path
        Picture, written whole or not at all.
    """
    figure = Figure(figsize=(14, 10.5), layout="constrained")
    grid = figure.subplots(3, 3, sharex=True)
    norm = LogNorm(1e-2, 1e2)
    labels: list[Text] = []
    for (title, dofs), row in zip(ROWS.items(), grid, strict=True):
        wanted = float(SPECIFICATION[dofs[0]])
        worst = {shape: std[..., dofs].max(axis=-1) for shape, std in found.std.items()}
        _curves(row[0], found.behind_m, worst, wanted)
        row[0].set_ylabel(title, fontsize=12)
        for axes, shape in zip(row[1:], found.std, strict=True):
            mesh, written = _map(axes, found, worst[shape], wanted, norm)
            labels += written
            axes.set(ylabel="y, port (m)", yticks=[-1, -0.5, 0, 0.5, 1])
    grid[0, 0].set_title("line: on the beam's axis; band: up to 1 m aside")
    grid[0, 0].legend(loc="upper left")
    for axes, shape in zip(grid[0, 1:], found.std, strict=True):
        axes.set_title(f"{shape} array, from above", color=SHAPE_COLOURS[shape])
    for axes in grid[-1]:
        axes.set_xlabel("base_link behind the lamp (m)")
    bar = figure.colorbar(mesh, ax=grid[:, 1:], extend="both", aspect=40)
    bar.set_label("bound / specification")
    bar.ax.axhline(1.0, color="k", lw=2, ls="--")
    figure.suptitle(
        f"Least standard deviation from one image (the Cramer-Rao bound), scene {scene_name}",
        fontsize=14,
    )
    drop_overlapping(figure, labels)
    save(figure, path)
