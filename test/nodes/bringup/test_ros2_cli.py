"""``ros2 launch`` and ``ros2 run`` as a user types them, and Ctrl-C."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rclpy
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from conftest import PATIENCE_S
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from node_processes import Probe
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_sensor_data

from uuv_optical_array.core.messages import stamp_ns
from uuv_optical_array.core.storage import files
from uuv_optical_array.nodes import estimator_node, feature_node, formation_node, simulator_node
from uuv_optical_array.recording.bag import RUN, opened


def why_not():
    """Say why ros2 cannot start the package here, or nothing where it can."""
    if shutil.which("ros2") is None:
        return "ros2 is not installed, so nothing to type"
    found = subprocess.run(
        ["ros2", "pkg", "prefix", "uuv_optical_array"], capture_output=True, check=False
    )
    return "the package is in no ROS workspace: ros2 cannot find it" if found.returncode else ""


WHY_NOT = why_not()
pytestmark = pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)


LAUNCH = ["ros2", "launch", "uuv_optical_array"]
NODES = "simulator", "feature", "estimator", "formation", "vehicles"


def begin_launch(folder, *words):
    """Start ``ros2 launch`` in a process group of its own; `folder` gets its log."""
    with (folder / "log").open("w") as log:
        return subprocess.Popen(
            [*LAUNCH, *words], stdout=log, stderr=log, cwd=folder, start_new_session=True
        )


@contextlib.contextmanager
def launched(folder, *arguments, file="follow.launch.py"):
    """Launch the file and yield a probe beside it; end both, and require that nothing is left."""
    process = begin_launch(folder, file, *arguments)
    rclpy.init(args=["--ros-args", "--enclave", "/onlooker"])
    try:
        yield Probe("onlooker")
    finally:
        rclpy.try_shutdown()
        # A terminal sends Ctrl-C to the whole group.
        os.killpg(process.pid, signal.SIGINT)
        code = process.wait(timeout=PATIENCE_S)
        text = (folder / "log").read_text()
        print(text)
    assert code == 0
    assert "Traceback" not in text
    with pytest.raises(ProcessLookupError):  # nothing of the group is left
        os.killpg(process.pid, 0)


def poses_of(probe):
    """Return a list that grows by every pose that is published."""
    poses = []
    probe.node.create_subscription(
        PoseWithCovarianceStamped, "relative_pose", poses.append, qos_profile_sensor_data
    )
    return poses


def parameters_of(probe, name, wanted):
    """Return the present values of another node's parameters."""
    client = probe.node.create_client(GetParameters, f"{name}/get_parameters")
    probe.wait_for(client.service_is_ready, "the service of parameters")
    answer = client.call_async(GetParameters.Request(names=list(wanted)))
    probe.wait_for(answer.done, "the parameters")
    return dict(zip(wanted, map(parameter_value_to_python, answer.result().values), strict=True))


def started(folder, node):
    """Return the process ids of a node, in the order of its starts."""
    line = rf"\[{node}-\d+\]: process started with pid \[(\d+)\]"
    return [int(pid) for pid in re.findall(line, (folder / "log").read_text())]


def test_a_killed_node_is_started_again_and_ctrl_c_leaves_no_process(tmp_path):
    with launched(tmp_path, "scene:=reference", "use_respawn:=true") as probe:
        poses = poses_of(probe)
        probe.wait_for(lambda: poses, "a pose")
        os.kill(started(tmp_path, "estimator_node")[0], signal.SIGKILL)
        probe.wait_for(lambda: len(started(tmp_path, "estimator_node")) == 2, "a second start")
        poses.clear()
        probe.wait_for(lambda: poses, "a pose")
        variables = Path(f"/proc/{started(tmp_path, 'estimator_node')[1]}/environ").read_text()
    # Others forget a killed node before its successor comes.
    (profile,) = set(re.findall(r"FAST\w+_DEFAULT_PROFILES_FILE=([^\0]+)", variables))
    lease, announced = (
        ElementTree.parse(profile).find(f".//{{*}}{name}")
        for name in ("leaseDuration", "leaseAnnouncement")
    )
    assert 3 * seconds(announced) <= seconds(lease) <= 1


def seconds(element):
    return sum(
        scale * int(element.findtext(f"{{*}}{unit}", "0"))
        for unit, scale in (("sec", 1), ("nanosec", 1e-9))
    )


def test_a_secured_launch_runs_each_node_in_an_enclave_of_the_policy(tmp_path, monkeypatch):
    pytest.importorskip("sros2", reason="no sros2: no launch was secured")
    policy, keys = files.shared_file("config/security/policy.xml"), tmp_path / "keys"
    for words in (
        ["create_keystore", keys],
        ["generate_artifacts", "-k", keys, "-p", policy],
        ["create_enclave", keys, "/onlooker"],
    ):
        subprocess.run(["ros2", "security", *words], check=True)
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(keys))
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    able = "import rclpy; rclpy.init(); rclpy.create_node('able')"
    words = [sys.executable, "-c", able, "--ros-args", "--enclave", "/onlooker"]
    tried = subprocess.run(words, capture_output=True, text=True, check=False)
    if tried.returncode:
        pytest.skip(f"ROS is without its security plugins: {tried.stderr.splitlines()[-1]}")
    with launched(tmp_path, "scene:=reference") as probe:
        poses, names = poses_of(probe), set()
        probe.node.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda array: names.update(status.name for status in array.status),
            10,
        )
        probe.wait_for(lambda: poses and len(names) == 5, "a pose and five nodes")
        variables = {
            **os.environ,
            "ROS_SECURITY_ENCLAVE_OVERRIDE": "/uuv_optical_array/feature_node",
        }
        words = ["ros2", "run", "uuv_optical_array", "estimator_node"]
        strange = subprocess.run(
            words, env=variables, capture_output=True, text=True, check=False, timeout=PATIENCE_S
        )
    assert names == {f"{name}_node" for name in NODES}
    assert strange.returncode
    assert "Traceback" not in strange.stderr
    assert "the enclave has to allow what the node declares; print its policy" in strange.stderr


def test_a_recorded_launch_leaves_a_bag_with_what_was_said(tmp_path):
    try:
        get_package_prefix("rosbag2_storage_mcap")
    except PackageNotFoundError:
        pytest.skip("rosbag2_storage_mcap is not installed: no launch was recorded")
    with launched(tmp_path, "scene:=reference", "record:=true") as probe:
        heard = poses_of(probe)
        # DDS announces each 3 s: by then the recorder hears all topics, and for 2 s more.
        probe.wait_for(lambda: len(heard) > 80, "81 poses")
        # A recorder whose power fails has left it.
        (growing,) = tmp_path.glob("rosbag2_*/*.mcap")
        assert growing.stat().st_size > 2**15
    (bag,) = tmp_path.glob("rosbag2_*")
    stamps = {topic: [] for topic in RUN}
    with opened(bag) as held:
        for _, channel, message in held.messages({f"/{name}": kind for name, kind in RUN.items()}):
            stamped = getattr(message, "header", None)  # a state has none
            stamps[channel.topic.removeprefix("/")].append(stamped and stamp_ns(stamped))
        assert not held.lost
    assert all(stamps.values())
    assert {stamp_ns(pose.header) for pose in heard[60:]} <= set(stamps["relative_pose"])
    assert set(stamps["relative_pose"][-10:]) <= set(stamps["array/image"])


def test_a_params_file_with_one_value_changes_nothing_else(tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text("/**:\n  ros__parameters:\n    scene: reference\n")
    with launched(tmp_path, f"params_file:={mine}", "demo:=false") as probe:
        for module in (simulator_node, feature_node, estimator_node, formation_node):
            expected = {key: parameter.default for key, parameter in module.PARAMETERS.items()}
            if "scene" in expected:
                expected["scene"] = "reference"
            name = module.__name__.rpartition(".")[2]
            assert parameters_of(probe, name, expected) == expected


def test_followers_of_a_formation_see_the_lamp_ahead_and_share_no_topic(tmp_path):
    with launched(tmp_path, "followers:=2", file="formation.launch.py") as probe:
        posed = set()
        for follower in ("follower_1", "follower_2"):
            probe.node.create_subscription(
                PoseWithCovarianceStamped,
                f"{follower}/relative_pose",
                lambda message, follower=follower: posed.add(follower),
                qos_profile_sensor_data,
            )
        probe.wait_for(lambda: len(posed) == 2, "poses of both followers")
        leader = "/leader/odometry"  # which the probe may find later than those who use it
        probe.wait_for(lambda: probe.node.count_publishers(leader), "the leader")
        topics = [
            topic
            for topic, (kind, *_) in probe.node.get_topic_names_and_types()
            if kind.startswith(("nav_msgs", "geometry_msgs", "sensor_msgs"))
        ]
        counts = {topic: probe.node.count_publishers(topic) for topic in topics}
        assert counts[leader] == 1
        assert max(counts.values()) == 1, counts
        assert not {topic for topic in counts if topic.endswith("follower_1/leader/odometry")}
    # The leader, and of each follower its simulator, vehicle and follower_node.
    assert (tmp_path / "log").read_text().count("process started") == 1 + 3 * 2


def test_a_follower_with_an_array_of_its_own_is_one_process(tmp_path):
    with launched(tmp_path, "scene:=reference", file="follower.launch.py") as probe:
        values = parameters_of(probe, "estimator_node", ["scene"])
    assert values == {"scene": "reference"}
    assert len(started(tmp_path, "follower_node")) == 1
    assert (tmp_path / "log").read_text().count("process started") == 1


def launch_that_ends(folder, *words):
    """Launch a file with arguments that end the launch by itself; return what it said."""
    process = begin_launch(folder, *words)
    assert process.wait(timeout=PATIENCE_S) == 1
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)
    return (folder / "log").read_text()


def without_viewers():
    try:
        get_package_prefix("rviz2")
    except (PackageNotFoundError, OSError):
        return [("follow", "rviz:=true", ("package 'rviz2' not found",))]
    return []


@pytest.mark.parametrize(
    ("file", "argument", "words"),
    [
        ("follow", "station:=[1,2]", ("station", "[x, y, z]")),
        ("follow", "station:=[a,0,0]", ("'a' is not a number", "from -50 to 50 m\n")),
        ("follow", "station:=[-4.5,0,0", ("station: not YAML: line 1",)),
        ("follow", "station:=[-0.2,0,0]", ("not behind the lamp", "from -50 to -0.5 m\n")),
        ("follow", "params_file:=/nowhere/p.yaml", ("/nowhere/p.yaml: no such file",)),
        ("follow", "scene:=nosuch", ("nosuch", "reference")),
        ("follow", "leader_path:=zigzags", ("'zigzags' is neither a ready path", "mean zigzag?")),
        ("formation", "leader_path:=x.csv", ("'x.csv' is neither a ready path nor a file",)),
        ("follow", "demo:=maybe", ("demo", "maybe", "'true'", "'false'")),
        ("formation", "followers:=0", ("followers: 0",)),
        ("formation", "followers:={", ("followers: not YAML: line 1",)),
        ("formation", "followers:=x", ("followers: 'x' is not a whole number", "1 to 4 in a ch")),
        ("follow", "leader_odometry:=rov-1/odometry", ("'rov-1/odometry' cannot name a topic",)),
        ("follow", "others:=/rov_2//odometry", ("others: '/rov_2//odometry' cannot name",)),
        ("follow", "sigterm_timeout:=soon", ("timeout: 'soon' is not a number", "to 3600 s\n")),
        ("formation", "sigkill_timeout:=-1", ("sigkill_timeout: -1 is out of bounds",)),
        ("follow", "log_level:=loud", ("log_level", "loud", "'debug'", "'fatal'")),
        ("follow", "followers:=two demo:=leader", ("'two' is not a whole number", "1 to 100\n")),
        *without_viewers(),
    ],
)
def test_a_bad_argument_ends_the_launch_before_a_node_runs(tmp_path, file, argument, words):
    text = launch_that_ends(tmp_path, f"{file}.launch.py", *argument.split())
    for word in words:
        assert word in text
    assert "process started" not in text


def test_a_node_that_dies_ends_the_launch_and_every_other_node(tmp_path):
    bad = tmp_path / "bad.yaml"
    bad.write_text("/**/formation_node:\n  ros__parameters:\n    rate_hz: -1.0\n")
    text = launch_that_ends(tmp_path, "follow.launch.py", f"params_file:={bad}")
    assert "formation_node died with exit code 1" in text
    assert len(re.findall("process started", text)) == 5


@pytest.mark.parametrize(
    ("node", "parameter", "value"),
    [
        ("simulator", "max_gap_s", "-1.0"),
        ("feature", "min_peak_counts", "-1.0"),
        ("estimator", "max_angle_rad", "9.0"),
        ("formation", "min_distance_m", "-6.0"),
        ("follower", "neighbours", "1"),
        ("vehicles", "rate_hz", "0.0"),
        ("view", "max_rate_hz", "-1.0"),
    ],
)
def test_ros2_run_refuses_a_bad_start_value_in_one_line(node, parameter, value):
    words = ["ros2", "run", "uuv_optical_array", f"{node}_node", "--ros-args", "-p"]
    ran = subprocess.run(
        [*words, f"{parameter}:={value}"], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert ran.returncode != 0
    assert parameter in ran.stderr
    assert "Traceback" not in ran.stderr
