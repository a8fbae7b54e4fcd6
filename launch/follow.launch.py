"""Follow a leader by light: sensor nodes, formation control and, unless told not to, the demo."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "uuv_optical_array"


def generate_launch_description():
    share = FindPackageShare(PACKAGE)
    arguments = [
        DeclareLaunchArgument(
            "scene",
            default_value="follow",
            description="ready scene's name or a YAML file: lamp, water, array, electronics",
        ),
        DeclareLaunchArgument(
            "params_file",
            default_value=PathJoinSubstitution([share, "config", "follow.yaml"]),
            description="parameters of every node",
        ),
        DeclareLaunchArgument("namespace", default_value="", description="of the follower's nodes"),
        DeclareLaunchArgument(
            "leader_odometry",
            default_value="leader/odometry",
            description="topic of the leader's odometry, for followers that share a leader",
        ),
        DeclareLaunchArgument(
            "demo", default_value="true", description="whether the two demo vehicles run"
        ),
        DeclareLaunchArgument("rviz", default_value="false", description="whether RViz opens"),
        DeclareLaunchArgument(
            "publish_tf",
            default_value=LaunchConfiguration("rviz"),
            description="whether the poses go to /tf too, as RViz needs them",
        ),
        DeclareLaunchArgument(
            "use_sim_time", default_value="false", description="whether /clock is the time"
        ),
    ]
    rviz = LaunchConfiguration("rviz")
    given = {
        "scene": ParameterValue(LaunchConfiguration("scene"), value_type=str),
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool),
        "publish_tf": ParameterValue(LaunchConfiguration("publish_tf"), value_type=bool),
    }

    def node(executable, **options):
        return Node(
            package=PACKAGE,
            executable=executable,
            name=executable,
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params_file"), given],
            remappings=[("leader/odometry", LaunchConfiguration("leader_odometry"))],
            output="screen",
            **options,
        )

    return LaunchDescription(
        [
            *arguments,
            node("simulator_node"),
            node("feature_node"),
            node("estimator_node"),
            node("formation_node"),
            node("vehicles_node", condition=IfCondition(LaunchConfiguration("demo"))),
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                arguments=["--frame-id", "leader/base_link", "--child-frame-id", "leader/beacon"],
                condition=IfCondition(rviz),
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", PathJoinSubstitution([share, "rviz", "follow.rviz"])],
                condition=IfCondition(rviz),
            ),
        ]
    )
