"""A follower with an array of its own: its nodes in one process, without simulator and demo.

Its arguments are those of follow.launch.py, of which three have another default.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from uuv_optical_array.nodes.bringup.launch_arguments import FOLLOW, FOLLOWER, choices


def generate_launch_description():
    share = FindPackageShare("uuv_optical_array")
    source = PathJoinSubstitution([share, "launch", "follow.launch.py"])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    name,
                    default_value=default,
                    description=FOLLOW[name][1],
                    choices=choices(name, default),
                )
                for name, default in FOLLOWER.items()
            ),
            IncludeLaunchDescription(PythonLaunchDescriptionSource(source)),
        ]
    )
