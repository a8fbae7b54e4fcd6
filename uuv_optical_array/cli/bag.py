"""The options of commands that read a recorded bag, and the bag read by them."""

import argparse
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from uuv_optical_array.cli import options, progress
from uuv_optical_array.core.settings import declared
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.recording.images import Recording, Topics, read_recording


def add_bag(parser: argparse.ArgumentParser, required: bool = True, commands: bool = False) -> None:
    """Add the bag and how it is read, the topic of the follower's commands included or not."""
    about = "rosbag2's folder, or its .mcap or .db3 file"
    parser.add_argument("bag", type=Path, nargs=None if required else "?", help=about)
    names = asdict(Topics())
    if not commands:
        del names["commands"]
    about = f"another topic in place of {', '.join(names.values())}; may be repeated"
    words: dict[str, Any] = {"action": "append", "default": [], "metavar": "FROM:=TO"}
    parser.add_argument("-r", "--remap", help=about, **words)
    parser.set_defaults(topics=names)
    options.add_set(parser, declared(read_recording))


def topics_of(args: argparse.Namespace) -> Topics:
    """Return the topics of the bag, remapped as the options say."""
    topics = dict(args.topics)
    for rule in args.remap:
        source, separator, target = rule.partition(":=")
        name = next((n for n, t in args.topics.items() if t == source.lstrip("/")), None)
        if not separator or not target or name is None:
            known = f"where FROM is one of {', '.join(args.topics.values())}"
            raise options.OptionError(f"--remap {rule}: give FROM:=TO, {known}")
        topics[name] = target
    return Topics(**topics)


def read_bag(args: argparse.Namespace, scene: Scene, poses_needed: bool = True) -> Recording:
    """Read the bag of a scene's array, as `read_recording` does, and show progress."""
    path, over = files.user_path(args.bag), partial(progress.over, unit="message")
    how = topics_of(args), over, poses_needed, scene.lamp_count
    return read_recording(path, scene.array, *how, **dict(args.set))
