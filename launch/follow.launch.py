"""Follow a leader by light: sensor nodes, formation control and, unless told not to, the demo."""

import os
import re
from pathlib import Path
from typing import Annotated

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from launch import LaunchDescription
from launch.actions import ExecuteProcess, OpaqueFunction, Shutdown
from launch.logging import launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage

from uuv_optical_array.control.formation_settings import STATION, FormationSettings
from uuv_optical_array.control.vehicles.leader_path import leader_path
from uuv_optical_array.core.settings import Place, Quantity, check
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.bringup.launch_arguments import (
    FOLLOW,
    OF_LAUNCH,
    YES,
    declared,
    enclave,
    log_unknown,
    parsed,
)
from uuv_optical_array.nodes.shared.parameters import checked_topic
from uuv_optical_array.nodes.vehicles_node import PARAMETERS
from uuv_optical_array.recording.bag import RUN

PACKAGE = "uuv_optical_array"
RESPAWN_DELAY_S = 0.2
# For what ends at Ctrl-C, before launch uses force: launch's own 5 s are too few on a busy machine.
PATIENCE = {"sigterm_timeout": LaunchConfiguration("sigterm_timeout", default="30")}
TIMEOUT = Annotated[float, Quantity("before launch uses force", "s", 0, 3600)]
# Where Fast DDS looks for a profile, from version 3 on and before it, which these have.
PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"
BEFORE_3 = "humble", "iron", "jazzy"


def generate_launch_description():
    return LaunchDescription(
        [*declared(FOLLOW), *log_unknown(__file__, FOLLOW), OpaqueFunction(function=nodes)]
    )


def nodes(context):
    """Return the nodes; whatever is wrong with the arguments ends the launch before one runs."""

    def given(name):
        return LaunchConfiguration(name).perform(context)

    def switched_on(name):
        return given(name) in YES

    share = Path(get_package_share_directory(PACKAGE))
    parameters = [str(share / "config/follow.yaml")]
    if given("params_file"):
        if not Path(given("params_file")).is_file():
            raise FileNotFoundError(f"params_file {given('params_file')}: no such file")
        parameters.append(given("params_file"))
    arguments = {}
    for name in OF_LAUNCH:  # with a bad one launch itself does not end
        timeout = LaunchConfiguration(name, default="0").perform(context)
        check(TIMEOUT, parsed(name, timeout), name)
    if given("scene"):
        load_scene(given("scene"))
    if given("leader_path"):
        leader_path(given("leader_path"))
    checked_topic("leader_odometry", given("leader_odometry"))
    for topic in given("others").split():
        checked_topic("others", topic)
    for name in ("scene", "frame_prefix", "leader_frame", "others", "leader_path"):
        if given(name):
            arguments[name] = ParameterValue(given(name), value_type=str)
    for name in ("use_sim_time", "use_leader_odometry", "draw_sea"):
        if given(name):
            arguments[name] = switched_on(name)
    if given("publish_tf"):
        arguments["publish_tf"] = switched_on("publish_tf")
    elif switched_on("rviz"):
        arguments["publish_tf"] = True
    if given("station"):
        station = check(Annotated[Place, STATION], parsed("station", given("station")), "station")
        arguments["station_m"] = list(FormationSettings(station).station_m)
    alone = given("demo") in ("leader", "follower")
    if alone:
        arguments["vehicles"] = given("demo")
        wanted = parsed("followers", given("followers"))
        arguments["followers"] = PARAMETERS["followers"].check("followers", wanted)
        if given("frame_prefix"):
            arguments["world_frame"] = "/odom"  # that of the leader
    if arguments:
        parameters.append(arguments)
    names = ["feature_node", "estimator_node", "formation_node"]
    if switched_on("one_process"):
        names = ["follower_node"]
    if switched_on("simulator"):
        names.insert(0, "simulator_node")
    if given("demo") == "leader":
        names.clear()
    if switched_on("demo") or alone:
        names.append("vehicles_node")
    respawn = switched_on("use_respawn")
    common = {
        "namespace": given("namespace"),
        "remappings": [("leader/odometry", given("leader_odometry"))],
        "log_level": given("log_level"),
        "output": "screen",
    }
    started = [
        started_node(context, respawn, PACKAGE, name, parameters=parameters, **common)
        for name in names
    ]
    if switched_on("rviz"):
        prefix = given("frame_prefix")
        world = prefix + ("odom" if switched_on("demo") else "leader/beacon")
        config = given("rviz_config") or shown(share, prefix, "odom" if alone else world)
        simulated = {"use_sim_time": switched_on("use_sim_time")}
        # The window may be closed while the nodes run on.
        window = {"arguments": ["-d", config], "parameters": [simulated], **common}
        started.append(started_node(context, None, "rviz2", "rviz2", **window))
    if switched_on("record"):
        started += recorder(given("namespace"), given("leader_odometry"), given("bag"), share)
    return started


def shown(share, prefix, world):
    """Write what RViz shows, with the frames of this launch, beside launch's log; return where."""
    text = (share / "rviz/follow.rviz").read_text(encoding="utf-8")
    text = text.replace("Fixed Frame: odom", f"Fixed Frame: {world}")
    text = re.sub("(Target Frame: )", rf"\g<1>{prefix}", text)
    path = Path(launch_config.log_dir) / f"{prefix.replace('/', '_')}follow.rviz"
    path.write_text(text, encoding="utf-8")
    return str(path)


def recorder(namespace, leader_odometry, folder, share):
    """Return rosbag2, which records what `uuv_array follow --record` does."""
    for package in ("ros2bag", "rosbag2_storage_mcap"):
        try:
            get_package_share_directory(package)
        except PackageNotFoundError:
            raise RuntimeError(
                f"record:=true needs the package {package}, which is not installed; install "
                "ros-$ROS_DISTRO-ros2bag and ros-$ROS_DISTRO-rosbag2-storage-mcap"
            ) from None
    names = [leader_odometry if name == "leader/odometry" else name for name in RUN]
    topics = [name if name.startswith("/") else f"{namespace}/{name}" for name in names]
    # The one way to name topics that all distributions share.
    wanted = f"^({'|'.join('/' + topic.strip('/') for topic in topics)})$"
    storage = str(share / "config/record.yaml")
    command = ["ros2", "bag", "record", "--storage", "mcap", "--storage-config-file", storage]
    command += ["--output", folder] if folder else []
    return [
        ExecuteProcess(
            cmd=[*command, "--regex", wanted],
            output="screen",
            additional_env={"ROS_SECURITY_ENCLAVE_OVERRIDE": enclave(namespace, "ros2_bag")},
            **PATIENCE,
        )
    ]


def profiles(respawn):
    """Return the environment in which a killed node is soon forgotten, unless the user has one."""
    name = PROFILES[os.environ.get("ROS_DISTRO") in BEFORE_3]
    if not respawn or name in os.environ:
        return {}
    return {name: f"{get_package_share_directory(PACKAGE)}/config/fastdds_respawn.xml"}


def started_node(context, respawn, package, executable, *, namespace, log_level, **others):
    """Return a node that is known to be installed.

    When it ends it is started again with `respawn`, else it ends the launch, and with None neither.
    """
    try:
        ExecutableInPackage(executable=executable, package=package).perform(context)
    except Exception as reason:  # launch has several, which share no base
        raise RuntimeError(
            f"{executable} of the package {package} is not installed: {reason}"
        ) from None

    def ended(event, context):
        if context.is_shutdown:
            return None
        if event.returncode:
            # An error makes ros2 launch exit with 1.
            raise RuntimeError(f"{executable} died with exit code {event.returncode}")
        return Shutdown(reason=f"{executable} ended")

    return Node(
        package=package,
        executable=executable,
        namespace=namespace,
        # Its enclave of the policy, which counts where ROS is secured.
        ros_arguments=[
            *("--enclave", enclave(namespace, executable)),
            *(["--log-level", log_level] if log_level else []),
        ],
        respawn=bool(respawn),
        respawn_delay=RESPAWN_DELAY_S,
        additional_env=profiles(respawn),
        on_exit=ended if respawn is False else None,
        **PATIENCE,
        **others,
    )
