"""``ros2 launch`` and ``ros2 run`` as a user types them, and Ctrl-C."""

import os
import shutil
import signal
import subprocess
import time

import pytest
import rclpy
from conftest import PATIENCE_S
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.qos import qos_profile_sensor_data


def why_not():
    """Say why ros2 cannot start the package here, or nothing where it can."""
    if shutil.which("ros2") is None:
        return "ros2 is not installed, so nothing to type"
    found = subprocess.run(
        ["ros2", "pkg", "prefix", "uuv_optical_array"], capture_output=True, check=False
    )
    return "the package is in no ROS workspace: ros2 cannot find it" if found.returncode else ""


WHY_NOT = why_not()
pytestmark = pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)


def group_is_gone(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


def test_ctrl_c_leaves_no_process_of_ros2_launch(tmp_path):
    with (tmp_path / "log").open("w") as log:
        launched = subprocess.Popen(
            ["ros2", "launch", "uuv_optical_array", "follow.launch.py", "scene:=reference"],
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    rclpy.init()
    try:
        node, poses = rclpy.create_node("onlooker"), []
        node.create_subscription(
            PoseWithCovarianceStamped, "relative_pose", poses.append, qos_profile_sensor_data
        )
        deadline = time.monotonic() + PATIENCE_S
        while not poses and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.2)
    finally:
        rclpy.try_shutdown()
        # A terminal sends Ctrl-C to the whole group.
        os.killpg(launched.pid, signal.SIGINT)
        code = launched.wait(timeout=PATIENCE_S)
    text = (tmp_path / "log").read_text()
    assert poses, text
    assert code == 0, text
    assert "Traceback" not in text
    assert group_is_gone(launched.pid), text


@pytest.mark.parametrize("node", ["simulator", "feature", "estimator", "formation", "vehicles"])
def test_ros2_run_refuses_a_bad_start_value_in_one_line(node):
    bad = {
        "simulator": ("max_gap_s", "-1.0"),
        "feature": ("min_peak_counts", "-1.0"),
        "estimator": ("max_angle_rad", "9.0"),
        "formation": ("stand_off_m", "-6.0"),
        "vehicles": ("rate_hz", "0.0"),
    }[node]
    command = ["ros2", "run", "uuv_optical_array", f"{node}_node", "--ros-args"]
    ran = subprocess.run(
        [*command, "-p", f"{bad[0]}:={bad[1]}"],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert ran.returncode != 0
    assert bad[0] in ran.stderr
    assert "Traceback" not in ran.stderr
