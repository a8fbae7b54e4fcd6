"""Draw a film of a follower in trouble: ``python docs/film.py dark_20_path 1 follow.gif``.

The trouble is a kind of ``uuv_array study envelope``, with the seed of its noise. The film shows
the closed loop from above, and what the array reads.
"""

import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from PIL import Image

from uuv_optical_array import Estimator, load_scene
from uuv_optical_array.control.follow_states import COLOURS
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.plots.style import IMAGES, new_figure
from uuv_optical_array.studies.closed_loops.kinds import kinds_named
from uuv_optical_array.studies.closed_loops.runs import STEP_S, Kind, loop_of

BEFORE_S, AFTER_S = 5.0, 12.0  # shown before the trouble and after it
STEPS = 4  # of the loop, a frame
FRAMES_PER_S = 12
HALF = 13.0, 6.5  # of what is seen, m
BEAM_M, HULL = 9.0, np.array([[0.7, 0.0], [-0.4, 0.3], [-0.4, -0.3]])
DARK, PALE, LIT = "#0d1b2a", "#c9d6e3", "#ffe9a0"


class Moment(NamedTuple):
    """What a frame shows: places in the world, m, and where bow and lamp look, rad."""

    t_s: float
    leader: Array
    leader_yaw: float
    follower: Array
    follower_yaw: float
    station: Array
    image: Array
    state: str
    dark: bool


def moments(kind: Kind, seed: int) -> Iterator[Moment]:
    """Run the loop, and yield a moment for each frame."""
    scene = load_scene(kind.scene)
    rng = np.random.default_rng(seed)
    loop = loop_of(kind, seed, "kinematic", Estimator(scene).wait(), rng)
    (swimmer,) = loop.followers
    for step in range(round((kind.until_s + AFTER_S) / STEP_S)):
        (seen,) = loop.step(STEP_S)
        if seen.t_s < kind.since_s - BEFORE_S or step % STEPS:
            continue
        leader, follower = loop.leader, swimmer.vehicle
        station = leader.position + leader.rotation @ np.array(kind.fleet[0].station_m)
        yield Moment(
            seen.t_s,
            leader.position.copy(),
            bearing(leader.rotation),
            follower.position.copy(),
            bearing(follower.rotation),
            station,
            seen.image,
            seen.state.name,
            kind.dark(1, seen.t_s),
        )


def bearing(rotation: Array) -> float:
    """Return where a vehicle's bow looks, seen from above, rad."""
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def vehicle(axes: Any, place: Array, yaw: float, colour: str) -> None:
    """Draw a hull."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    axes.fill(*(HULL @ turn.T + place[:2]).T, color=colour, zorder=3)


def frame(story: list[Moment], full: float) -> Image.Image:
    """Draw the last moment of a story, with the ways until then."""
    now = story[-1]
    figure = new_figure(6.2, 3.1)
    figure.set_facecolor(DARK)
    sea, array = figure.subplots(1, 2, width_ratios=(4.2, 1))
    for axes in (sea, array):
        axes.set(xticks=[], yticks=[], facecolor=DARK)
        for spine in axes.spines.values():
            spine.set_visible(False)
    middle = (now.leader + now.follower) / 2
    sea.set(xlim=middle[0] + HALF[0] * np.array([-1, 1]), aspect="equal")
    sea.set(ylim=middle[1] + HALF[1] * np.array([-1, 1]))
    if not now.dark:
        for spread_deg, alpha in ((16, 0.25), (8, 0.45)):  # two and one standard deviations
            edges = now.leader_yaw + np.pi + np.radians(np.linspace(-spread_deg, spread_deg, 20))
            rim = now.leader[:2] + BEAM_M * np.array([np.cos(edges), np.sin(edges)]).T
            sea.fill(*np.vstack([now.leader[:2], rim]).T, color=LIT, alpha=alpha, linewidth=0)
    sea.plot(*np.array([m.leader[:2] for m in story]).T, color=PALE, linewidth=1, alpha=0.6)
    for earlier, later in itertools.pairwise(story):
        way = np.array([earlier.follower[:2], later.follower[:2]]).T
        sea.plot(*way, color=COLOURS[later.state], linewidth=2)
    sea.plot(*now.station[:2], "+", color=PALE, markersize=9)
    vehicle(sea, now.leader, now.leader_yaw, PALE)
    vehicle(sea, now.follower, now.follower_yaw, COLOURS[now.state])
    left, bottom = middle[0] - HALF[0] + 0.6, middle[1] - HALF[1] + 0.6
    sea.plot([left, left + 5], [bottom, bottom], color=PALE, linewidth=1)
    sea.text(left + 2.5, bottom + 0.3, "5 m", color=PALE, ha="center", fontsize=8)
    off = np.linalg.norm(now.follower - now.station)
    sea.set_title(
        f"{now.t_s:3.0f} s   lamp {'off' if now.dark else 'on '}   follower {now.state},"
        f" {off:.1f} m off its station",
        color=COLOURS[now.state], loc="left", fontsize=10,
    )  # fmt: skip
    array.imshow(now.image, cmap=IMAGES, vmin=0, vmax=full)
    array.set_title("its array", color=PALE, fontsize=9)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


def main(name: str, seed: str, path: str) -> None:
    """Write the film."""
    (kind,) = kinds_named(name)
    story = list(moments(kind, int(seed)))
    full = max(moment.image.max() for moment in story)
    frames = [frame(story[: i + 1], full) for i in range(len(story))]
    # One palette for all, of what differs most, so that nothing flickers.
    colours = Image.new("RGB", (1, len(COLOURS)))
    colours.putdata([tuple(round(255 * part) for part in to_rgb(c)) for c in COLOURS.values()])
    samples = [frames[0], frames[len(frames) // 2], frames[-1]]
    sheet = Image.new("RGB", (frames[0].width, sum(sample.height for sample in samples) + 60))
    for i, sample in enumerate(samples):
        sheet.paste(sample, (0, i * sample.height))
    sheet.paste(colours.resize((sheet.width, 60)), (0, sheet.height - 60))
    palette = sheet.quantize(48, dither=Image.Dither.NONE)
    frames = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    times = [1000 // FRAMES_PER_S] * (len(frames) - 1) + [3000]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=times, loop=0)
    print(f"film: {path}, {len(frames)} frames, {Path(path).stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(*sys.argv[1:])
