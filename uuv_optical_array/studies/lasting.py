"""``uuv_array study lasting``: measure tracks in a sea that differs from the scene, drive by drive.

Drive from 8 to 4 m behind the lamp and back, swaying, through a sea that differs from the scene by
a kind of mismatch, which stays as it is for the drive: the same detectors are dirty, the same side
is shaded. Each image goes through the stages of the nodes. A pose that is off by more than six of
its own standard deviations is false; a false pose is unsaid if the diagnostics name neither a
mismatch nor a fault with it. docs/reference/mismatches.md has the kinds.

  uuv_array study lasting                            every kind, one drive each
  uuv_array study lasting --kinds moffat,hidden_row_0.5 --drives 5
  uuv_array study lasting --scene reference --rate 5   in another scene
Ctrl-C ends it early and reports the kinds it has.
"""

import argparse
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.processes import spread
from uuv_optical_array.core.storage.formats import cell, columns, plain
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import uniform_poses
from uuv_optical_array.studies.mismatches.kinds import Kind, kinds_named
from uuv_optical_array.studies.shared.course import add_drives, course
from uuv_optical_array.studies.shared.errors import SIGMAS, FrameErrors
from uuv_optical_array.studies.shared.results import until_interrupted

COLUMNS = {
    "kind": "kind",
    "frames": "frames",
    "single_answered": "single: answered",
    "single_false": "false",
    "track_answered": "track: with a pose",
    "track_false": "false",
    "track_unsaid": "unsaid",
    "track_rms_m": "RMS (m)",
    "track_nees": "NEES",
}


class Drive(NamedTuple):
    """Errors of n frames, of single images and of the track, and which were said to be off."""

    singles: FrameErrors
    tracks: FrameErrors
    said: NDArray[np.bool_]


def kinds_that_last(names: str | None, scene: Scene) -> list[Kind]:
    """Return the kinds of these names, or all that can differ on a drive; errors of both."""
    return [kind for kind in kinds_named(names, scene) if kind.draw is uniform_poses]


def drive(
    estimator: Estimator, kind: Kind, duration_s: float, rate_hz: float, rng: np.random.Generator
) -> Drive:
    """Drive once through a sea of a kind, of which all that is random is drawn once."""
    model, pipeline = ForwardModel(estimator.scene), Pipeline(estimator)
    times_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    poses, seed = course(times_s, duration_s, rng), int(rng.integers(2**63))
    singles: list[tuple[Array, Array] | None] = []
    tracks: list[tuple[Array, Array] | None] = []
    said: list[bool] = []
    for time_s, pose in zip(times_s, poses, strict=True):
        light = kind.light(model, pose[None], np.random.default_rng(seed))
        image = model.read(light[0], rng)
        _, estimate, track, _ = pipeline.answer(round((1 + time_s) * 1e9), image)
        singles.append((estimate.pose, estimate.covariance) if estimate else None)
        tracks.append((track.pose, track.covariance) if track else None)
        said.append(bool(estimate and estimate.fault) or bool(track and track.mismatch))

    by_track = FrameErrors.untimed(tracks, poses)
    return Drive(FrameErrors.untimed(singles, poses), by_track, np.array(said))


def figures(kind: Kind, drives: Sequence[Drive]) -> dict[str, Any]:
    """Return plain values of all drives of a kind together."""
    singles, tracks = [drive.singles for drive in drives], [drive.tracks for drive in drives]
    false = [track.beyond_sigma(SIGMAS) for track in tracks]
    posed = np.concatenate([track.errors[track.posed] for track in tracks])
    result: dict[str, Any] = {
        **dict.fromkeys(COLUMNS),
        "kind": kind.name,
        "frames": sum(len(track.errors) for track in tracks),
        "single_answered": sum(int(single.posed.sum()) for single in singles),
        "single_false": sum(int(single.beyond_sigma(SIGMAS).sum()) for single in singles),
        "track_answered": len(posed),
        "track_false": sum(int(each.sum()) for each in false),
        "track_unsaid": sum(
            int((each & ~drive.said).sum()) for each, drive in zip(false, drives, strict=True)
        ),
    }
    if len(posed):
        result["track_rms_m"] = np.sqrt(np.square(posed[:, :3]).sum(axis=1).mean())
        result["track_nees"] = np.concatenate([track.nees for track in tracks]).mean()
    return plain(result)


def measure(
    estimator: Estimator,
    kinds: Sequence[Kind],
    count: int,
    duration_s: float,
    rate_hz: float,
    seed: int,
) -> Iterator[dict[str, Any]]:
    """Yield the `figures` of so many drives of each kind, which share courses and noise."""

    def driven(i: int) -> Drive:
        rng = np.random.default_rng((seed, i % count))
        return drive(estimator, kinds[i // count], duration_s, rate_hz, rng)

    every = progress.over(spread(driven, len(kinds) * count), "drive", len(kinds) * count)
    for kind in kinds:
        yield figures(kind, list(islice(every, count)))


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Return the kinds as a table, and below it all together."""
    table = columns([[*COLUMNS.values()], *([cell(row[key]) for key in COLUMNS] for row in rows)])
    whole = {
        key: sum(row[key] for row in rows) for key in ("frames", "track_false", "track_unsaid")
    }
    share = whole["track_unsaid"] / whole["frames"]
    return (
        f"{table}\n\nof {whole['frames']} frames {whole['track_false']} of the track are false, "
        f"{whole['track_unsaid']} unsaid ({100 * share:.2g} %)"
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    options.add_method(parser)
    about = "kinds of mismatch (default: all that can differ on a drive)"
    parser.add_argument("--kinds", metavar="NAME,...", help=about)
    add_drives(parser, "how many drives of each kind", 1)
    options.add_seed(parser)
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and print it."""
    count, seconds, rate, seed = args.drives, args.seconds, args.rate, args.seed
    scene = options.scene_of(args)
    with options.checking_options():
        kinds = kinds_that_last(args.kinds, scene)
    estimator = Estimator(scene, args.method).wait()
    rows, complete = until_interrupted(measure(estimator, kinds, count, seconds, rate, seed))
    about = {"scene": scene.name, "method": args.method, "seed": seed, "complete": complete}
    driven = f"drives of {seconds:g} s at {rate:g} Hz, {count} of each kind"
    text = f"{args.method} in scene {scene.name}, {driven}, seed {seed}\n\n{report(rows)}"
    end = "the table ends where the work ended"
    return outputs.finish(args, about | {"kinds": rows}, text, complete, end)
