"""The options of commands that read a recorded bag, and the bag read by them."""

import argparse
from pathlib import Path
from typing import Annotated, get_args

from uuv_optical_array.cli import options, progress
from uuv_optical_array.control.trajectory import MAX_GAP, MAX_GAP_S
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.recording.images import Axes, Recording, Topics, read_recording

BEACON = Quantity("the lamp in the leader's base_link", "m", -100, 100)
NUMBERS = {
    "max-gap-s": options.Number(MAX_GAP, MAX_GAP_S),
}


def add_bag(parser: argparse.ArgumentParser, required: bool = True, commands: bool = False) -> None:
    """Add the bag and what is said of its messages, the follower's commands among them or not."""
    parser.add_argument(
        "bag",
        type=Path,
        nargs=None if required else "?",
        help="folder of a rosbag2, or its .mcap or .db3 file",
    )
    topics = Topics()
    for name, topic in (
        ("image", topics.image),
        ("leader", topics.leader),
        ("follower", topics.follower),
        *([("commands", topics.commands)] if commands else []),
    ):
        parser.add_argument(
            f"--{name}-topic", default=topic, metavar="TOPIC", help="(default: %(default)s)"
        )
    parser.add_argument(
        "--beacon-position",
        type=float,
        nargs=3,
        default=[0.0, 0.0, 0.0],
        metavar=("X", "Y", "Z"),
        help=f"{BEACON.text}, m (default: 0 0 0)",
    )
    parser.add_argument(
        "--odometry-axes", choices=get_args(Axes), default="flu", help="(default: %(default)s)"
    )
    options.add_numbers(parser, NUMBERS)


def read_bag(args: argparse.Namespace, scene: Scene, poses_needed: bool = True) -> Recording:
    """Read the bag of a scene's array, as `read_recording` does, and show how far it is."""
    (max_gap_s,) = options.numbers_of(args, NUMBERS)
    given = [name for name in vars(Topics()) if f"{name}_topic" in args]
    return read_recording(
        files.user_path(args.bag),
        scene.array,
        Topics(**{name: vars(args)[f"{name}_topic"] for name in given}),
        [check(Annotated[float, BEACON], x, "--beacon-position") for x in args.beacon_position],
        args.odometry_axes,
        max_gap_s,
        lambda each: progress.over(each, "message"),
        poses_needed,
    )
