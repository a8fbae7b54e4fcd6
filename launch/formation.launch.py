"""A leader and several followers, each with its nodes in a namespace of its own."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from uuv_optical_array.control.fleet import vee

ARGUMENTS = {
    "followers": ("3", "how many followers"),
    "chain": (
        "true",
        "whether the third and later ones are lit from a follower ahead, not by the leader",
    ),
    "namespace": ("", "of the whole formation"),
}
# Handed on to follow.launch.py.
COMMON = {
    "scene": ("formation", "ready scene's name or a YAML file: lamp, water, array, electronics"),
    "params_file": ("", "your parameters; what they leave out keeps its default"),
    "use_sim_time": ("", "whether the nodes use simulated time, from /clock"),
    "use_respawn": (
        "false",
        "whether a node that dies is started again; without, the launch ends with it",
    ),
}
SWITCH = ("true", "True", "1", "false", "False", "0")


def generate_launch_description():
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    name,
                    default_value=default,
                    description=description,
                    choices=SWITCH if name == "chain" else None,
                )
                for name, (default, description) in (ARGUMENTS | COMMON).items()
            ),
            OpaqueFunction(function=fleet),
        ]
    )


def fleet(context):
    """Return the launch of each vehicle; the first refuses whatever is wrong for all."""

    def given(name):
        return LaunchConfiguration(name).perform(context)

    followers = vee(int(given("followers")), SWITCH.index(given("chain")) < SWITCH.index("false"))
    space = given("namespace").strip("/")
    root = f"/{space}/" if space else "/"
    source = PythonLaunchDescriptionSource(
        PathJoinSubstitution([FindPackageShare("uuv_optical_array"), "launch", "follow.launch.py"])
    )
    common = {name: given(name) for name in COMMON}
    vehicles = [
        {"demo": "leader", "namespace": space, "followers": str(len(followers))},
        *(
            {
                "demo": "follower",
                "namespace": f"{root}{follower.namespace}",
                "leader_odometry": f"{root}{follower.lamp_odometry}",
                "station": str(list(follower.station_m)),
            }
            for follower in followers
        ),
    ]
    return [
        IncludeLaunchDescription(source, launch_arguments={**common, **vehicle}.items())
        for vehicle in vehicles
    ]
