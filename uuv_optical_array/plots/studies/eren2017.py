"""The picture of approaches: 95 % errors against range, published and ours."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uuv_optical_array.core.geometry import IN_DEGREES, Array
from uuv_optical_array.plots.style import METHOD_COLOURS, save
from uuv_optical_array.studies.eren2017.approach import CASES, RANGES_M, Case
from uuv_optical_array.studies.eren2017.monte_carlo import METHODS, SIGMA_95, ApproachErrors

PUBLISHED = "#e08a00"
ROWS = {
    "x, along the beam (m)": [0],
    "worse of y, z (m)": [1, 2],
    "worse of pitch, yaw (deg)": [3, 4],
}


def _panel(axes: Axes, case: Case, found: ApproachErrors, dofs: list[int]) -> None:
    def worst(values: Array) -> Array:
        return np.asarray((values * IN_DEGREES)[..., dofs].max(axis=-1))

    for method in METHODS:
        errors = worst(found.percentile_95(method))
        axes.plot(RANGES_M, errors, color=METHOD_COLOURS[method], lw=2, label=method)
    axes.plot(RANGES_M, SIGMA_95 * worst(found.bound), "k--", lw=1.2, label="bound of one image")
    axes.plot(
        RANGES_M, SIGMA_95 * worst(found.run_bound), "k:", lw=1.5, label="bound of all so far"
    )
    for metres, told in (
        (RANGES_M[0], case.published.start_95),
        (RANGES_M[-1], case.published.end_95),
    ):
        # fmax passes over what the paper does not give.
        value = float(np.fmax.reduce(np.array(told)[dofs]))
        axes.plot(metres, value, "D", color=PUBLISHED, ms=9, mec="k", clip_on=False, zorder=5)
    aim = float(np.max(np.array(case.published.aim)[dofs]))
    axes.plot(RANGES_M[-1], aim, "D", mfc="w", mec=PUBLISHED, mew=2, ms=8, clip_on=False, zorder=6)
    axes.plot([], [], "D", color=PUBLISHED, ms=9, mec="k", label="published")
    axes.plot([], [], "D", mfc="w", mec=PUBLISHED, mew=2, ms=8, label="the aim")
    axes.set(yscale="log", xlim=(RANGES_M[0], RANGES_M[-1]))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.grid(alpha=0.4, which="both", lw=0.4)


def draw_approach(results: dict[str, ApproachErrors], about: str, path: Path) -> None:
    """Draw 95 % errors against range, a column a case.

    Parameters
    ----------
    results
        Of at least one case, by its name.
    about
        For the title.
    path
        Picture, written whole or not at all.
    """
    figure = Figure(figsize=(max(9.2, 4.6 * len(results)), 10.5), layout="constrained")
    grid = figure.subplots(3, len(results), sharex=True, sharey="row", squeeze=False)
    for column, (name, found) in enumerate(results.items()):
        for axes, (title, dofs) in zip(grid[:, column], ROWS.items(), strict=True):
            _panel(axes, CASES[name], found, dofs)
            if column == 0:
                axes.set_ylabel(title, fontsize=12)
        grid[0, column].set_title(f"{name}, K {CASES[name].k_per_m:g} /m", fontsize=12)
        grid[-1, column].set_xlabel("behind the lamp (m)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=11)
    figure.suptitle(f"95 % of errors during an approach; {about}", fontsize=14)
    save(figure, path)
