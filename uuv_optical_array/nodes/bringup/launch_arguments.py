"""Arguments of the launch files, each with its default and its meaning, and enclaves of SROS2.

Empty means: not given, so that neither a file's value nor a node's default is replaced.
"""

import difflib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from uuv_optical_array.core.storage import yaml_text
from uuv_optical_array.core.storage.files import PACKAGE

LEVELS = "debug", "info", "warn", "error", "fatal"
YES, NO = ("true", "True", "1"), ("false", "False", "0")
SCENE = "name of a ready scene, or path of a YAML file"
LEADER_PATH = "", "path of the demo leader: the name of a ready one, or a CSV file"
COMMON = {
    "params_file": ("", "your parameters; others keep their default"),
    "use_sim_time": ("", "use simulated time, from /clock"),
    "draw_sea": (
        "",
        "draw the sea from the scene's prior (default); false: it is exactly the scene's",
    ),
    "use_respawn": (
        "false",
        "start a node again that ended; false: the launch ends with it; RViz may end in any case",
    ),
    "rviz": ("false", "open RViz"),
    "rviz_config": ("", "configuration file of RViz"),
    "publish_tf": ("", "send frames to /tf and /tf_static; with rviz this is the default"),
    "log_level": ("", f"least severity that is logged: {', '.join(LEVELS)}"),
}
FOLLOW = {
    "scene": ("", SCENE),
    "namespace": ("", "namespace of the nodes"),
    "frame_prefix": (
        "",
        "prefix of each frame's name that does not begin with /, such as `rov_2/`",
    ),
    "leader_frame": ("", "frame of the leader, to which /tf_static ties that of the lamp"),
    "one_process": ("false", "run feature, estimator and formation node in follower_node"),
    "simulator": ("true", "simulate the images; false: an array takes them"),
    "leader_odometry": (
        "leader/odometry",
        "topic of the leader's odometry, for followers that share a leader",
    ),
    "use_leader_odometry": ("", "also follow by the leader's odometry, as a modem would send it"),
    "others": ("", "odometry topics of other vehicles that the simulator draws"),
    "demo": (
        "true",
        "run both demo vehicles, or `follower`, without a leader, or `leader`, without any node of "
        "a follower",
    ),
    "followers": ("1", "number of followers that a leader alone waits for"),
    "leader_path": LEADER_PATH,
    "station": (
        "",
        "station of the follower, [x, y, z] in the lamp's frame, y to port and z up, m",
    ),
    "record": ("false", "record the run by rosbag2, as MCAP"),
    "bag": ("", "new folder of the recording; by default it is named by the time"),
    **COMMON,
}
FOLLOWER = {  # what follower.launch.py has instead
    **{name: ("false", FOLLOW[name][1]) for name in ("demo", "simulator")},
    "one_process": ("true", FOLLOW["one_process"][1]),
}
EACH = {  # what the launch of each vehicle of a formation gets
    "scene": ("formation", SCENE),
    "one_process": ("true", "run the three nodes of each follower in follower_node"),
    **COMMON,
}
FORMATION = {
    "followers": ("3", "number of followers"),
    "chain": ("true", "the third and later ones are lit by a follower ahead, not the leader"),
    "namespace": ("", "namespace of the whole formation"),
    "leader_path": LEADER_PATH,
    **EACH,
}
SWITCHES = {"chain", "demo", "rviz", "publish_tf", "record", "use_sim_time", "use_respawn"}
SWITCHES |= {"one_process", "simulator", "use_leader_odometry", "draw_sea"}
OF_LAUNCH = "sigterm_timeout", "sigkill_timeout"
CHOICES = {name: [*YES, *NO] for name in SWITCHES}
CHOICES["demo"] += ["follower", "leader"]
CHOICES["log_level"] = [*LEVELS, *map(str.upper, LEVELS)]


def declared(arguments: Mapping[str, tuple[str, str]]) -> list[Any]:
    """Return the actions of a launch file that declare its arguments, and what each may be."""
    from launch.actions import DeclareLaunchArgument  # of a ROS installation

    actions = []
    for name, (default, text) in arguments.items():
        words = CHOICES.get(name)
        if words and not default:
            words = [*words, ""]
        actions.append(
            DeclareLaunchArgument(name, default_value=default, description=text, choices=words)
        )
    return actions


def parsed(name: str, text: str) -> Any:
    """Return the value of an argument that is YAML; ValueError, which names it, for what is not."""
    try:
        return yaml_text.parse(text)
    except ValueError as reason:
        raise ValueError(f"{name}: {reason}") from None


def unknown(file: str, arguments: Mapping[str, tuple[str, str]], words: Sequence[str]) -> list[str]:
    """Return a warning for each ``name:=value`` without an argument; ros2 launch gives none.

    - file: the launch file; `words` are asked only where they start this one itself.
    - words: of the command line.
    """
    if Path(file).name not in (Path(word).name for word in words):
        return []
    known = [*arguments, *OF_LAUNCH]
    said = []
    for name in (word.partition(":=")[0] for word in words if ":=" in word):
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            cure = f"did you mean {near[0]}?" if near else "nodes' parameters go into params_file"
            said.append(f"{name}: {Path(file).name} has no such argument and ignores it; {cure}")
    return said


def log_unknown(file: str, arguments: Mapping[str, tuple[str, str]]) -> list[Any]:
    """Return actions that log what this launch file ignores of the command line."""
    from launch.actions import LogInfo  # of a ROS installation

    return [LogInfo(msg=f"[WARN] {text}") for text in unknown(file, arguments, sys.argv)]


def enclave(namespace: str, executable: str) -> str:
    """Return the path of an executable's enclave, below that of its namespace, ``/`` or empty."""
    return "/".join(["", PACKAGE, *filter(None, namespace.split("/")), executable])
