"""The example that listens prints what is published, in a process of its own."""

import subprocess
import sys
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.qos import DurabilityPolicy, QoSProfile

LISTEN = Path(__file__).parents[2] / "examples" / "listen.py"


def test_poses_and_states_are_printed(lab, tmp_path):
    lab.begin()
    lasting = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    states = lab.probe.create_publisher(DiagnosticStatus, "follow_state", lasting)
    poses = lab.probe.create_publisher(PoseWithCovarianceStamped, "relative_pose", 1)
    why = KeyValue(key="reason", value="no pose has come yet")
    states.publish(DiagnosticStatus(message="waiting", values=[why]))
    pose = PoseWithCovarianceStamped()
    place = pose.pose.pose.position
    place.x, place.y, place.z = -4.5, 0.25, -0.1
    pose.pose.covariance[0], pose.pose.covariance[7], pose.pose.covariance[14] = 0.04, 0.01, 0.0025
    printed = tmp_path / "printed"
    with printed.open("w") as file:
        process = subprocess.Popen([sys.executable, "-u", LISTEN], stdout=file)
        try:

            def heard():
                poses.publish(pose)  # until they have found each other
                return len(set(printed.read_text("utf-8").splitlines())) == 2

            lab.until(heard, "a pose and a state")
        finally:
            process.terminate()
            code = process.wait()
    assert code == 0
    assert set(printed.read_text("utf-8").splitlines()) == {
        "waiting: no pose has come yet",
        "x  -4.50 +- 0.20, y  0.25 +- 0.10, z -0.10 +- 0.05 m",
    }
