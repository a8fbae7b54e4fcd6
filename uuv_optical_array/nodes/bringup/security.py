"""What each process of the nodes may say and hear: a policy for SROS2.

``python -m uuv_optical_array.nodes.bringup.security`` prints the policy of the nodes as they run
with its arguments, such as ``--ros-args -p use_imu:=true``. Each executable has its own enclave.
"""

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any
from xml.etree import ElementTree

import rclpy
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String
from std_srvs.srv import SetBool

from uuv_optical_array.core.extras import NotInstalled
from uuv_optical_array.core.storage.files import shared_file
from uuv_optical_array.nodes.bringup.launch_arguments import enclave
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.follower_node import follower
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared.node import start
from uuv_optical_array.nodes.simulator_node import SimulatorNode
from uuv_optical_array.nodes.vehicles_node import VehiclesNode
from uuv_optical_array.recording.bag import RUN

VERSION = "0.2.0"  # of the policy's schema
# Services of rosbag2's recorder in Lyrical and Jazzy; Kilted has the first four, Humble none.
RECORDER = ["pause", "resume", "is_paused", "split_bagfile", "record", "stop"]
RECORDER += ["start_discovery", "stop_discovery", "is_discovery_running"]
LISTENER = "transform_listener_impl_"  # tf2's own node, to whose name it adds an address


def view() -> list[Node]:
    """Return the live view, which needs an extra, as no other node does."""
    from uuv_optical_array.nodes.view_node import ViewNode

    return [ViewNode()]


class Other(Node):
    """Stands for the node of another program; a policy does not name the types of what it says."""

    def __init__(self, name: str, heard: Iterable[str], **options: Any) -> None:
        super().__init__(name, **options)
        self.create_subscription(ParameterEvent, "/parameter_events", print, 1)
        for topic in heard:
            self.create_subscription(String, topic, print, 1)


def rviz() -> list[Node]:
    """Return RViz, as the launch files start it, and the node by which it hears /tf."""
    texts = [
        shared_file(f"rviz/{name}.rviz").read_text(encoding="utf-8")
        for name in ("follow", "formation")
    ]
    topics = {topic for text in texts for topic in re.findall(r"Topic:\n +Value: (\S+)", text)}
    window = Other("rviz", topics)
    window.create_service(SetBool, "~/reset_time", print)
    listener = Other(LISTENER, ["/tf", "/tf_static"], start_parameter_services=False)
    return [window, listener]


def recorder() -> list[Node]:
    """Return rosbag2's recorder, which is in no namespace, as follow.launch.py starts it."""
    node = Other("rosbag2_recorder", map(_resolved, RUN), use_global_arguments=False)
    for event in ("write_split", "rosbag2_messages_lost"):
        node.create_publisher(String, f"/events/{event}", 1)
    for verb in RECORDER:
        node.create_service(SetBool, f"~/{verb}", print)
    return [node]


def _resolved(name: str) -> str:
    """Return a name as the arguments place and remap it."""
    node = Node("lookout")
    try:
        return node.resolve_topic_name(name)
    finally:
        node.destroy_node()


PROCESSES: Mapping[str, Callable[[], Iterable[Node]]] = {
    "simulator_node": lambda: [SimulatorNode()],
    "feature_node": lambda: [FeatureNode()],
    "estimator_node": lambda: [EstimatorNode()],
    "formation_node": lambda: [FormationNode()],
    "vehicles_node": lambda: [VehiclesNode()],
    "follower_node": follower,
    "view_node": view,
    "rviz2": rviz,
    "ros2_bag": recorder,
}
CLOCK = "/clock"  # which nodes hear that use simulated time


def policy(processes: Mapping[str, Callable[[], Iterable[Node]]] = PROCESSES) -> str:
    """Return the policy that allows nodes what they declare, and no more, as XML.

    ROS has been started. An executable that lacks an extra is left out; standard error says so.
    """
    root = ElementTree.Element("policy", version=VERSION)
    space = _resolved("name").rpartition("/")[0]
    enclaves = ElementTree.SubElement(root, "enclaves")
    for executable, make in processes.items():
        try:
            nodes = list(make())
        except NotInstalled as reason:
            print(f"{executable} is left out: {reason}", file=sys.stderr)
            continue
        path = enclave(space, executable)
        profiles = ElementTree.SubElement(
            ElementTree.SubElement(enclaves, "enclave", path=path), "profiles"
        )
        for node in nodes:
            _add_profile(profiles, node)
            node.destroy_node()
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n'


def _add_profile(profiles: ElementTree.Element, node: Node) -> None:
    name, space = node.get_name(), node.get_namespace()
    others = "*" if name == LISTENER else ""
    profile = ElementTree.SubElement(profiles, "profile", ns=space, node=f"{name}{others}")
    said = node.get_publisher_names_and_types_by_node(name, space)
    heard = [(CLOCK, []), *node.get_subscriber_names_and_types_by_node(name, space)]
    served = node.get_service_names_and_types_by_node(name, space)
    for group, rule, entries in (
        ("topics", "publish", said),
        ("topics", "subscribe", heard),
        ("services", "reply", served),
    ):
        if not entries:
            continue
        parent = ElementTree.SubElement(profile, group, {rule: "ALLOW"})
        own = f"{node.get_fully_qualified_name()}/"
        paths = {re.sub(f"^{own}", "~/", path) for path, _ in entries}
        if group == "services" and all(path.startswith("~/") for path in paths):
            paths = {"~/*"}  # one rule: Fast DDS's handshake has no room for long permissions
        for path in sorted(paths):
            ElementTree.SubElement(parent, group[:-1]).text = path


def main(args: list[str] | None = None) -> None:
    """Print the policy."""
    os.environ["ROS_SECURITY_ENABLE"] = "false"  # no enclave is needed to print what one allows
    given = sys.argv[1:] if args is None else args
    usage = "python3 -m uuv_optical_array.nodes.bringup.security [-h] [--ros-args ...]"
    try:
        # Nodes say of themselves what counts when they run.
        start(["--ros-args", "--log-level", "warn", "--", *given])
        parser = argparse.ArgumentParser(usage=usage, description=__doc__)
        parser.parse_args(remove_ros_args(given))
        print(policy(), end="")
    except ValueError as error:
        sys.exit(str(error))
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
