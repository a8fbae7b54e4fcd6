"""``uuv_array commission``: the wiring of an array, found with a torch, written into its scene."""

import argparse
import dataclasses
from pathlib import Path

from uuv_optical_array.calibration.wiring import TorchSweeps, description
from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.scene import Scene, save_scene
from uuv_optical_array.forward.scene_files import own_text
from uuv_optical_array.recording.images import Topics, read_recording

DESCRIPTION = """\
Find which reading of the image is which detector, and write it into the scene as array.wiring, by
which every node sets the image right as it comes in. Move a torch before the array, as you are
told: from port to starboard, then from top to bottom. Any wiring is found, mirrored, turned and
scrambled ones alike. A mirrored array gives false poses, and no software tells it from a right one.
The scene's own array.wiring does not count meanwhile, and is replaced."""

EPILOG = """\
examples:
  uuv_array commission --scene sea.yaml -o sea.yaml     listens to array/image
  uuv_array commission --topic /bow/array/image         another topic
  uuv_array commission --bag torch                      a bag of both sweeps; needs no ROS
The array in the dark or in steady light, 1 s without the torch before, between and after the
sweeps, 3 images or more for each column. An array on a serial line is heard by way of the node that
publishes its images. Ctrl-C writes nothing."""


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers, "commission", run, "find an array's wiring with a torch", DESCRIPTION, EPILOG
    )
    options.add_scene(parser, "follow")
    parser.add_argument(
        "--bag",
        type=Path,
        help="folder of a rosbag2, or its .mcap or .db3 file (default: the topic as it is live)",
    )
    parser.add_argument(
        "--topic", default=Topics.image, help="of the images (default: %(default)s)"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("commissioned.yaml"),
        help="scene to write (default: %(default)s)",
    )


def sweeps_of(scene: Scene) -> TorchSweeps:
    """Return sweeps that begin now, and tell on standard output what to do."""
    side, full = scene.array.detectors_per_side, scene.full_scale_counts
    return TorchSweeps(side, full, lambda text: print(text, flush=True))


def run(args: argparse.Namespace) -> int:
    """Watch both sweeps and write the scene."""
    scene, like = options.scene_of(args), own_text(args.scene)
    output = outputs.file_to_write(args.output, "--output", outputs.SCENE)
    array = dataclasses.replace(scene.array, wiring=None)
    if args.bag is not None:
        sweeps = sweeps_of(scene)
        recording = read_recording(
            files.user_path(args.bag), array, Topics(args.topic), poses_needed=False
        )
        for stamp, image in zip(recording.stamps_ns, recording.images, strict=True):
            sweeps.take(int(stamp), image)
        sweeps.end_sweep()
        if sweeps.wiring is None:
            raise ValueError(f"bag {args.bag}: it ends before both sweeps are over")
    else:
        listen = needs("ros", "uuv_optical_array.nodes.shared.image_listener").listen
        sweeps = sweeps_of(scene)
        listen(args.topic, array, sweeps.take, lambda: sweeps.wiring is None)
    wiring = sweeps.wiring
    if wiring is None:
        print("interrupted: nothing was written")
        return options.INTERRUPTED
    print(f"wiring: {description(wiring, scene.array.detectors_per_side)}")
    straight = wiring == list(range(len(wiring)))
    wired = dataclasses.replace(scene.array, wiring=None if straight else wiring)
    comment = f"Commissioned by uuv_array commission, starting from {scene.name}."
    save_scene(dataclasses.replace(scene, array=wired), output, comment, like)
    print(f"scene: {output}")
    return 0
