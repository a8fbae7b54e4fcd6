"""What each mechanism of the estimation earns: the same images and drives with it and without.

A mechanism is taken out by another value of the number, or another function, that stands for it.
What is compiled is compiled again without it, in a folder of its own.

  .venv/bin/python benchmarks/ablations.py                    all, in 20 minutes
  .venv/bin/python benchmarks/ablations.py --only lattice     those with the word in their name
"""

import argparse
import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any, NamedTuple
from unittest import mock

import frames
import numpy as np

from uuv_optical_array.cli import progress
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import YAW
from uuv_optical_array.core.processes import spread
from uuv_optical_array.core.storage.formats import cell, columns
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.frame_kinds import frame_kinds
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.tracking.belief import correct
from uuv_optical_array.estimation.tracking.filter import SHARES
from uuv_optical_array.estimation.tracking.second_order import SecondOrder
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import POWER
from uuv_optical_array.forward.scene import Scene, load_scene, scene_from_settings
from uuv_optical_array.forward.working_volume import lit_poses, uniform_poses
from uuv_optical_array.studies import drives, lasting
from uuv_optical_array.studies.closed_loops.kinds import kinds_named as troubles_named
from uuv_optical_array.studies.closed_loops.runs import run_kind
from uuv_optical_array.studies.mismatches.kinds import kinds_named
from uuv_optical_array.studies.shared.course import course
from uuv_optical_array.studies.shared.errors import FrameErrors

SEED, IMAGES, DRIVES = 1, 300, 2
DRIVE_S, RATE_HZ = 60.0, 10.0
ESTIMATION = "uuv_optical_array.estimation."
FIT, TRACK = "least_squares.", "tracking."
FIGURES = ["answered", "false", "NEES", "time"]
HEAD = ["mechanism", "sea", *FIGURES, *(f"without: {name}" for name in FIGURES)]


class Part(NamedTuple):
    """A mechanism.

    - name: what it is.
    - off: what takes the place of which names of modules, or of classes, below `ESTIMATION`.
    - seas: which show what it is for, as of `measured`.
    - compiled: whether it is part of what is compiled.
    """

    name: str
    off: dict[str, Any]
    seas: tuple[str, ...]
    compiled: bool = False


def none_found(fit: Any, image: Any, kind: Any, *given: Any) -> list[Any]:
    """Return that an image is not explained without faulty detectors."""
    return [fit._hypothesis(kind, image.problem(kind), np.empty(0)).refused]


def clear_alone(*given: Any) -> list[Any]:
    """Return the kind of a clear frame alone."""
    return frame_kinds(*given)[:1]


def all_taught(*given: Any, teach: bool = True) -> Any:
    """Correct pose and biases alike."""
    return correct(*given)


def straight(slopes_at: Callable[[Any], Any], mean: Any, covariance: Any) -> Any:
    """Return that a function is linear."""
    rows = len(slopes_at(mean))
    return SecondOrder(np.zeros(rows), np.zeros((rows, 1)))


def trusted(doubted: Any, stamp_ns: int, believed: Any) -> Any:
    """Return that the images before say nothing of the detectors."""
    return np.ones(len(believed))


def nothing(*given: Any) -> None:
    """Return that there is nothing."""


PARTS = [
    Part(
        "kinds of uneven light",
        {FIT + "image_fit.frame_kinds": clear_alone},
        ("nothing", "shade_0.05", "gradient_10"),
    ),
    Part(
        "one linear step before a kind is fitted",
        {FIT + "hypotheses.LOG_CONSIDERED": -np.inf, FIT + "hypotheses.LOG_LIKELY": -np.inf},
        ("nothing", "shade_0.05"),
    ),
    Part(
        "faulty detectors",
        {FIT + "hypotheses.Hypotheses._mended": none_found},
        ("two_dirty", "glint", "dead_detector"),
    ),
    Part(
        "a hidden row or column",
        {FIT + "hypotheses.lines_of_neighbours": np.zeros_like},
        ("hidden_row_0.5",),
    ),
    Part(
        "a dark lamp of several",
        {FIT + "hypotheses.Hypotheses._without_dark_lamp": nothing},
        ("leading_lights hidden_lamp",),
    ),
    Part(
        "more probable with the lamp than without",
        {FIT + "image_fit.ImageFit._check_seen": nothing},
        ("off",),
    ),
    Part(
        "nine nodes before a lattice",
        {FIT + "posterior.NEARLY": 0.0},
        ("nothing", "planar nothing"),
        compiled=True,
    ),
    Part(
        "a row of nodes along a ridge",
        {FIT + "posterior.ALONG": 9},
        ("flat nothing",),
        compiled=True,
    ),
    Part(
        "finer and coarser lattices",
        {FIT + "posterior.FINER": 0},
        ("nearby", "planar nothing"),
        compiled=True,
    ),
    Part(
        "cover of other minima",
        {FIT + "frame.RIVAL": -1.0},
        ("nearby", "planar nothing"),
        compiled=True,
    ),
    Part(
        "many starts where few detectors are lit",
        {FIT + "frame.FEW_LIT": 0},
        ("nearby", "turned"),
        compiled=True,
    ),
    Part(
        "starts nearer, farther aside, turned away",
        {FIT + "starts.NEAR_STARTS": 1, FIT + "starts.TURNED": 0.0},
        ("nearby", "turned"),
    ),
    Part(
        "track: the pose teaches no constants",
        {TRACK + "correction.correct": all_taught},
        ("drive drawn", "drive moffat", "drive bent_0.01"),
    ),
    Part(
        "track: errors by the place are noise",
        {TRACK + "belief.PLACE_SHARE": 0.0},
        ("drive drawn", "drive moffat", "drive bent_0.01"),
    ),
    Part(
        "track: second order",
        {TRACK + "correction.second_order": straight},
        ("drive drawn", "drive planar drawn", "drive harbour drawn"),
    ),
    Part(
        "track: what the biases do not explain",
        {TRACK + "correction.UNLIKE": 0.0},
        ("drive second_lamp_0.3", "loop other_crossing"),
    ),
    Part(
        "track: manoeuvres",
        {TRACK + "filter.SHARES": {"usual": 1.0, "jump": SHARES["jump"]}},
        ("drive drawn", "loop turn_30"),
    ),
    Part(
        "track: jumps",
        {TRACK + "filter.SHARES": {"usual": 1.0, "manoeuvre": SHARES["manoeuvre"]}},
        ("drive dimmed", "loop lamp_0.5"),
    ),
    Part(
        "track: detectors doubted before",
        {TRACK + "doubted_detectors.DoubtedDetectors.trust": trusted},
        ("drive two_dirty",),
    ),
    Part(
        "track: uneven images weigh less",
        {TRACK + "correction.UNEVEN_S": 0.0, TRACK + "correction.UNNAMED_DOUBT": 1.0},
        ("drive shade_0.05",),
    ),
]


def nearby(count: int, rng: np.random.Generator) -> Any:
    """Draw poses within 0.8 to 2 m of the lamp."""
    poses = uniform_poses(count, rng)
    ranges_m = np.linalg.norm(poses[:, :3], axis=1, keepdims=True)
    poses[:, :3] *= rng.uniform(0.8, 2.0, (count, 1)) / ranges_m
    return poses


def turned(count: int, rng: np.random.Generator) -> Any:
    """Draw poses whose array looks past the lamp, so that its edge alone is lit."""
    poses = uniform_poses(count, rng)
    poses[:, YAW] = np.radians(rng.choice([-1, 1], count) * rng.uniform(90, 110, count))
    return poses


DRAWS = {"nearby": nearby, "turned": turned}


def owner_of(name: str) -> tuple[Any, str]:
    """Return the module or class that has a name, and the name there."""
    folder, module, *names = name.split(".")
    owner: Any = importlib.import_module(f"{ESTIMATION}{folder}.{module}")
    for each in names[:-1]:
        owner = getattr(owner, each)
    return owner, names[-1]


def scene_named(words: list[str]) -> Scene:
    """Return the scene that words ask for."""
    for word in ("leading_lights", "harbour"):
        if word in words:
            return load_scene(word)
    scene = load_scene("follow")
    if "planar" in words:
        return scene.with_shape("planar")
    if "flat" in words:
        values = scene.settings()
        values["lamp"].update(beam_widths=[1.0, 0.8], beam_weights=[3.0, -2.0])
        return scene_from_settings(values, "flat")
    return scene


def measured(sea: str) -> list[Any]:
    """Return how many images of a sea were answered, how many false, NEES, and yardsticks.

    - sea: a kind of mismatch, after words for another scene, or ``off`` without the lamp, or one
      of `DRAWS`; after ``drive``, of tracks, also ``drawn`` from the prior, or ``dimmed``; after
      ``loop`` a kind of trouble in which followers go by their tracks.
    """
    *words, name = sea.split()
    scene, yardsticks = scene_named(words), None
    # Another process would compile what this one has changed as it was.
    estimator = Estimator(scene, compiled=True)
    if track := TRACKS.keys() & words:
        parts = list(spread(partial(TRACKS[track.pop()], estimator, name), DRIVES))
        errors, covariances = map(np.concatenate, zip(*parts, strict=True))
    else:
        errors, covariances, yardsticks = answered(estimator, name)
    found = FrameErrors(errors, covariances, np.empty(0), np.empty(0)).summary()
    return [f"{found['answered']} of {len(errors)}", found["beyond_6_sigma"], found["nees_mean"],
            yardsticks]  # fmt: skip


def driven(estimator: Estimator, name: str, i: int) -> tuple[Any, Any]:
    """Return errors and covariances of the tracks of a drive through a sea."""
    rng = np.random.default_rng((SEED, i))
    if name == "drawn":
        tracks = drives.drive(estimator, DRIVE_S, RATE_HZ, rng).tracks
    elif name == "dimmed":
        tracks = dimmed(estimator, rng)
    else:
        (kind,) = kinds_named(name, estimator.scene)
        tracks = lasting.drive(estimator, kind, DRIVE_S, RATE_HZ, rng).tracks
    return tracks.errors, tracks.covariances


def looped(estimator: Estimator, name: str, i: int) -> tuple[Any, Any]:
    """Return errors and covariances of the tracks of a follower, the latter without correlation."""
    (kind,) = troubles_named(name)
    (run,) = run_kind(kind, SEED + i, "kinematic", estimator)
    return run.errors, run.stds[:, :, None] ** 2 * np.eye(5)


TRACKS = {"drive": driven, "loop": looped}


def dimmed(estimator: Estimator, rng: np.random.Generator) -> FrameErrors:
    """Drive once, while the lamp loses a fifth of its power in the middle at once."""
    model, pipeline = ForwardModel(estimator.scene), Pipeline(estimator)
    times_s = np.arange(round(DRIVE_S * RATE_HZ)) / RATE_HZ
    poses, tracks = course(times_s, DRIVE_S, rng), []
    for time_s, pose in zip(times_s, poses, strict=True):
        power = np.log(0.8 if time_s > DRIVE_S / 2 else 1.0)
        image = model.expose(pose, rng, offsets={POWER: power})
        track = pipeline.answer(round((1 + time_s) * 1e9), image).track
        tracks.append((track.pose, track.covariance) if track else None)
    return FrameErrors.untimed(tracks, poses)


def answered(estimator: Estimator, name: str) -> tuple[Any, Any, float]:
    """Return errors, covariances and the median time, yardsticks, of single images of a sea."""
    model, rng = ForwardModel(estimator.scene), np.random.default_rng((SEED, 1))
    (kind,) = kinds_named("nothing" if name in ("off", *DRAWS) else name, estimator.scene)
    draw = DRAWS.get(name, kind.draw)
    poses = lit_poses(model, IMAGES, np.random.default_rng(SEED), draw)
    light = kind.light(model, poses, rng)
    if name == "off":
        light = np.full_like(light, model.noise.black)
        light += 5 * np.abs(rng.standard_normal((IMAGES, 1, 1)))  # daylight, as its prior knows it
    images = model.read(light, np.random.default_rng((SEED, 2)))
    errors, covariances = np.full((IMAGES, 5), np.nan), np.full((IMAGES, 5, 5), np.nan)
    asked, times, units = frames.example(np.random.default_rng(1)), [], []
    frames.yardstick(*asked)

    def answer(i: int) -> None:
        with suppress(NoPose):
            estimate = estimator.estimate(images[i])
            errors[i], covariances[i] = estimate.pose - poses[i], estimate.covariance

    for i in range(IMAGES):
        units.append(frames.cpu_us(frames.yardstick, *asked))
        times.append(frames.cpu_us(answer, i))
    return errors, covariances, float(np.median(times) / np.median(units))


def without(part: Part) -> list[list[Any]]:
    """Return what comes of the seas of a part without it, in this process."""
    with ExitStack() as stack:
        for name, other in part.off.items():
            stack.enter_context(mock.patch.object(*owner_of(name), other))
        return [measured(sea) for sea in part.seas]


def apart(part: Part) -> list[list[Any]]:
    """Return the same from another process, which compiles by itself."""
    with tempfile.TemporaryDirectory() as folder:
        call = [sys.executable, __file__, "--without", part.name]
        variables = {**os.environ, "NUMBA_CACHE_DIR": folder}
        done = subprocess.run(call, env=variables, stdout=subprocess.PIPE, check=True)
    result: list[list[Any]] = json.loads(done.stdout)
    return result


def table(only: str) -> str:
    """Return what the parts with a word in their name earn, as text."""
    parts, whole, rows = [part for part in PARTS if only in part.name], {}, [HEAD]
    for part in progress.over(parts, "part"):
        less = apart(part) if part.compiled else without(part)
        for sea, figures in zip(part.seas, less, strict=True):
            if sea not in whole:
                whole[sea] = measured(sea)
            rows.append([part.name, sea, *map(cell, [*whole[sea], *figures])])
    return columns(rows)


def main() -> None:
    """Measure the parts and print them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", help="word in the names of the parts to measure")
    parser.add_argument("--without", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.without:
        (part,) = (part for part in PARTS if part.name == args.without)
        print(json.dumps(without(part)))
    else:
        print(table(args.only))


if __name__ == "__main__":
    main()
