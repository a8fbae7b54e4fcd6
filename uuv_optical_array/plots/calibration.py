"""The picture of a calibration: its residuals."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.result import Calibration
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.plots.style import array_image, new_figure
from uuv_optical_array.recording.images import Recording

EDGE = 4.0  # standard deviations; residuals beyond are drawn there


def _mean(values: Array, where: NDArray[np.bool_], axis: int) -> Array:
    """Return means of what counts; nan where nothing does."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(where, values, 0).sum(axis) / where.sum(axis))


def draw_calibration(result: Calibration, recording: Recording, title: str) -> Any:
    """Draw residuals by detector, along the drive, by range, and off the beam's axis."""
    figure = new_figure(19, 5.6)
    by_detector, *along, off_axis = figure.subplots(1, 4)
    residuals, fitted = np.clip(result.residuals, -EDGE, EDGE), result.uncensored
    left_out = ~result.used & result.used.any(axis=0)
    shape = -1, *result.gains.shape  # with detectors that never read right
    squares = _mean(residuals.reshape(shape) ** 2, (fitted | ~result.used).reshape(shape), 0)
    mesh = array_image(by_detector, np.sqrt(squares), vmin=0, vmax=EDGE / 2)
    figure.colorbar(mesh, ax=by_detector, label="RMS residual; 1 where the model explains it")
    by_detector.set(xlabel="column, to starboard", ylabel="row, downwards")
    of_images = (
        ("RMS of an image", "o", "#1f6fb4", np.sqrt(_mean(residuals**2, fitted, 1))),
        ("its mean", "o", "#c8401e", _mean(residuals, fitted, 1)),
        ("RMS of what was left out", "x", "k", np.sqrt(_mean(residuals**2, left_out, 1))),
    )
    seconds = recording.seconds - recording.seconds.min()
    ranges = np.linalg.norm(recording.poses[:, :3], axis=1)
    places = (seconds, "time in the bag (s)"), (ranges, "range from lamp to base_link (m)")
    for axes, (across, label) in zip(along, places, strict=True):
        for name, marker, colour, values in of_images:
            axes.plot(across, values, marker, color=colour, ms=3.5, label=name)
        for level in (0, 1):
            axes.axhline(level, color="k", lw=0.8)
        axes.set(xlabel=label, ylim=(-2, EDGE + 0.2))
        axes.grid(alpha=0.3)
    along[0].set_ylabel("residual (std of a reading)")
    along[0].legend(loc="upper left", fontsize=9)
    angles, relative, std, share = result.by_angle
    off_axis.errorbar(angles, 100 * relative, 100 * std, fmt="o-", color="#1f6fb4", ms=3.5)
    off_axis.axhline(0, color="k", lw=0.8)
    off_axis.grid(alpha=0.3)
    off_axis.set(
        xlabel="off the beam's axis (deg)",
        ylabel="mean residual (% of the light)",
        title=f"by this angle alone: {share:.0%} of the misfit",
    )
    figure.suptitle(title)
    return figure
