"""``uuv_array study drives``: measure tracks in seas drawn from the prior.

Drive from 8 to 4 m behind the lamp and back, swaying, each time through another sea: what the
scene's prior leaves uncertain, such as the lamp's power, is drawn from it and stays for the drive.
Each image goes through the stages of the nodes, and the track is compared with the truth. A
consistent track has a mean NEES of 5. At the end, when the track has learnt most of the sea, it is
compared with poses of single images, for which the sea is as uncertain as the prior says.

  uuv_array study drives                        50 drives of a minute in the default scene
  uuv_array study drives --scene harbour        in another one
  uuv_array study drives --rate 20 --seconds 30
Ctrl-C ends the study early and reports the drives it has.
"""

import argparse
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array, X
from uuv_optical_array.core.storage.formats import plain
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.forward.aim import apparent
from uuv_optical_array.forward.drawn_sea import draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.shared.course import add_drives, course
from uuv_optical_array.studies.shared.errors import SIGMAS, FrameErrors
from uuv_optical_array.studies.shared.results import until_interrupted

LAST_S = 10.0  # at the end of a drive, when most was learnt


class Drive(NamedTuple):
    """Errors of the track, nan where a frame is not in it, and of the last single images."""

    tracks: FrameErrors
    singles: FrameErrors


def images(
    scene: Scene, duration_s: float, rate_hz: float, rng: np.random.Generator
) -> Iterator[tuple[float, Array, Array]]:
    """Yield time, s, pose and image of a drive through a sea drawn from the scene's prior."""
    model, sea = ForwardModel(scene), draw_sea(scene, rng)
    times_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    for time_s, pose in zip(times_s, course(times_s, duration_s, rng), strict=True):
        (seen,) = apparent(scene, pose[None], sea.aims[None])
        light = model.light(seen, sea.roll, sea.offsets)
        yield time_s, pose, model.read(model.with_gains(light, sea.gains), rng)


def drive(
    estimator: Estimator, duration_s: float, rate_hz: float, rng: np.random.Generator
) -> Drive:
    """Drive once through a sea drawn from the scene's prior, with an estimator of the scene."""
    pipeline, poses = Pipeline(estimator), []
    tracks: list[tuple[Array, Array] | None] = []
    singles: list[tuple[Array, Array] | None] = []
    for time_s, pose, image in images(estimator.scene, duration_s, rate_hz, rng):
        poses.append(pose)
        track = pipeline.answer(round((1 + time_s) * 1e9), image).track
        tracks.append((track.pose, track.covariance) if track else None)
        if time_s >= duration_s - LAST_S:
            try:
                estimate = estimator.estimate(image)
                singles.append((estimate.pose, estimate.covariance))
            except NoPose:
                singles.append(None)

    truth = np.array(poses)
    last = truth[-len(singles) :]
    return Drive(FrameErrors.untimed(tracks, truth), FrameErrors.untimed(singles, last))


def figures(drives: Sequence[Drive]) -> dict[str, Any]:
    """Return plain values of all drives together, errors in m and deg."""
    tracks = [drive.tracks for drive in drives]
    posed = np.concatenate([track.posed for track in tracks])
    means = np.array([track.nees.mean() for track in tracks if track.posed.any()])
    last = [(track.errors[-len(single.errors) :], single.errors) for track, single in drives]
    both = np.concatenate(last, axis=1)
    tracked, single = np.sqrt(np.nanmean(np.square(both), axis=1)) * IN_DEGREES
    result = {
        "drives": len(drives),
        "frames": len(posed),
        "refused": int((~posed).sum()),
        "beyond_6_sigma": sum(int(track.beyond_sigma(SIGMAS).sum()) for track in tracks),
        "nees_mean": means.mean(),
        "nees_of_drives": np.quantile(means, [0.05, 0.5, 0.95]),
        "last_s": LAST_S,
        "rms_tracked": dict(zip(DOF_NAMES, tracked, strict=True)),
        "rms_single": dict(zip(DOF_NAMES, single, strict=True)),
        "range_ratio": tracked[X] / single[X],
    }
    return plain(result)


def report(result: dict[str, Any]) -> str:
    """Return `figures` as text."""
    lines = [f"{'':<8}{'tracked':>9}{'single':>9}   RMS error in the last {result['last_s']:g} s"]
    for name, unit in zip(DOF_NAMES, DOF_UNITS, strict=True):
        tracked, single = result["rms_tracked"][name], result["rms_single"][name]
        lines.append(f"{name:<8}{tracked:>9.4f}{single:>9.4f}   {unit}")
    (low, median, high), of = result["nees_of_drives"], f"of {result['frames']}"
    lines += [
        "",
        f"range, tracked over single: {result['range_ratio']:.2f}",
        f"mean NEES: {result['nees_mean']:.2f}; of single drives {low:.2f} to {high:.2f} "
        f"(5 to 95 %), median {median:.2f}",
        f"off by more than 6 of its own standard deviations: {result['beyond_6_sigma']} {of}",
        f"not in the track: {result['refused']} {of}",
    ]
    return "\n".join(lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    options.add_method(parser)
    add_drives(parser, "how many drives", 50)
    options.add_seed(parser)
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and print it."""
    count, seconds, rate, seed = args.drives, args.seconds, args.rate, args.seed
    scene = options.scene_of(args)
    if not scene.nuisance_std():
        error = f"--scene: {scene.name} has no prior to draw seas from; give it one"
        raise options.OptionError(error)
    estimator = Estimator(scene, args.method).wait()
    rngs = (np.random.default_rng((seed, i)) for i in range(count))
    over = progress.over(rngs, "drive", count)
    drives, complete = until_interrupted(drive(estimator, seconds, rate, rng) for rng in over)
    result = figures(drives)
    about = {"scene": scene.name, "method": args.method, "seed": seed, "complete": complete}
    driven = f"{len(drives)} drives of {seconds:g} s at {rate:g} Hz"
    head = f"{args.method} in scene {scene.name}, {driven}, seed {seed}"
    text = f"{head}\n\n{report(result)}"
    return outputs.finish(args, about | result, text, complete, "only complete drives count")
