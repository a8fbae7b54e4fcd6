"""Frames: names with a prefix, axes by name, and one tree that holds every frame."""

import numpy as np
import pytest
from asker import Asker, place_of, twist_of
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array.core.messages import stamp_ns, twist_from_message
from uuv_optical_array.nodes import estimator_node, simulator_node, vehicles_node
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared.messages import (
    covariance_from_message,
    inverse_to_message,
    odometry_to_message,
    pose_from_message,
    pose_to_message,
    twist_to_message,
)

# North, east and down of what points forward, left and up; so of both the world and the body.
DOWN = np.diag([1.0, -1.0, -1.0])
lengths, angles = st.floats(-50, 50), st.floats(-1.5, 1.5)
poses = st.tuples(lengths, lengths, lengths, angles, angles).map(np.array)


def xyz(pose):
    return pose.position.x, pose.position.y, pose.position.z


def rotation_of(message):
    return Rotation.from_quat(place_of(message)[1]).as_matrix()


def rotation_in_flu(pose, roll):
    return Rotation.from_euler("ZYX", [pose[4], pose[3], roll]).as_matrix()


@given(poses, angles, st.sampled_from(["dock", "dock_ned"]))
def test_a_pose_survives_the_message_in_the_axes_of_its_frame(pose, roll, frame):
    root = np.random.default_rng(3).normal(size=(6, 6))
    covariance = root @ root.T
    header = Header(stamp=Time(sec=3, nanosec=4), frame_id=frame)
    message = pose_to_message(pose, covariance, header, roll)
    assert message.header == header
    axes = DOWN if frame.endswith("_ned") else np.eye(3)  # north, east and down
    np.testing.assert_allclose(place_of(message)[0], axes @ pose[:3], atol=1e-12)
    expected = axes @ rotation_in_flu(pose, roll) @ axes
    np.testing.assert_allclose(rotation_of(message), expected, atol=1e-9)
    both = np.kron(np.eye(2), axes)
    sent = np.reshape(message.pose.covariance, (6, 6))
    np.testing.assert_allclose(sent, both @ covariance @ both.T)
    np.testing.assert_allclose(pose_from_message(message), pose, atol=1e-9)
    np.testing.assert_allclose(covariance_from_message(message), covariance)


@pytest.mark.parametrize(
    ("parent", "child", "named", "down"),
    [
        ("leader/beacon", "rov", "rov", False),
        ("dock_ned", "rov", "rov_frd", True),
        ("dock_ned", "rov_frd", "rov_frd", True),
    ],
)
def test_a_twist_is_in_the_axes_of_the_frame_that_it_names(parent, child, named, down):
    pose = pose_to_message(np.zeros(5), np.eye(6), Header(frame_id=parent))
    root = np.random.default_rng(3).normal(size=(6, 6))
    message = odometry_to_message(pose, child, np.arange(1.0, 7.0), root @ root.T)
    assert message.child_frame_id == named
    both = np.kron(np.eye(2), DOWN) if down else np.eye(6)
    np.testing.assert_allclose(twist_of(message.twist.twist), both @ np.arange(1.0, 7.0))
    spread = np.reshape(message.twist.covariance, (6, 6))
    np.testing.assert_allclose(spread, both @ root @ root.T @ both.T)


@given(arrays(float, 6, elements=st.floats(-6.0, 6.0)), st.sampled_from(["rov", "rov_frd"]))
def test_a_command_survives_the_message_in_the_axes_of_its_frame(values, frame):
    message = twist_to_message(values[:3], values[3:], Header(frame_id=frame))
    assert message.header.frame_id == frame
    both = np.kron(np.eye(2), DOWN if frame.endswith("_frd") else np.eye(3))
    np.testing.assert_array_equal(twist_of(message.twist), both @ values)
    np.testing.assert_array_equal(np.concatenate(twist_from_message(message)), values)


@given(poses, angles)
def test_the_leader_seen_from_the_follower_is_the_inverse(pose, roll):
    message = inverse_to_message(pose, Header(frame_id="follower/base_link"), roll)
    turn, seen = message.pose.orientation, np.eye(4)
    seen[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    seen[:3, 3] = xyz(message.pose)
    own = np.eye(4)
    own[:3, :3], own[:3, 3] = rotation_in_flu(pose, roll), pose[:3]
    np.testing.assert_allclose(own @ seen, np.eye(4), atol=1e-8)


def test_the_leaders_pose_has_the_frame_of_the_follower_and_the_stamp_of_the_image(lab, scene_file):
    asker = Asker(lab, scene_file, beacon_frame="dock_ned", base_frame="rov")
    leaders = lab.listen(PoseStamped, "leader_pose")
    lab.connect()
    pose = asker.ask(np.array([0.5, 0.1, 0.0, 0.0, 0.0]), 3)
    leader = lab.answer(leaders, pose.header.stamp, "the leader's pose")
    assert (pose.header.frame_id, leader.header.frame_id) == ("dock_ned", "rov")
    # In REP 103 axes, whatever those of the beacon: ahead.
    turn = DOWN @ rotation_of(pose) @ DOWN
    expected = -turn.T @ DOWN @ place_of(pose)[0]
    np.testing.assert_allclose(xyz(leader.pose), expected, atol=1e-9)
    assert leader.pose.position.x > 3


class Tree:
    """Frames as they were placed: each by its parent, its pose there, and whether for good."""

    def __init__(self, monkeypatch):
        self.frames, self.poses = {}, {}
        for module in (estimator_node, simulator_node, vehicles_node):
            monkeypatch.setattr(module, "transform_publisher", self.publisher)

    def publisher(self, node, wanted, fixed=False):
        def place(header, child, pose):
            assert wanted
            self.poses[child, stamp_ns(header)] = pose
            before = self.frames.setdefault(child, (header.frame_id, fixed, pose, node))
            assert before[0] == header.frame_id, "two parents"
            assert before[3] is node, "two nodes place it"

        return place

    def roots(self):
        return {parent for parent, *_ in self.frames.values()} - set(self.frames)


def test_all_frames_are_one_tree_and_have_the_prefix(lab, scene_file, monkeypatch):
    tree = Tree(monkeypatch)
    given = {"method": "sam", "beacon_position_m": [-0.7, 0.1, 0.2]}
    lab.begin({"scene": scene_file, "frame_prefix": "two/", "publish_tf": True, **given})
    heard = {
        topic: lab.listen(kind, topic)
        for topic, kind in {
            "leader/odometry": Odometry,
            "follower/odometry": Odometry,
            "array/image": Image,
            "relative_pose": PoseWithCovarianceStamped,
            "relative_odometry": Odometry,
            "leader_pose": PoseStamped,
            "cmd_vel": TwistStamped,
        }.items()
    }
    for node_type in (
        vehicles_node.VehiclesNode,
        simulator_node.SimulatorNode,
        FeatureNode,
        estimator_node.EstimatorNode,
        FormationNode,
    ):
        lab.start(node_type)
    lab.until(lambda: all(heard.values()), "every topic")
    assert {topic: messages[0].header.frame_id for topic, messages in heard.items()} == {
        "leader/odometry": "two/odom",
        "follower/odometry": "two/odom",
        "array/image": "two/follower/array",
        "relative_pose": "two/leader/beacon",
        "relative_odometry": "two/leader/beacon",
        "leader_pose": "two/follower/base_link",
        "cmd_vel": "two/follower/base_link",
    }
    lab.until(lambda: "two/base_link_by_light" in tree.frames, "the pose")
    assert {child: placed[:2] for child, placed in tree.frames.items()} == {
        "two/leader/base_link": ("two/odom", False),
        "two/follower/base_link": ("two/odom", False),
        "two/leader/beacon": ("two/leader/base_link", True),
        "two/base_link_by_light": ("two/leader/beacon", False),
        "two/follower/array": ("two/follower/base_link", True),
    }
    assert tree.roots() == {"two/odom"}
    for message in heard["leader/odometry"] + heard["follower/odometry"]:
        placed = tree.poses[message.child_frame_id, stamp_ns(message.header)]
        assert placed == message.pose.pose
    lamp, bow = (tree.frames[f"two/{name}"][2] for name in ("leader/beacon", "follower/array"))
    assert xyz(lamp) == (-0.7, 0.1, 0.2)
    assert xyz(bow) == (0.4, 0.0, 0.0)
    assert lamp.orientation == bow.orientation == type(lamp.orientation)(w=1.0)


def test_poses_go_to_tf_and_the_lamp_to_who_listens_late_too(lab, scene_file):
    tf2_msgs = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not installed")
    names = {"beacon_frame": "dock/beacon", "tf_child_frame": "rov/base_link_by_light"}
    asker = Asker(lab, scene_file, publish_tf=True, **names)
    moving = lab.listen(tf2_msgs.TFMessage, "/tf")
    fixed = lab.listen_late(tf2_msgs.TFMessage, "/tf_static")
    lab.connect()
    pose = asker.ask(np.array([0.5, 0.1, 0.0, 0.0, 0.0]), 5)
    (placed,) = lab.until(lambda: moving, "a transform")[0].transforms
    assert (placed.header, placed.child_frame_id) == (pose.header, names["tf_child_frame"])
    t, q = placed.transform.translation, placed.transform.rotation
    assert ([t.x, t.y, t.z], [q.x, q.y, q.z, q.w]) == place_of(pose)
    (lamp,) = lab.until(lambda: fixed, "the lamp")[0].transforms
    assert (lamp.header.frame_id, lamp.child_frame_id) == ("leader/base_link", "dock/beacon")


def test_below_the_follower_the_leader_hangs_where_it_is_seen(lab, scene_file, monkeypatch):
    tree = Tree(monkeypatch)
    given = {"publish_tf": True, "tf_parent": "base", "beacon_position_m": [-0.7, 0.1, 0.2]}
    asker = Asker(lab, scene_file, **given)
    asker.ask(np.array([0.5, 0.1, 0.0, 0.0, 0.0]), 3)
    lab.until(lambda: len(tree.frames) == 2, "both frames")
    beacon, body = tree.frames["leader/beacon"], tree.frames["leader/base_link"]
    assert beacon[:2] == ("follower/base_link", False)
    assert body[:2] == ("leader/beacon", True)
    assert beacon[2].position.x > 3
    assert xyz(body[2]) == (0.7, -0.1, -0.2)


@pytest.mark.parametrize(
    "given",
    [
        {"tf_child_frame": "rov_frd"},
        {"base_frame": "rov_frd", "tf_parent": "base"},
        {"beacon_frame": "dock_ned", "tf_parent": "base"},
    ],
)
def test_a_pose_between_frames_of_different_axes_is_refused_by_name(lab, scene_file, given):
    lab.begin({"scene": scene_file, "method": "sam", **given})
    with pytest.raises(ValueError, match="does not have the axes of beacon_frame"):
        estimator_node.EstimatorNode()


@pytest.mark.parametrize(
    ("given", "placed"),
    [
        ({"beacon_frame": "/dock", "leader_frame": "/station"}, ("station", "dock")),
        ({"beacon_frame": "dock_ned"}, ("two/leader/base_link", "two/dock_ned")),
        ({"leader_frame": ""}, None),
    ],
)
def test_the_lamp_is_placed_on_the_leader_in_its_axes(lab, scene_file, monkeypatch, given, placed):
    tree = Tree(monkeypatch)
    given = {"frame_prefix": "two/", "publish_tf": True, **given}
    given["beacon_position_m"] = [1.0, 2.0, 3.0]
    lab.begin({"scene": scene_file, "method": "sam", **given})
    lab.start(estimator_node.EstimatorNode)
    if placed is None:
        assert not tree.frames
        return
    ((child, (parent, fixed, pose, _)),) = tree.frames.items()
    assert (parent, child, fixed) == (*placed, True)
    assert xyz(pose) == (1.0, 2.0, 3.0)
    q = pose.orientation
    turned = DOWN if child.endswith("_ned") else np.eye(3)
    found = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    np.testing.assert_allclose(found, turned, atol=1e-12)
