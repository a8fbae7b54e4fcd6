"""What the estimator node's diagnostics show of an estimate and of what its track knows."""

import math

import numpy as np

from uuv_optical_array.core.geometry import DOF_NAMES, Array
from uuv_optical_array.estimation.estimator import Estimate
from uuv_optical_array.estimation.tracking.scene_changes import scene_changes
from uuv_optical_array.estimation.tracking.track import RangeUse, Track
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.forward.model import ForwardModel


def figures(estimate: Estimate) -> dict[str, str]:
    """Return what is shown of an estimate, by key."""
    shown = {
        "angle_rad": f"{estimate.angle_rad:.4f}",
        "runner_up_angle_rad": f"{estimate.runner_up_angle_rad:.4f}",
    }
    if estimate.unobservable:
        shown["unobservable"] = ", ".join(estimate.unobservable)
    for name in ("misfit", "runner_up_misfit"):
        if not math.isnan(value := getattr(estimate, name)):
            shown[name] = f"{value:.3g}"
    for name, variance in zip(DOF_NAMES, estimate.covariance.diagonal(), strict=True):
        shown[f"std_{name}"] = f"{math.sqrt(variance):.3f}"
    return shown


def figures_of_track(model: ForwardModel, constants: Constants, track: Track) -> dict[str, str]:
    """Return what is shown of a track, by key: own motion, range, and what it has learnt."""
    shown: dict[str, str] = {"own_motion": track.own_motion}
    if track.range is not None:
        shown["range"] = words_of(track.range)
    for name, known in track.constants.items():
        shown[f"learnt_{name}"] = f"{known.mean:+.3g} +- {known.std:.2g}"
    for change in scene_changes(model, constants, track.constants):
        shown[f"scene_{change.key}"] = change.text
    return shown


def table_margin(extent: Array, pose: Array) -> str:
    """Say how far inside of a table a pose is: 1 in its middle, 0 at its edge, < 0 beyond.

    - extent: first and last values of the table's axes, shape ``(2, 5)``.
    """
    low, high = extent
    span = np.where(high > low, high - low, np.inf)  # an axis of one value has no edge
    inside = 1 - np.abs(2 * pose - low - high) / span
    return f"{inside.min():.2f} ({DOF_NAMES[inside.argmin()]})"


def words_of(use: RangeUse) -> str:
    """Say what the track made of a range."""
    made = f"refused, {use.refused} in a row" if use.refused else "used"
    stds = abs(use.off_m) / use.std_m
    return f"{use.off_m:+.2f} m off the track, {stds:.1f} standard deviations; {made}"
