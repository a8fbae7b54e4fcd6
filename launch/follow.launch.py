"""Follow a leader by light: sensor nodes, formation control and, unless told not to, the demo."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "uuv_optical_array"
# Empty means: not given, so that neither a file's value nor a node's default is replaced.
ARGUMENTS = {
    "scene": ("", "ready scene's name or a YAML file: lamp, water, array, electronics"),
    "params_file": ("", "your parameters; what they leave out keeps its default"),
    "namespace": ("", "of the follower's nodes"),
    "leader_odometry": (
        "leader/odometry",
        "topic of the leader's odometry, for followers that share a leader",
    ),
    "demo": ("true", "whether the two demo vehicles run"),
    "rviz": ("false", "whether RViz opens"),
    "publish_tf": ("", "whether the poses go to /tf too; with rviz they do unless told not to"),
    "use_sim_time": ("", "whether the nodes use simulated time, from /clock"),
}


def generate_launch_description():
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=nodes),
        ]
    )


def nodes(context):
    """Return the nodes; whatever is wrong with the arguments ends the launch before one runs."""

    def given(name):
        return LaunchConfiguration(name).perform(context)

    def switched_on(name):
        return IfCondition(LaunchConfiguration(name)).evaluate(context)

    share = FindPackageShare(PACKAGE)
    parameters = [PathJoinSubstitution([share, "config", "follow.yaml"])]
    if given("params_file"):
        if not Path(given("params_file")).is_file():
            raise FileNotFoundError(f"params_file {given('params_file')}: no such file")
        parameters.append(given("params_file"))
    arguments = {}
    if given("scene"):
        arguments["scene"] = ParameterValue(given("scene"), value_type=str)
    if given("use_sim_time"):
        arguments["use_sim_time"] = switched_on("use_sim_time")
    if given("publish_tf"):
        arguments["publish_tf"] = switched_on("publish_tf")
    elif switched_on("rviz"):
        arguments["publish_tf"] = True
    if arguments:
        parameters.append(arguments)
    names = ["simulator_node", "feature_node", "estimator_node", "formation_node"]
    if switched_on("demo"):
        names.append("vehicles_node")
    # RViz and what it needs may be missing, so they come first.
    return [
        *(viewers(share) if switched_on("rviz") else ()),
        *(
            Node(
                package=PACKAGE,
                executable=name,
                name=name,
                namespace=given("namespace"),
                parameters=parameters,
                remappings=[("leader/odometry", given("leader_odometry"))],
                output="screen",
            )
            for name in names
        ),
    ]


def viewers(share):
    return [
        Node(
            package="rviz2",
            executable="rviz2",
            arguments=["-d", PathJoinSubstitution([share, "rviz", "follow.rviz"])],
        ),
    ]
