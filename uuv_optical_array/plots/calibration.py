"""The picture of a calibration: residuals and gains."""

from typing import Any

import numpy as np
from scipy.stats import norm

from uuv_optical_array.calibration.calibrate import Calibration
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.light import HALF_SQUARE, RANGE
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.plots.style import array_image, new_figure, signed
from uuv_optical_array.recording.images import Recording

DOTS = 1500  # readings that are drawn; the means are those of all
BINS = 20
LEAST = 10  # readings in a bin that is drawn
EDGE = 4.0  # standard deviations; outliers beyond are drawn at the edge
DOT, BIN, OUT = "#7f9fbf", "#c8401e", "#111111"


def _draw_residuals(
    axes: Any, across: Array, result: Calibration, label: str, log: bool = False
) -> None:
    """Draw residuals against another quantity, and the mean of each bin with its standard error."""
    uncensored, residuals = result.uncensored, result.residuals
    x, y = across[uncensored], residuals[uncensored]
    order = np.argsort(x)
    some = order[:: max(1, len(x) // DOTS)]  # spread along the axis as all of them are
    axes.plot(x[some], y[some], ".", ms=2, color=DOT, alpha=0.5, zorder=1, rasterized=True)
    out = ~result.used & np.resize(np.isfinite(result.gain_std), result.used.shape[1])
    if out.any():
        edge = np.clip(residuals[out], -EDGE, EDGE)
        axes.plot(across[out], edge, "x", ms=5, color=OUT, label="left out", zorder=3)
    if log:
        axes.set_xscale("log")
    if len(x):
        # Each bin has as many readings, so that the means have the same standard error.
        parts = [part for part in np.array_split(order, BINS) if len(part) >= LEAST]
        middle = [np.median(x[part]) for part in parts]
        mean = [y[part].mean() for part in parts]
        error = [2 * y[part].std() / np.sqrt(len(part)) for part in parts]
        axes.errorbar(
            middle, mean, error, fmt="o-", color=BIN, ms=3.5, lw=1, capsize=2, zorder=4,
            label="mean of a bin\n± 2 std errors",
        )  # fmt: skip
        if log:
            drawn = across[uncensored | out]
            axes.set_xlim(drawn.min() / 1.1, drawn.max() * 1.1)
    axes.axhline(0, color="k", lw=0.8)
    axes.set(xlabel=label, ylabel="residual (std of a reading)", ylim=(-EDGE - 0.3, EDGE + 0.3))
    axes.grid(alpha=0.3)


def _draw_histogram(axes: Any, result: Calibration) -> None:
    """Draw the distribution of the residuals beside the normal one."""
    residuals = result.residuals[result.uncensored]
    edges = np.linspace(-EDGE, EDGE, 61).tolist()
    axes.hist(np.clip(residuals, -EDGE, EDGE), edges, density=True, color=DOT, label="residuals")
    x = np.linspace(-EDGE, EDGE, 241)
    axes.plot(x, norm.pdf(x), color=BIN, lw=1.5, label="standard normal")
    axes.set(
        xlabel="residual (std of a reading)",
        ylabel="density",
        title=f"mean square {result.misfit:.2f}; 1 where the model explains the data",
        xlim=(-EDGE, EDGE),
    )
    axes.legend(fontsize=8, loc="upper right")
    axes.grid(alpha=0.3)


def _draw_gains(figure: Any, axes: Any, result: Calibration) -> None:
    """Draw the gains, in per cent of the mean, with their standard errors."""
    off = 100 * (result.gains - 1)
    known = np.isfinite(result.gain_std)
    limit = max(1.0, float(np.abs(off[known]).max(initial=0)))  # 0.0 % is pale
    shown = np.where(known, off, np.nan)
    axes.patch.set(facecolor="0.85", hatch="xx", edgecolor="0.6")
    mesh = array_image(axes, shown, cmap="RdBu_r", vmin=-limit, vmax=limit)
    side = len(off)
    if side <= 9:
        for (row, column), value in np.ndenumerate(shown):
            colour = "white" if abs(value) > 0.6 * limit else "black"
            if np.isfinite(value):
                text = f"{signed(value, 1)}\n±{100 * result.gain_std[row, column]:.2f}"
                axes.text(column, row, text, ha="center", va="center", fontsize=8, color=colour)
    figure.colorbar(mesh, ax=axes, label="gain (% off the mean), ± std error")
    note = "" if known.any() else ": as they were"
    axes.set(xlabel="column, to starboard", ylabel="row, downwards", title=f"gains{note}")


def draw_calibration(result: Calibration, recording: Recording, title: str) -> Any:
    """Draw residuals against counts, range, angle and time, their distribution, and the gains."""
    rays = ForwardModel(result.scene).rays(recording.poses, recording.rolls)
    since_start = recording.seconds - recording.seconds.min()
    times = np.broadcast_to(since_start[:, None], result.mean.shape)
    off_axis = np.degrees(np.sqrt(2 * rays[HALF_SQUARE]))
    figure = new_figure(16, 9)
    grid = figure.subplots(2, 3)
    counts = np.maximum(result.mean, 0.1)
    _draw_residuals(grid[0, 0], counts, result, "expected reading (counts)", log=True)
    _draw_residuals(grid[0, 1], rays[RANGE], result, "range from lamp to detector (m)")
    _draw_residuals(grid[0, 2], off_axis, result, "angle off the beam's axis (deg)")
    _draw_residuals(grid[1, 0], times, result, "time in the bag (s)")
    _draw_histogram(grid[1, 1], result)
    _draw_gains(figure, grid[1, 2], result)
    grid[0, 0].legend(fontsize=8, loc="upper left")
    figure.suptitle(title, fontsize=13)
    return figure
