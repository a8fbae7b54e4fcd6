"""What leaves a node: finite numbers, and stamps that never run backwards."""

import functools
import itertools

import numpy as np
import pytest
from asker import Asker
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, TwistStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from uuv_optical_array.core.messages import Refused
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared.messages import (
    StampOrder,
    features_to_message,
    not_finite,
    pose_to_message,
)

WARN = DiagnosticStatus.WARN


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("message_type", "path"),
    [
        (PoseWithCovarianceStamped, "pose.pose.position.z"),
        (PoseWithCovarianceStamped, "pose.pose.orientation.w"),
        (PoseWithCovarianceStamped, "pose.covariance"),
        (TwistStamped, "twist.angular.x"),
        (TransformStamped, "transform.translation.y"),
        (Odometry, "pose.pose.position.x"),
        (Odometry, "twist.covariance"),
    ],
)
def test_a_number_that_is_not_finite_is_found_wherever_it_is(message_type, path, bad):
    message = message_type()
    assert not_finite(message) == ""
    *groups, name = path.split(".")
    inner = functools.reduce(getattr, groups, message)
    if name == "covariance":
        inner.covariance[35] = bad
    else:
        setattr(inner, name, bad)
    assert not_finite(message) == path


def test_a_key_parameter_that_is_not_finite_is_found_and_images_and_empty_clouds_pass():
    assert not_finite(features_to_message(np.array([1, 2, np.nan, 4, 5]), Header())) == "data"
    assert not_finite(features_to_message(np.arange(5.0), Header())) == ""
    assert not_finite(features_to_message(None, Header())) == ""
    assert not_finite(PointCloud2()) == ""
    assert not_finite(Image(data=b"\xff" * 8)) == ""


def test_a_frame_within_a_list_is_looked_into_too():
    tf2_msgs = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not installed")
    message = tf2_msgs.TFMessage(transforms=[TransformStamped(), TransformStamped()])
    message.transforms[1].transform.rotation.z = np.nan
    assert not_finite(message) == "transforms.transform.rotation.z"


def test_a_command_that_is_not_finite_is_held_back_and_told(lab, monkeypatch):
    lab.begin({"use_sim_time": True})
    node = lab.start(FormationNode)
    poses = lab.talk(Odometry, "relative_odometry")
    commands = lab.listen(TwistStamped, "cmd_vel")
    lab.connect()
    lab.tick(100 * 10**9)
    header = Header(stamp=Time(sec=100), frame_id="leader/beacon")
    station = pose_to_message(np.array([-6.0, 0, 0, 0, 0]), np.eye(6), header)
    lab.deliver(node, poses, Odometry(header=station.header, pose=station.pose))
    with monkeypatch.context() as patch:
        broken = np.array([0.0, np.nan, 0.0]), np.zeros(3)
        patch.setattr(node.controller, "command", lambda now: broken)
        lab.tick(100_200_000_000)
        lab.report(node, WARN, "not finite: twist.linear.y of /cmd_vel")
    lab.tick(100_400_000_000)
    lab.answer(commands, Time(sec=100, nanosec=400_000_000), "a command")
    assert len(commands) == 1


def passed(stamps):
    order, through = StampOrder(), []
    for stamp in stamps:
        header = Header(stamp=Time(sec=stamp // 10**9, nanosec=stamp % 10**9))
        try:
            order.check(header)
            through.append(stamp)
        except Refused:
            pass
    return through


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        ([10.0, 9.8, 9.9, 10.1], [10.0, 10.1]),
        ([10.0, 9.0, 9.1, 9.2, 9.9, 10.0, 10.1], [10.0, 10.1]),
        ([10.0, 8.0, 10.1, 8.1, 10.2], [10.0, 10.1, 10.2]),
        ([10.0, 8.0, 8.1, 8.2], [10.0, 8.1, 8.2]),
        ([10.0, 8.0, 7.9, 8.0], [10.0, 8.0]),
        ([10.0, 900.0, 10.1, 10.2, 10.3], [10.0, 900.0, 10.2, 10.3]),
    ],
    ids=["two late", "many late", "far behind by turns", "set back", "set back twice", "stray"],
)
def test_late_stamps_are_dropped_and_a_clock_that_was_set_back_starts_anew(stamps, expected):
    assert passed([round(1e9 * s) for s in stamps]) == [round(1e9 * s) for s in expected]


def test_one_stamp_ahead_of_the_clock_is_dropped_and_a_clock_that_is_always_ahead_is_believed():
    def ages(*ahead_s):
        order, through = StampOrder(), []
        for i, ahead in enumerate(ahead_s):
            header = Header(stamp=Time(sec=100 + i, nanosec=round(1e9 * ahead)))
            try:
                order.check(header, (100 + i) * 10**9)
                through.append(i)
            except Refused as reason:
                told.append(str(reason))
        return through

    told = []
    assert ages(0.0, 0.9, 0.0, 0.0, 0.29) == [0, 2, 3, 4]
    assert told == ["stamp ahead: 0.9 s later than the clock"]
    assert ages(0.9, 0.9, 0.4) == [0, 1, 2]
    assert ages(0.0, 0.9, 0.9, 0.9, 0.0, 0.5) == [0, 2, 3, 4]


@given(st.lists(st.integers(0, 4_000_000_000)))
def test_stamps_run_back_only_by_more_than_a_second_and_never_twice_at_once(stamps):
    through = passed(stamps)
    for before, after in itertools.pairwise(through):
        assert after > before or before - after > 10**9


def test_tracked_poses_do_not_run_backwards_and_a_clock_that_was_set_back_starts_anew(
    lab, scene_file, scene
):
    asker = Asker(lab, scene_file, tracking=True, buffer_s=5.0)
    rng = np.random.default_rng(4)
    images = ForwardModel(scene).expose(np.tile([-6.0, 0.1, 0.1, 0, 0], (12, 1)), rng)
    signatures = key_parameters(images, scene.full_scale_counts, scene.signature.peak)
    for signature, seconds in zip(signatures, [100, 102, 101, 103, 50, 51, 52], strict=False):
        lab.deliver(asker.node, asker.clouds, asker.message(signature, seconds))
    lab.until(lambda: 52 in asker.seconds_answered(), "the last pose")
    assert asker.seconds_answered() == [100, 102, 103, 51, 52]
    lab.report(asker.node, WARN, "late frame", "stamp not later: 50.0")
