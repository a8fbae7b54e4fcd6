"""The launch file brings the graph up, its arguments and remaps work, and it ends cleanly."""

import gc
import unittest
import warnings

import launch_testing
import pytest
import rclpy
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from conftest import PATIENCE_S
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_testing.actions import ReadyToTest
from launch_testing_ros import WaitForTopics
from nav_msgs.msg import Odometry
from node_processes import Probe
from sensor_msgs.msg import Image, PointCloud2


@pytest.mark.launch_test
def generate_test_description():
    try:
        share = get_package_share_directory("uuv_optical_array")
    except (PackageNotFoundError, OSError):
        pytest.skip("the package is in no ROS workspace, so no launch test")
    follow = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(f"{share}/launch/follow.launch.py"),
        launch_arguments={
            "namespace": "chaser",
            "leader_odometry": "/boss/odometry",
            "scene": "reference",
        }.items(),
    )
    return LaunchDescription([follow, ReadyToTest()])


def names_of_nodes(node):
    return [f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()]


class TestGraph(unittest.TestCase):
    def test_every_topic_speaks_where_the_arguments_put_it(self):
        topics = [
            ("/boss/odometry", Odometry),
            ("/chaser/follower/odometry", Odometry),
            ("/chaser/array/image", Image),
            ("/chaser/array/features", PointCloud2),
            ("/chaser/relative_pose", PoseWithCovarianceStamped),
            ("/chaser/cmd_vel", TwistStamped),
            ("/diagnostics", DiagnosticArray),
        ]
        with WaitForTopics(topics, timeout=PATIENCE_S) as awaited:
            pose = awaited.received_messages("/chaser/relative_pose")[0]
        self.assertEqual(pose.header.frame_id, "leader/beacon")
        self.assertLess(abs(pose.pose.pose.position.x + 6.5), 2.0)

    def test_nodes_are_in_the_namespace(self):
        rclpy.init()
        try:
            probe = Probe("onlooker")
            wanted = {
                f"/chaser/{name}_node"
                for name in ("simulator", "feature", "estimator", "formation", "vehicles")
            }
            probe.wait_for(lambda: wanted <= set(names_of_nodes(probe.node)), "all nodes")
        finally:
            rclpy.try_shutdown()


@launch_testing.post_shutdown_test()
class TestEnd(unittest.TestCase):
    def test_every_process_ends_with_exit_code_0(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info)
        self.assertEqual(len(list(proc_info.processes())), 5)

    def test_what_launch_testing_left_open_is_closed_here(self):
        # It leaves an event loop to the garbage collector, which would warn in another test.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)
            gc.collect()
