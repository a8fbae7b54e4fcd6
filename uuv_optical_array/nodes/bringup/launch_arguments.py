"""Arguments of the launch files, each with its default and its meaning, and enclaves of SROS2.

Empty means: not given, so that neither a file's value nor a node's default is replaced.
"""

from collections.abc import Mapping
from typing import Any

from uuv_optical_array.core.storage.files import PACKAGE

YES, NO = ("true", "True", "1"), ("false", "False", "0")
SCENE = "ready scene's name or a YAML file: lamp, water, array, electronics"
COMMON = {
    "params_file": ("", "your parameters; what they leave out keeps its default"),
    "use_sim_time": ("", "whether the nodes use simulated time, from /clock"),
    "use_respawn": (
        "false",
        "whether a node that dies is started again; without, the launch ends with it",
    ),
    "rviz": ("false", "whether RViz opens"),
    "rviz_config": ("", "what RViz shows: a file of its own kind"),
    "publish_tf": ("", "whether the poses go to /tf too; with rviz they do unless told not to"),
    "log_level": ("", "least severity that is logged: debug, info, warn or error"),
}
FOLLOW = {
    "scene": ("", SCENE),
    "namespace": ("", "of the follower's nodes"),
    "frame_prefix": ("", "set before each frame, such as `rov_2/`"),
    "leader_frame": ("", "the leader's frame on /tf"),
    "one_process": (
        "false",
        "whether feature, estimator and formation node share a process, follower_node",
    ),
    "simulator": ("true", "whether simulator_node makes the images; not where an array does"),
    "leader_odometry": (
        "leader/odometry",
        "topic of the leader's odometry, for followers that share a leader",
    ),
    "demo": (
        "true",
        "whether the two demo vehicles run, or which: follower, without a leader of its own, or "
        "leader, without any node of a follower",
    ),
    "followers": ("1", "how many followers a leader alone waits for"),
    "station": ("", "of the follower, [x, y, z] in the lamp's frame, m"),
    "record": ("false", "whether rosbag2 records the topics of the run, as MCAP"),
    "bag": ("", "folder of the record, a new one; without, rosbag2 names one by the time"),
    **COMMON,
}
FOLLOWER = {  # what follower.launch.py has instead
    **{name: ("false", FOLLOW[name][1]) for name in ("demo", "simulator")},
    "one_process": ("true", FOLLOW["one_process"][1]),
}
EACH = {  # what the launch of each vehicle of a formation gets
    "scene": ("formation", SCENE),
    "one_process": ("true", "whether three nodes of each follower share a process, follower_node"),
    **COMMON,
}
FORMATION = {
    "followers": ("3", "how many followers"),
    "chain": (
        "true",
        "whether the third and later ones are lit from a follower ahead, not by the leader",
    ),
    "namespace": ("", "of the whole formation"),
    **EACH,
}
SWITCHES = {"chain", "demo", "rviz", "publish_tf", "record", "use_sim_time", "use_respawn"}
SWITCHES |= {"one_process", "simulator"}


def declared(arguments: Mapping[str, tuple[str, str]]) -> list[Any]:
    """Return the actions of a launch file that declare its arguments, and what each may be."""
    from launch.actions import DeclareLaunchArgument  # of a ROS installation

    actions = []
    for name, (default, text) in arguments.items():
        others = ["follower", "leader"] if name == "demo" else []
        words = [*YES, *NO, *others, *([] if default else [""])] if name in SWITCHES else None
        actions.append(
            DeclareLaunchArgument(name, default_value=default, description=text, choices=words)
        )
    return actions


def enclave(namespace: str, executable: str) -> str:
    """Return the path of an executable's enclave, below that of its namespace, ``/`` or empty."""
    return "/".join(["", PACKAGE, *filter(None, namespace.split("/")), executable])
