"""The picture of a run."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from uuv_optical_array.control.follow_record import FollowRecord, position_at
from uuv_optical_array.control.follow_states import COLOURS
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES
from uuv_optical_array.forward.working_volume import SPECIFICATION
from uuv_optical_array.plots.style import SPECIFIED, array_image, new_figure, signed

LEADER = "#e08a00"
FOLLOWERS = ("#1f6fb4", "#2f9e61", "#b03a8c", "#7a5230", "#5b6bd6")
MOMENTS = 6
BAND = 0.04  # height of a follower's band of states, as a share of its panel


def _draw_paths(figure: Any, records: Sequence[FollowRecord], moments: list[float]) -> None:
    paths = [records[0].leader_path, *(record.follower_path for record in records)]
    stamps = np.array([t for t in moments if all(min(p) <= t <= max(p) for p in paths)])
    above, side = figure.subplots(1, 2)
    for axes, vertical, title, label in (
        (above, 1, "from above", "y, port (m)"),
        (side, 2, "from the side, z stretched", "z, up (m)"),
    ):
        axes.plot([], [], color="0.6", lw=0.8, label="positions when the images are taken")
        leader_places = position_at(paths[0], stamps)
        for number, path in enumerate(paths):
            line = np.array(list(path.values()))
            name, colour = "leader", LEADER
            if number:
                name = f"follower {number}" if len(records) > 1 else "follower"
                colour = FOLLOWERS[(number - 1) % len(FOLLOWERS)]
            axes.plot(line[:, 0], line[:, vertical], color=colour, label=name)
            axes.plot(*line[-1, [0, vertical]], "o", color=colour)
            for pair in np.stack([position_at(path, stamps), leader_places], axis=1):
                axes.plot(pair[:, 0], pair[:, vertical], color="0.6", lw=0.8, zorder=0)
        axes.set(title=title, xlabel="x (m)", ylabel=label)
        axes.grid(alpha=0.3)
    above.set_aspect("equal", adjustable="datalim")
    above.legend(loc="best")
    # Depth changes little; drawn to scale it would not be seen.
    low, high = side.get_ylim()
    side.set_ylim(min(low, -2.5), max(high, 2.5))


def _draw_errors(figure: Any, records: Sequence[FollowRecord]) -> None:
    for i, axes in enumerate(figure.subplots(1, 5)):
        wanted, within = SPECIFICATION[i], "within the specification of Eren et al. (2016)"
        axes.axhspan(-wanted, wanted, color=SPECIFIED, alpha=0.2, lw=0, label=within)
        limit = 3 * wanted
        for number, record in enumerate(records):
            stamps, errors = record.errors()
            at_station, off_station = record.station_errors()
            error, station = errors[:, i] * IN_DEGREES[i], off_station[:, i] * IN_DEGREES[i]
            colour = FOLLOWERS[number % len(FOLLOWERS)]
            axes.plot(stamps, error, ".", ms=2.5, color=colour, label="estimate less truth")
            line = "0.2" if len(records) == 1 else colour
            axes.plot(at_station, station, color=line, lw=1, label="truth less station")
            limit = max(limit, 1.1 * np.abs([*error, *station]).max())
        name, unit = DOF_NAMES[i], DOF_UNITS[i]
        axes.set_title(f"{name}, specified ±{wanted:g} {unit}", fontsize=10)
        axes.set(xlabel="time (s)", ylabel=f"error of {name} ({unit})", ylim=(-limit, limit))
        axes.grid(alpha=0.3)
        _draw_states(axes, records)
        handles, labels = axes.get_legend_handles_labels()
    named: dict[str, Any] = {}
    for label, handle in zip(labels, handles, strict=True):
        named.setdefault(label, handle)  # of the first follower
    place: Any = {"loc": "outside lower center", "ncols": len(named), "frameon": False}
    figure.legend(named.values(), named.keys(), fontsize=9, markerscale=3, **place)


def _draw_states(axes: Any, records: Sequence[FollowRecord]) -> None:
    """Draw what each follower did as a band at the bottom of a panel, the first one lowest."""
    for number, record in enumerate(records):
        for name, begin_s, end_s in record.spells():
            place = {"ymin": BAND * number, "ymax": BAND * (number + 1)}
            axes.axvspan(begin_s, end_s, **place, color=COLOURS[name], lw=0, label=name)


def _draw_images(figure: Any, record: FollowRecord, moments: list[float]) -> None:
    grid = figure.subplots(1, MOMENTS)
    brightest = max(float(record.images[moment].max()) for moment in moments)
    for moment, axes in zip(moments, grid, strict=False):
        image = record.images[moment]
        x, y, z, pitch, yaw = record.truth[moment] * IN_DEGREES
        mesh = array_image(axes, image, vmin=0, vmax=brightest)
        place = f"x {signed(x, 1)}, y {signed(y, 2)}, z {signed(z, 2)} m"
        turned = f"pitch {signed(pitch, 0)}, yaw {signed(yaw, 0)} deg"
        axes.set_title(f"{moment:.0f} s: {place}\n{turned}", fontsize=8.5)
        axes.set_xlabel("column, to starboard", fontsize=9)
    grid[0].set_ylabel("row, downwards", fontsize=9)
    figure.colorbar(mesh, ax=grid, label="reading (counts)", aspect=15)
    for axes in grid[len(moments) :]:
        axes.set_visible(False)


def draw_follow(records: Sequence[FollowRecord]) -> Any:
    """Draw a run: the paths, the five errors over time, the first array's image at some moments.

    ValueError for a follower without a pose: there is nothing to draw.
    """
    first = records[0]
    stamps = [stamp for stamp in first.images if stamp in first.truth]
    if not stamps or not all(len(record.errors()[0]) for record in records):
        raise ValueError("picture: no pose in this run, so nothing to draw")
    picks = np.unique(np.linspace(0, len(stamps) - 1, MOMENTS).round().astype(int))
    moments = [stamps[pick] for pick in picks]
    figure = new_figure(15, 11)
    parts: Any = figure.subfigures(3, 1, height_ratios=[5, 3.4, 3.2])
    _draw_paths(parts[0], records, moments)
    _draw_errors(parts[1], records)
    _draw_images(parts[2], first, moments)
    several = len(records) > 1
    subject = "Followers keep station" if several else "A follower keeps station"
    figure.suptitle(f"{subject} behind a leader by light alone", fontsize=14)
    owner = " of the first follower" if several else ""
    parts[2].suptitle(f"images of the array{owner} at its true poses", fontsize=10)
    return figure
