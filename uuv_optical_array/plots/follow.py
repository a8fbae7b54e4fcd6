"""The picture of a run."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uuv_optical_array.control.follow_record import FollowRecord
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES
from uuv_optical_array.plots.style import save
from uuv_optical_array.studies.shared.working_volume import SPECIFICATION

LEADER, FOLLOWER = "#e08a00", "#1f6fb4"
MOMENTS = 6


def _paths(figure: Figure, record: FollowRecord, moments: list[float]) -> None:
    leader = np.array(list(record.leader_path.values()))
    follower = np.array(list(record.follower_path.values()))
    above, side = figure.subplots(1, 2)
    for axes, vertical, title in (
        (above, 1, "from above"),
        (side, 2, "from the side, not to scale"),
    ):
        for moment in moments:
            pair = np.array([record.follower_path[moment], record.leader_path[moment]])
            axes.plot(pair[:, 0], pair[:, vertical], color="0.75", lw=0.8, zorder=0)
        axes.plot(leader[:, 0], leader[:, vertical], color=LEADER, label="leader")
        axes.plot(follower[:, 0], follower[:, vertical], color=FOLLOWER, label="follower")
        axes.plot(*leader[-1, [0, vertical]], "o", color=LEADER)
        axes.plot(*follower[-1, [0, vertical]], "o", color=FOLLOWER)
        axes.set(title=title, xlabel="x (m)", ylabel="y, port (m)" if vertical == 1 else "z (m)")
        axes.grid(alpha=0.3)
    above.set_aspect("equal", adjustable="datalim")
    above.legend(loc="best")
    # Depth changes little; drawn to scale it would not be seen.
    low, high = side.get_ylim()
    side.set_ylim(min(low, -2.5), max(high, 2.5))


def _errors(figure: Figure, record: FollowRecord) -> None:
    stamps, errors = record.errors()
    errors = errors * IN_DEGREES
    at_station, station = record.station_errors()
    station = station * IN_DEGREES
    for i, axes in enumerate(figure.subplots(1, 5)):
        axes.axhspan(-SPECIFICATION[i], SPECIFICATION[i], color="#7fbf7f", alpha=0.25, lw=0)
        axes.plot(stamps, errors[:, i], ".", ms=2.5, color=FOLLOWER, label="estimate - truth")
        axes.plot(at_station, station[:, i], color="0.2", lw=1, label="true - station")
        title = f"{DOF_NAMES[i]} ({DOF_UNITS[i]}, band +-{SPECIFICATION[i]:g})"
        axes.set(title=title, xlabel="time (s)")
        limit = max(3 * SPECIFICATION[i], 1.1 * np.abs([*errors[:, i], *station[:, i]]).max())
        axes.set_ylim(-limit, limit)
        axes.grid(alpha=0.3)
        if i == 0:
            axes.legend(loc="upper right", fontsize=7, markerscale=3)


def _images(figure: Figure, record: FollowRecord, moments: list[float]) -> None:
    for moment, axes in zip(moments, figure.subplots(1, MOMENTS), strict=False):
        image = record.images[moment]
        x, y, z, pitch, yaw = record.truth[moment] * IN_DEGREES
        axes.imshow(image, cmap="magma", vmin=0)
        axes.set_title(f"{moment:.0f} s, peak {image.max():.0f}", fontsize=9)
        axes.set_xlabel(f"{x:.1f}, {y:+.2f}, {z:+.2f} m\n{pitch:+.0f}, {yaw:+.0f} deg", fontsize=8)
        axes.set(xticks=[], yticks=[])
    for axes in figure.axes[len(moments) :]:
        axes.set_visible(False)


def draw_follow(record: FollowRecord, path: Path) -> None:
    """Draw a run: both paths, the five errors over time, the array's image at a few moments.

    Parameters
    ----------
    record
        The run.
    path
        PNG file, written whole or not at all.

    Raises
    ------
    ValueError
        For a run without a single pose: there is nothing to draw.
    """
    both = [
        stamp for stamp in record.images if stamp in record.truth and stamp in record.follower_path
    ]
    if not both or not len(record.errors()[0]):
        raise ValueError("picture: no pose in this run, so nothing to draw")
    picks = np.unique(np.linspace(0, len(both) - 1, MOMENTS).round().astype(int))
    moments = [both[pick] for pick in picks]
    figure = Figure(figsize=(15, 11), layout="constrained")
    parts: Any = figure.subfigures(3, 1, height_ratios=[5, 3.2, 3])
    top, middle, bottom = parts
    _paths(top, record, moments)
    _errors(middle, record)
    _images(bottom, record, moments)
    figure.suptitle("A follower keeps station behind a leader by light alone", fontsize=14)
    bottom.suptitle("images of the array, and the true x, y, z, pitch and yaw", fontsize=10)
    save(figure, path)
