"""``uuv_array estimate``: estimate the poses of a recorded bag.

Estimate every image as feature and estimator node would, with any scene and method and a roll of
0, on all cores (`taskset` allows fewer). Writes a folder: frames.csv (a line for each image), bag
(MCAP, with relative_pose), relative_pose.tum and, where the bag has both odometries, truth.tum.
--track also filters the frames in their order, with the follower's commands if the bag has any
(relative_odometry). It reads a folder without metadata.yaml, and whole messages of truncated MCAP.

  uuv_array estimate sea                                by the default scene, into sea_estimates
  uuv_array estimate sea --scene sea.yaml -o again      by another scene
  uuv_array estimate sea --method sam --track           by another method, and filtered
  evo_ape tum sea_estimates/truth.tum sea_estimates/relative_pose.tum
Ctrl-C writes what there is. Needs rosbags and mcap (pip install rosbags mcap), but no ROS.
"""

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing

import numpy as np

from uuv_optical_array.cli import bag, options, outputs, progress
from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, wrapped
from uuv_optical_array.core.storage import files
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Answer
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.replay import replay
from uuv_optical_array.recording.results import write_results


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    bag.add_bag(parser)
    options.add_scene(parser, "follow")
    options.add_method(parser)
    filtered = "filter the frames, and learn the constants"
    parser.add_argument("--track", action="store_true", help=filtered)
    outputs.add_folder(parser, "folder to make (default: that of the bag with _estimates)")


def run(args: argparse.Namespace) -> int:
    """Read, estimate, write and print."""
    output = outputs.folder_to_write(
        args.output or f"{args.bag.absolute().stem}_estimates", "--output", new=True
    )
    needs("bags", "mcap.writer")  # before all is estimated, not after
    scene = options.scene_of(args)
    recording = bag.read_bag(args, scene, poses_needed=False)
    estimator = Estimator(scene, args.method).wait()
    tracking = TrackerSettings() if args.track else None
    frames: list[Answer] = []
    started, exit_code = time.monotonic(), 0
    images, stamps_ns, commands = recording.images, recording.stamps_ns, recording.commands
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
    print(report(frames, recording, took_s, args.track))
    print(f"{args.method} in scene {scene.name}: {', '.join(names)} in {output}")
    return exit_code


def report(frames: Sequence[Answer], recording: Recording, took_s: float, tracked: bool) -> str:
    """Return the numbers of images and poses and the errors, as text."""
    posed = [(i, frame.estimate.pose) for i, frame in enumerate(frames) if frame.estimate]
    span_s = (frames[-1].stamp_ns - frames[0].stamp_ns) * 1e-9 if frames else 0.0
    lines = [
        f"{len(frames)} images of {span_s:.1f} s in {took_s:.2f} s, {span_s / took_s:.0f} times as "
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
        known = ~np.isnan(true[:, 0])
        if known.any():
            differences = np.array([pose for _, pose in numbered]) - true
            errors = np.array([wrapped(difference) for difference in differences[known]])
            rms = np.sqrt(np.mean(errors**2, axis=0)) * IN_DEGREES
            cells = zip(DOF_NAMES, rms, DOF_UNITS, strict=True)
            text = ", ".join(f"{dof} {value:.3g} {unit}" for dof, value, unit in cells)
            lines.append(f"{name}, rms error by the bag's odometries: {text}")
    return "\n".join(lines)
