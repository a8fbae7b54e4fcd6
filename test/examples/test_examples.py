"""The example configurations name topics, frames and parameters that the nodes have."""

import importlib
import math
import re

import pytest
import yaml

from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.core.storage import files
from uuv_optical_array.nodes.bringup.security import PROCESSES
from uuv_optical_array.nodes.estimator_node import PARAMETERS, EstimatorNode

EXAMPLES = sorted(files.shared_file("config/examples").glob("*.yaml"))
FILTERS = [path for path in EXAMPLES if path.name.startswith("robot_localization")]
LAUNCHES = [path for path in EXAMPLES if path.name.endswith(".launch.yaml")]
(AGGREGATOR,) = (path for path in EXAMPLES if path.name == "diagnostic_aggregator.yaml")
(DOCKING,) = (path for path in EXAMPLES if path.name == "nav2_docking.yaml")
(FOLLOWING,) = (path for path in EXAMPLES if path.name == "nav2_following.yaml")
KINDS = {"odom": "nav_msgs/msg/Odometry", "pose": "geometry_msgs/msg/PoseWithCovarianceStamped"}
NAMED = pytest.mark.parametrize("path", [*FILTERS, *LAUNCHES], ids=lambda path: path.name)


def read(path):
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def given(path):
    """Yield each node of the package that an example starts or sets, its values and its remaps."""
    document = read(path)
    for key, section in document.items():
        if key.endswith("_node") and "ekf" not in key:
            yield key.rpartition("/")[2], section["ros__parameters"], {}
    for entry in document.get("launch", []):
        node = entry["node"]
        assert node["pkg"] == "uuv_optical_array"
        values = {each["name"]: each["value"] for each in node["param"]}
        yield node["exec"], values, {each["from"]: each["to"] for each in node.get("remap", [])}


def values_of(path):
    """Return the estimator's values: the defaults, and the example's."""
    own = next(values for name, values, _ in given(path) if name == "estimator_node")
    return {**{name: parameter.default for name, parameter in PARAMETERS.items()}, **own}


@pytest.fixture
def topics(lab, scene_file):
    """What the estimator node publishes and hears with an IMU, and of which type."""
    lab.begin({"scene": scene_file, "method": "sam", "use_imu": True})
    node = lab.start(EstimatorNode)
    ends = [*node.publishers, *node.subscriptions]
    kinds = {end.topic_name.lstrip("/"): end.msg_type for end in ends}
    return {
        name: f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
        for name, kind in kinds.items()
    }


def test_each_kind_of_example_is_there():
    assert len(FILTERS) == len(LAUNCHES) == 2
    assert {*FILTERS, *LAUNCHES, AGGREGATOR, DOCKING, FOLLOWING} == set(EXAMPLES)


def test_the_aggregator_expects_the_nodes_of_a_follower_and_knows_those_of_the_demonstration():
    light = read(AGGREGATOR)["/**"]["ros__parameters"]["light"]
    follower = {"feature_node", "estimator_node", "formation_node"}
    assert set(light["expected"]) == follower
    others = {"follower_node", "view_node", "rviz2", "ros2_bag"}
    assert set(light["contains"]) == set(PROCESSES) - others


def test_a_dock_is_detected_by_a_pose_of_the_estimator_in_the_frame_of_the_docking_server(topics):
    (detected,) = re.findall(r"detected_dock_pose:=(\w+)", DOCKING.read_text(encoding="utf-8"))
    assert topics[detected] == "geometry_msgs/msg/PoseStamped"
    server = read(DOCKING)["docking_server"]["ros__parameters"]
    assert server["base_frame"] == PARAMETERS["base_frame"].default
    lamp = server["lamp"]
    assert lamp["staging_x_offset"] < lamp["external_detection_translation_x"] < 0


def test_an_object_to_follow_is_a_pose_of_the_estimator_as_far_away_as_the_station(topics):
    (named,) = re.findall(r"pose_topic: (\w+)", FOLLOWING.read_text(encoding="utf-8"))
    assert topics[named] == "geometry_msgs/msg/PoseStamped"
    server = read(FOLLOWING)["following_server"]["ros__parameters"]
    assert server["base_frame"] == PARAMETERS["base_frame"].default
    assert server["desired_distance"] == math.hypot(*FormationSettings().station_m)


@NAMED
def test_every_value_in_an_example_is_one_that_the_node_takes(path):
    for name, values, _ in given(path):
        declared = importlib.import_module(f"uuv_optical_array.nodes.{name}").PARAMETERS
        for key, value in values.items():
            assert type(value) is type(declared[key].default), key
            declared[key].check(key, value)


@pytest.mark.parametrize("path", FILTERS, ids=lambda path: path.name)
def test_a_filter_fuses_all_that_a_topic_of_the_estimator_has(path, topics):
    ours = values_of(path)
    ((_, section),) = [item for item in read(path).items() if "ekf" in item[0]]
    filter_ = section["ros__parameters"]
    sources = {key: value for key, value in filter_.items() if re.fullmatch(r"(odom|pose)\d", key)}
    assert len(sources) == 1
    for key, topic in sources.items():
        assert topics[topic] == KINDS[key[:-1]]
        assert topic != "relative_odometry" or ours["tracking"]
        fused = filter_[f"{key}_config"]
        assert len(fused) == 15
        measured = 12 if key.startswith("odom") else 6
        assert fused == [True] * measured + [False] * (15 - measured)
    placed = {ours["tf_child_frame"]} if ours["publish_tf"] else set()
    assert filter_["base_link_frame"] not in placed, "two would place it"
    if filter_["world_frame"] == ours["beacon_frame"]:
        assert filter_["base_link_frame"] == ours["tf_child_frame"]
    else:
        # The way from the world to the beacon: the survey in the file's head, and /tf_static.
        assert ours["publish_tf"]
        assert f"--frame-id {filter_['world_frame']} --child-frame-id {ours['leader_frame']}" in (
            path.read_text(encoding="utf-8")
        )
        assert filter_["base_link_frame"] == ours["base_frame"]


@pytest.mark.parametrize("path", LAUNCHES, ids=lambda path: path.name)
def test_a_launch_file_remaps_topics_that_are_there(path, topics):
    for name, _, remaps in given(path):
        if name == "estimator_node":
            assert remaps.keys() <= topics.keys()
            of = {ours: topics[ours] for ours, to in remaps.items() if to.endswith("pose_cov")}
            assert set(of.values()) <= {KINDS["pose"]}


def test_mavros_looks_up_the_frame_that_hangs_below_the_followers():
    path = next(path for path in LAUNCHES if "landing" in path.name)
    ours, text = values_of(path), path.read_text(encoding="utf-8")
    assert (ours["publish_tf"], ours["tf_parent"]) == (True, "base")
    looked_up = re.search(r"tf.listen: true.*tf.child_frame_id: ([\w/]+)", text)
    assert looked_up[1] == ours["beacon_frame"]
    sent = re.search(r"tf.send: true.*tf.child_frame_id: ([\w/]+)", text)
    assert sent[1] == ours["base_frame"]


@NAMED
def test_what_mavros_and_filters_read_is_in_rep_103(path):
    ours = values_of(path)
    for key in ("beacon_frame", "base_frame", "tf_child_frame"):
        assert not ours[key].endswith(("_ned", "_frd"))
