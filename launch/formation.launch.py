"""A leader and followers, each of these with its nodes in a namespace of its own."""

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from uuv_optical_array.control.fleet import vee
from uuv_optical_array.nodes.bringup.launch_arguments import (
    EACH,
    FORMATION,
    YES,
    declared,
    log_unknown,
    parsed,
)


def generate_launch_description():
    return LaunchDescription(
        [*declared(FORMATION), *log_unknown(__file__, FORMATION), OpaqueFunction(function=fleet)]
    )


def fleet(context):
    """Return the launch of each vehicle; the first refuses whatever is wrong for all."""

    def given(name):
        return LaunchConfiguration(name).perform(context)

    followers = vee(parsed("followers", given("followers")), given("chain") in YES)
    space = given("namespace").strip("/")
    root = f"/{space}/" if space else "/"
    source = PythonLaunchDescriptionSource(
        PathJoinSubstitution([FindPackageShare("uuv_optical_array"), "launch", "follow.launch.py"])
    )
    common = {name: given(name) for name in EACH}
    if given("rviz") in YES:
        common["publish_tf"] = given("publish_tf") or "true"
    config = PathJoinSubstitution([FindPackageShare("uuv_optical_array"), "rviz/formation.rviz"])
    vehicles = [
        {
            "demo": "leader",
            "namespace": space,
            "followers": str(len(followers)),
            "leader_path": given("leader_path"),
            "rviz_config": given("rviz_config") or config,
        },
        *(
            {
                "demo": "follower",
                "namespace": f"{root}{follower.namespace}",
                "frame_prefix": f"{follower.namespace}/",
                "leader_odometry": f"{root}{follower.lamp_odometry}",
                "leader_frame": f"/{follower.lamp_frame}",
                "others": " ".join(root + topic for topic in follower.others(followers)),
                "station": str(list(follower.station_m)),
                "rviz": "false",
            }
            for follower in followers
        ),
    ]
    return [
        IncludeLaunchDescription(source, launch_arguments={**common, **vehicle}.items())
        for vehicle in vehicles
    ]
