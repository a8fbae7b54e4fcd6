"""A test of a stack of one's own with launch_testing: `launch_test test_stack.py`, or pytest.

The package's demonstration runs as `ros2 launch` starts it, with speed_limit_node.py between
`formation_node` and the vehicle. The follower has to keep its leader with it, through a moment in
which the lamp is off, too.
"""

import math
import os
import sys
import time
import unittest
from pathlib import Path

import launch_testing
import pytest
import rclpy
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from launch import LaunchDescription
from launch.actions import ExecuteProcess, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import SetRemap
from launch_testing.actions import ReadyToTest
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile

HERE = Path(__file__).parent
FASTEST = 0.5  # m/s, the speed of the leader; without a limit the follower catches up faster
PATIENCE_S = 300.0  # the first start on a machine compiles the fit, for half a minute
NODES = "simulator", "feature", "estimator", "formation", "vehicles"


@pytest.mark.launch_test
def generate_test_description():
    """Start what is tested. A DDS domain of its own keeps other nodes of the network out."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    share = get_package_share_directory("uuv_optical_array")
    follow = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(f"{share}/launch/follow.launch.py"),
        launch_arguments={"leader_path": "straight"}.items(),
    )
    # A remap of one node alone has its name before the topic.
    limited = SetRemap(src="vehicles_node:cmd_vel", dst="cmd_vel_limited")
    limit = "--ros-args", "-p", f"max_speed_m_per_s:={FASTEST}"
    ours = ExecuteProcess(cmd=[sys.executable, str(HERE / "speed_limit_node.py"), *limit])
    return LaunchDescription([GroupAction([limited, follow]), ours, ReadyToTest()])


class TestStack(unittest.TestCase):
    """What the running stack does."""

    @classmethod
    def setUpClass(cls):
        """Listen from the beginning."""
        rclpy.init()
        cls.node = rclpy.create_node("test_stack")
        cls.executor = SingleThreadedExecutor()
        cls.executor.add_node(cls.node)
        cls.states, cls.commands = [], []
        lasting = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        cls.node.create_subscription(
            DiagnosticStatus, "follow_state", lambda told: cls.states.append(told.message), lasting
        )
        cls.node.create_subscription(TwistStamped, "cmd_vel_limited", cls.commands.append, 10)
        cls.simulator = cls.node.create_client(SetParameters, "simulator_node/set_parameters")

    @classmethod
    def tearDownClass(cls):
        """Leave."""
        cls.executor.shutdown()
        cls.node.destroy_node()
        rclpy.try_shutdown()

    def wait_for(self, condition, what):
        """Spin until something has happened; a test awaits events and sleeps for none."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            self.assertLess(time.monotonic(), deadline, f"waited {PATIENCE_S:g} s for {what}")
            self.executor.spin_once(timeout_sec=0.1)

    def locked(self, after):
        """Tell whether the follower has been locked since so many states were told."""
        return "locked" in self.states[after:]

    def fastest(self):
        """Return the largest speed that the vehicle has been commanded, m/s."""
        twists = [command.twist.linear for command in self.commands]
        return max((math.hypot(v.x, v.y, v.z) for v in twists), default=0.0)

    def set_lamp(self, power):
        """Set the power of the simulated lamp, a share of the scene's."""
        self.wait_for(self.simulator.service_is_ready, "simulator_node")
        request = SetParameters.Request()
        request.parameters = [Parameter("lamp_power", value=[power]).to_parameter_msg()]
        answer = self.simulator.call_async(request)
        self.wait_for(answer.done, "the answer of simulator_node")
        self.assertTrue(answer.result().results[0].successful, answer.result().results[0].reason)

    def test_the_follower_keeps_its_leader_through_a_dark_moment(self):
        """Lock, lose the light, and lock again, never faster than the limit."""
        self.wait_for(lambda: self.locked(0), "locked")
        self.wait_for(lambda: self.fastest() > 0.4, "a follower that goes as its leader does")
        seen = len(self.states)
        self.set_lamp(0.0)
        self.wait_for(lambda: "coasting" in self.states[seen:], "coasting")
        seen = len(self.states)
        self.set_lamp(1.0)
        self.wait_for(lambda: self.locked(seen), "locked again")
        self.assertLessEqual(self.fastest(), FASTEST + 1e-9)


@launch_testing.post_shutdown_test()
class TestEnd(unittest.TestCase):
    """What the processes left behind."""

    def test_all_ended_cleanly(self, proc_info):
        """Ctrl-C ends each of the six with exit code 0."""
        launch_testing.asserts.assertExitCodes(proc_info)
        self.assertEqual(len(list(proc_info.processes())), len(NODES) + 1)
