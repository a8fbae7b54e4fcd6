"""The options of commands that read a recorded bag, and the bag read by them."""

import argparse
from functools import partial
from pathlib import Path

from uuv_optical_array.cli import options, progress
from uuv_optical_array.cli.options import Settings
from uuv_optical_array.core.settings import declared
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.recording.images import Recording, Topics, read_recording

TOPICS = {f"{name}_topic": setting for name, setting in declared(Topics).items()}
POSES = declared(read_recording)


def add_bag(
    parser: argparse.ArgumentParser, required: bool = True, others: Settings | None = None
) -> None:
    """Add the bag, and as settings how it is read, and others."""
    about = "rosbag2's folder, or its .mcap or .db3 file"
    parser.add_argument("bag", type=Path, nargs=None if required else "?", help=about)
    options.add_set(parser, {**TOPICS, **POSES, **(others or {})})


def read_bag(args: argparse.Namespace, scene: Scene, poses_needed: bool = True) -> Recording:
    """Read the bag of a scene's array, as `read_recording` does, and show progress."""
    path, over = files.user_path(args.bag), partial(progress.over, unit="message")
    settings = dict(args.set)
    topics = Topics(*(settings[name] for name in TOPICS))
    how = {name: settings[name] for name in POSES}
    return read_recording(path, scene.array, topics, over, poses_needed, scene.lamp_count, **how)
