"""The options of commands that read a recorded bag, and the bag read by them."""

import argparse
from functools import partial
from pathlib import Path

from uuv_optical_array.cli import options, progress
from uuv_optical_array.cli.options import Settings
from uuv_optical_array.core.settings import declared
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.recording.images import Recording, read_recording

READING = declared(read_recording)  # settings of how a bag is read


def add_bag(
    parser: argparse.ArgumentParser, settings: Settings = READING, without: str = ""
) -> None:
    """Add the bag, and settings, such as `READING`; `without` a bag that is done."""
    about = "rosbag2's folder, or its .mcap or .db3 file; calibrate and estimate also take a .csv"
    about += f" (default: {without})" if without else ""
    parser.add_argument("bag", type=Path, nargs="?" if without else None, help=about)
    options.add_set(parser, settings)


def read_bag(args: argparse.Namespace, scene: Scene, poses_needed: bool = True) -> Recording:
    """Read the bag of a scene's array, as `read_recording` does, and show progress."""
    path, over = files.user_path(args.bag), partial(progress.over, unit="message")
    how = {name: value for name, value in args.set if name in READING}
    return read_recording(path, scene.array, over, poses_needed, scene.lamp_count, **how)
