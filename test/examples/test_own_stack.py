"""The example of a stack of one's own: its node, and its test as a user runs it."""

import importlib.util
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TwistStamped

STACK = Path(__file__).parents[2] / "examples" / "stack"


def why_not():
    """Say why the package cannot be launched here, or nothing where it can."""
    if importlib.util.find_spec("launch_testing_ros") is None:
        return "launch_testing_ros is not installed"
    try:
        get_package_share_directory("uuv_optical_array")
    except (PackageNotFoundError, OSError):
        return "the package is in no ROS workspace"
    return ""


@pytest.fixture
def node_type():
    spec = importlib.util.spec_from_file_location("own", STACK / "speed_limit_node.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.SpeedLimitNode


def test_a_fast_command_is_shortened_and_a_slow_one_passes(lab, node_type):
    lab.begin()
    lab.start(node_type)
    heard = lab.listen(TwistStamped, "cmd_vel_limited")
    talker = lab.talk(TwistStamped, "cmd_vel")
    for second, (x, y, z) in enumerate([(0.6, -0.3, 0.2), (1.2, -0.6, 0.4)]):
        command = TwistStamped()
        command.header.stamp = Time(sec=second + 1)
        linear, angular = command.twist.linear, command.twist.angular
        linear.x, linear.y, linear.z, angular.z = x, y, z, 0.3

        def answered(command=command):
            talker.publish(command)  # until the nodes have found each other
            return [told for told in heard if told.header.stamp == command.header.stamp]

        passed = lab.until(answered, "the command").pop().twist
        # The two are parallel and of 0.7 and 1.4 m/s, and the limit is 0.7 m/s.
        got = passed.linear.x, passed.linear.y, passed.linear.z
        assert got == pytest.approx((0.6, -0.3, 0.2))
        assert math.hypot(*got) == pytest.approx(0.7)
        assert passed.angular.z == 0.3


@pytest.mark.skipif(bool(why_not()), reason=why_not() or "it runs")
def test_the_test_of_the_stack_passes_as_a_user_runs_it(tmp_path):
    told = {name: os.environ[name] for name in os.environ if not name.startswith("PYTEST")}
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", str(STACK / "test_stack.py")]
    done = subprocess.run(
        [sys.executable, *words],
        env=told,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout
