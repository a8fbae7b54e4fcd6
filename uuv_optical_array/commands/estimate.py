"""``uuv_array estimate``: estimate the poses of a recorded bag.

Estimate a pose from every image by itself, with any scene and method, on all cores (`taskset`
allows fewer). The command writes a folder: frames.csv (a line for each image), bag (MCAP, with
relative_pose), relative_pose.tum and, if the bag has both odometries, truth.tum. With --track it
does what feature and estimator node do by default: it also filters the frames in their order, with
the follower's commands if the bag has any, and adds relative_odometry. Bags without metadata.yaml
are read, and so are the complete messages of a truncated MCAP file.

  uuv_array estimate sea                                by the default scene, into sea_estimates
  uuv_array estimate sea --scene sea.yaml -o again      by another scene
  uuv_array estimate sea --method sam --track           by another method, and filtered
  evo_ape tum sea_estimates/truth.tum sea_estimates/relative_pose.tum
  uuv_array estimate dive.csv --detectors detectors.csv --known z_m --known pitch_deg=0
                                                        readings of any detectors, as a table
A table of readings has a column for each detector (NAME, or NAME.0, NAME.1 ... by lamp), and
perhaps time_s. --known takes x_m, y_m, z_m, pitch_deg, yaw_deg or roll_deg as known, from its
column or from the given value: exactly, or with the error of --known x_std_m=0.1. The other parts
are estimated, and compared with their columns. Ctrl-C writes what there is. Needs rosbags and mcap
(pip install rosbags mcap), but no ROS.
"""

import argparse
import math
import time
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from uuv_optical_array.cli import bag, light, options, outputs, progress
from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, wrapped
from uuv_optical_array.core.processes import spread
from uuv_optical_array.core.settings import Quantity, Setting
from uuv_optical_array.core.storage import files
from uuv_optical_array.estimation.estimate import Estimate
from uuv_optical_array.estimation.estimator import Estimator, EstimatorSettings
from uuv_optical_array.estimation.pipeline import Answer
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.layouts.detectors import layout_of, of_scene
from uuv_optical_array.layouts.poses import PoseFit
from uuv_optical_array.recording.clocks import shifted
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.places import LEAST_STD, POSE
from uuv_optical_array.recording.replay import CHUNK_FRAMES, replay
from uuv_optical_array.recording.results import write_results

OFFSET = Quantity(
    "offset from the stamp of an image to that of its true pose, as calibrate prints it",
    "s",
    -1e6,
    1e6,
)
SETTINGS = bag.READING | light.SETTINGS
SETTINGS |= {"time_offset_s": Setting(float, OFFSET, 0.0, optional=False)}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    bag.add_bag(parser, SETTINGS)
    options.add_scene(parser, "follow")
    options.add_method(parser)
    filtered = "filter the frames, and by least_squares learn the constants"
    parser.add_argument("--track", action="store_true", help=filtered)
    light.add_tables(parser)
    about = "take a part of the poses, or its error, as known: its column, or the given value; may "
    about += "be repeated"
    known: dict[str, Any] = {"action": "append", "default": [], "type": light.known_column}
    parser.add_argument("--known", help=about, metavar="NAME[=VALUE]", **known)
    outputs.add_folder(parser, "folder to make (default: the bag's name with _estimates, here)")


def run(args: argparse.Namespace) -> int:
    """Read, estimate, write and print."""
    output = outputs.folder_to_write(
        args.output or f"{args.bag.absolute().stem}_estimates", "--output", new=True
    )
    needs("bags", "mcap.writer")  # before all is estimated, not after
    scene = options.scene_of(args)
    told, offset_s = light.read_light(args, scene, False), dict(args.set)["time_offset_s"]
    if offset_s:
        told = told._replace(recording=shifted(told.recording, offset_s, posed=False))
    recording = told.recording
    by_layout = told.layout is not None or bool(args.known)
    if by_layout and (args.track or args.method != EstimatorSettings.method):
        raise options.OptionError(
            "--track, --method: for the scene's array alone; leave them out with --detectors and "
            "--known"
        )
    tracking = TrackerSettings() if args.track else None
    frames: list[Answer] = []
    started, exit_code = time.monotonic(), 0
    images, stamps_ns, commands = recording.images, recording.stamps_ns, recording.commands
    if by_layout:
        answers = _by_layout(told, scene, dict(args.known))
    else:
        estimator = Estimator(scene, args.method).wait()
        answers = replay(images, stamps_ns, estimator, tracking, commands=commands)
    with closing(answers):
        try:
            for frame in progress.over(answers, total=len(images)):
                frames.append(frame)
        except KeyboardInterrupt:
            exit_code = options.INTERRUPTED
    took_s = time.monotonic() - started
    with files.whole_directory(output) as folder:
        names = write_results(folder, frames, recording)
    if exit_code:
        print(f"interrupted after {len(frames)} of {len(recording.images)} images")
    where = "its columns" if light.is_table(args.bag) else "the bag's odometries"
    source = f"{args.trajectory.name}" if args.trajectory else where
    print(report(frames, recording, took_s, args.track, source))
    print(f"{args.method} in scene {scene.name}: {', '.join(names)} in {output}")
    return exit_code


def _by_layout(
    told: light.Light, scene: Scene, known: Mapping[str, float | None]
) -> Generator[Answer, None, None]:
    """Yield the answers to readings of detectors in any layout, or of poses that are known."""
    values = {name: value for name, value in known.items() if value is not None}
    recording, stds, *_ = light.with_known(told, values)
    parts = [i for i, name in enumerate(POSE) if name in known]
    given = np.full(recording.poses.shape, np.nan)
    given[:, parts] = recording.poses[:, parts]
    for i in parts:
        if missing := int(np.isnan(given[:, i]).sum()):
            raise ValueError(
                f"--known {POSE[i]}: no value for {missing} of {len(given)} images; fill its "
                f"column, or give {POSE[i]}=VALUE"
            )
    fit = PoseFit(told.layout or layout_of(scene, of_scene(scene)), EstimatorSettings.max_misfit)
    stds = np.where(np.isnan(stds), LEAST_STD, stds)

    def answer(i: int) -> Answer:
        found = fit.one(recording.images[i], given[i], stds[i], float(recording.rolls[i]))
        estimate = None
        if not found.reason:
            estimate = Estimate(
                found.pose, found.covariance, math.nan, None, math.nan, misfit=found.misfit
            )
        return Answer(int(recording.stamps_ns[i]), estimate, None, found.reason)

    yield from spread(answer, len(given), None, CHUNK_FRAMES)


def report(
    frames: Sequence[Answer],
    recording: Recording,
    took_s: float,
    tracked: bool,
    source: str = "the bag's odometries",
) -> str:
    """Return the numbers of images and poses and the errors, as text; `source` names the truth."""
    posed = [(i, frame.estimate.pose) for i, frame in enumerate(frames) if frame.estimate]
    span_s = (frames[-1].stamp_ns - frames[0].stamp_ns) * 1e-9 if frames else 0.0
    lines = [
        f"{len(frames)} images of {span_s:.1f} s in {took_s:.2f} s, {span_s / took_s:.2g} times as "
        f"fast as they were taken: {len(posed)} poses",
        *(f"  {line}" for line in recording.left_out),
    ]
    reasons = Counter(frame.reason.partition(":")[0] for frame in frames if frame.reason)
    lines += [f"  no pose: {count} x {reason}" for reason, count in reasons.most_common()]
    poses = {"relative_pose": posed}
    if tracked:
        poses["relative_odometry"] = [(i, f.track.pose) for i, f in enumerate(frames) if f.track]
    for name, numbered in poses.items():
        true = recording.poses[[i for i, _ in numbered]]
        known = ~np.isnan(true).any(axis=0)
        differences = np.array([pose for _, pose in numbered]).reshape(-1, 5) - true
        if known.any() and len(numbered):
            errors = np.array([wrapped(difference) for difference in differences])
            cells = [
                f"{DOF_NAMES[i]} {np.sqrt(np.nanmean(errors[:, i] ** 2)) * IN_DEGREES[i]:.3g} "
                f"{DOF_UNITS[i]}"
                for i in np.flatnonzero(known)
            ]
            text = ", ".join(cells)
            lines.append(f"{name}, rms error by {source}: {text}")
    return "\n".join(lines)
