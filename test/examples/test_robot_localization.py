"""The filters of the example configurations, run by robot_localization where it is installed."""

import contextlib
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.time import Time
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.storage import files

try:
    EKF = Path(get_package_prefix("robot_localization"), "lib/robot_localization/ekf_node")
    from tf2_msgs.msg import TFMessage
except (PackageNotFoundError, OSError, ImportError):
    EKF = None
pytestmark = pytest.mark.skipif(
    EKF is None, reason="robot_localization is not installed: no filter was run"
)

STDS = np.array([0.1, 0.05, 0.05, 0.02, 0.02, 0.02])
RATE_STDS = np.array([0.05, 0.05, 0.05, 0.02, 0.02, 0.02])
# The survey of the station, as the example has it, and the lamp on its body.
STATION, STATION_TURN = np.array([10.0, 4.0, -20.0]), Rotation.from_euler("z", 1.5)
LAMP = np.array([-0.7, 0.0, 0.1])


@contextlib.contextmanager
def filtering(example):
    """Run the filter with an example's settings."""
    path = files.shared_file(f"config/examples/{example}")
    command = [EKF, "--ros-args", "-r", "__node:=ekf_filter_node", "--params-file", path]
    process = subprocess.Popen(command)
    try:
        yield yaml.safe_load(path.read_text(encoding="utf-8"))["/**/ekf_filter_node"]
    finally:
        process.terminate()
        process.wait()


def behind(second):
    """Return where the follower is in the frame of the lamp."""
    turn = 2 * np.pi * second / 20
    place = np.array([-6 + 0.5 * np.sin(turn), 0.4 * np.cos(turn), 0.1 * np.sin(turn)])
    return place, Rotation.from_euler("ZYX", [0.2 * np.sin(turn), 0.05 * np.cos(turn), 0.0])


def fill(place, turn, vector, quaternion):
    vector.x, vector.y, vector.z = place.tolist()
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = turn.as_quat().tolist()


def measured(kind, second, stamp, rng):
    """Return a noisy message of what is published, roll and its rate as of a track without IMU."""
    message = kind()
    message.header.stamp, message.header.frame_id = stamp.to_msg(), "leader/beacon"
    place, turn = behind(second)
    noise = STDS * rng.standard_normal(6) * [1, 1, 1, 0, 1, 1]
    turned, pose = turn * Rotation.from_rotvec(noise[3:]), message.pose.pose
    fill(place + noise[:3], turned, pose.position, pose.orientation)
    message.pose.covariance = np.diag(STDS**2).ravel().tolist()
    if kind is Odometry:
        message.child_frame_id = "base_link_by_light"
        (before, first), (after, last) = behind(second - 0.01), behind(second + 0.01)
        rates = np.concatenate([turn.inv().apply(after - before), (first.inv() * last).as_rotvec()])
        rates = rates / 0.02 + RATE_STDS * rng.standard_normal(6) * [1, 1, 1, 0, 1, 1]
        twist = message.twist.twist
        twist.linear.x, twist.linear.y, twist.linear.z = rates[:3].tolist()
        twist.angular.x, twist.angular.y, twist.angular.z = rates[3:].tolist()
        message.twist.covariance = np.diag(RATE_STDS**2).ravel().tolist()
    return message


def transform(parent, child, stamp, place, turn):
    found = TransformStamped()
    found.header.stamp, found.header.frame_id, found.child_frame_id = stamp.to_msg(), parent, child
    fill(place, turn, found.transform.translation, found.transform.rotation)
    return found


@pytest.mark.parametrize(
    ("example", "kind", "topic"),
    [
        ("robot_localization_odometry.yaml", Odometry, "relative_odometry"),
        ("robot_localization_pose.yaml", PoseWithCovarianceStamped, "relative_pose"),
    ],
)
def test_the_filter_of_an_example_is_where_the_follower_is(lab, example, kind, topic):
    rng = np.random.default_rng(5)
    lab.begin()
    with filtering(example) as settings:
        talker, heard = lab.talk(kind, topic), lab.listen(Odometry, "odometry/filtered")
        tree = lab.talk(TFMessage, "/tf")
        lab.until(
            lambda: talker.get_subscription_count() and tree.get_subscription_count(),
            "the filter to listen",
        )
        clock = lab.probe.get_clock()
        start = clock.now()
        for k in range(80):
            due = start + Duration(nanoseconds=k * 10**8)
            lab.until(lambda due=due: clock.now() >= due, "the next image")
            # The station at rest is on the map, and dead reckoning is off by 3 m.
            body, turn = behind(k / 10)
            beacon = STATION + STATION_TURN.apply(LAMP)
            body, turn = beacon + STATION_TURN.apply(body) + 3.0, STATION_TURN * turn
            transforms = [
                transform("map", "leader/base_link", due, STATION, STATION_TURN),
                transform("leader/base_link", "leader/beacon", due, LAMP, Rotation.identity()),
                transform("odom", "follower/base_link", due, body, turn),
            ]
            tree.publish(TFMessage(transforms=transforms))
            talker.publish(measured(kind, k / 10, due, rng))
        lab.until(lambda: after(heard[-1], start) >= 7.9, "the filter's last answer")
    assert heard[-1].child_frame_id == settings["ros__parameters"]["base_link_frame"]
    late = [message for message in heard if after(message, start) > 4]
    assert len(late) > 100  # at the rate of the filter, not of the images
    for message in late:
        place, turn = behind(after(message, start))
        if message.header.frame_id == "map":
            place = STATION + STATION_TURN.apply(LAMP + place)
            turn = STATION_TURN * turn
        else:
            assert message.header.frame_id == "leader/beacon"
        pose = message.pose.pose
        found = Rotation.from_quat([getattr(pose.orientation, axis) for axis in "xyzw"])
        off = [pose.position.x, pose.position.y, pose.position.z] - place
        np.testing.assert_allclose(off, 0, atol=0.25)
        assert (turn.inv() * found).magnitude() < 0.1
        stds = np.sqrt(np.array(message.pose.covariance)[::7])
        assert (stds < 0.2).all()  # of the roll, if nothing told it, 0.35 rad and more


def after(message, start):
    return (Time.from_msg(message.header.stamp) - start).nanoseconds * 1e-9
