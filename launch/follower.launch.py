"""A follower with an array of its own: its nodes in one process, without simulator and demo.

Its arguments are those of follow.launch.py, of which three have another default.
"""

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from uuv_optical_array.nodes.bringup.launch_arguments import FOLLOW, FOLLOWER, declared, log_unknown


def generate_launch_description():
    share = FindPackageShare("uuv_optical_array")
    source = PathJoinSubstitution([share, "launch", "follow.launch.py"])
    follow = IncludeLaunchDescription(PythonLaunchDescriptionSource(source))
    return LaunchDescription([*declared(FOLLOWER), *log_unknown(__file__, FOLLOW), follow])
