"""Every parameter is declared in full, checked at the start and at run time, and set by file."""

import math
import re
from importlib.util import find_spec

import numpy as np
import pytest
import rclpy
import yaml
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, ListParameters
from rclpy.parameter import Parameter

from uuv_optical_array.core.storage import files
from uuv_optical_array.nodes import (
    estimator_node,
    feature_node,
    formation_node,
    simulator_node,
    vehicles_node,
    view_node,
)
from uuv_optical_array.nodes.shared import node as shared_node

# Module, class, and a value of a parameter that is not its default.
NODES = {
    "simulator_node": (simulator_node, simulator_node.SimulatorNode, {"max_gap_s": 0.25}),
    "feature_node": (feature_node, feature_node.FeatureNode, {"min_peak_counts": 7.0}),
    "estimator_node": (estimator_node, estimator_node.EstimatorNode, {"neighbours": 32}),
    "formation_node": (formation_node, formation_node.FormationNode, {"min_distance_m": 3.0}),
    "vehicles_node": (vehicles_node, vehicles_node.VehiclesNode, {"command_timeout_s": 2.0}),
    "view_node": (view_node, view_node.ViewNode, {"max_rate_hz": 5.0}),
}
VISER = pytest.mark.skipif(find_spec("viser") is None, reason="the view needs the extra view")
ALL = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=VISER if name == "view_node" else ()) for name in NODES]
)
FOLLOW = files.shared_file("config/follow.yaml")
# What ROS itself declares on every node.
OF_ROS = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..*")
# A quantity's unit by how its name ends; the longest ending first.
UNITS = {
    "_m_per_s2": "m/s^2",
    "_deg_per_s2": "deg/s^2",
    "_m_per_s": "m/s",
    "_deg_per_s": "deg/s",
    "_per_s": "1/s",
    "_counts": "counts",
    "_rad": "rad",
    "_deg": "deg",
    "_hz": "Hz",
    "_m": "m",
    "_s": "s",
    "neighbours": "rows",
}
NUMBERS = (ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_INTEGER)


def begin(lab, name, scene_file, *arguments):
    """Start one node on a small scene."""
    lab.begin({"scene": scene_file}, *arguments)
    return lab.start(NODES[name][1])


def own_names(node):
    """Return the parameters that the package declared."""
    return [name for name in node.get_parameters_by_prefix("") if not OF_ROS.fullmatch(name)]


def bounds_of(node, name):
    """Return type and bounds of a number as `ros2 param describe` shows them."""
    descriptor = node.describe_parameter(name)
    (span,) = [*descriptor.floating_point_range, *descriptor.integer_range]
    kind = float if descriptor.type == ParameterType.PARAMETER_DOUBLE else int
    return kind, span.from_value, span.to_value


def set_to(node, name, value):
    (result,) = node.set_parameters([Parameter(name, value=value)])
    return result


@ALL
def test_every_parameter_is_described_with_meaning_unit_and_bounds_and_some_are_fixed(
    lab, name, scene_file
):
    node = begin(lab, name, scene_file)
    path = node.get_fully_qualified_name()
    listed = lab.call(ListParameters, f"{path}/list_parameters").result.names
    names = [given for given in listed if not OF_ROS.fullmatch(given)]
    assert set(names) == set(NODES[name][0].PARAMETERS)
    answer = lab.call(DescribeParameters, f"{path}/describe_parameters", names=names)
    for descriptor in answer.descriptors:
        words = descriptor.description.partition(" [")[0]
        assert len(words.split()) >= 2, descriptor
        unit = next((UNITS[end] for end in UNITS if descriptor.name.endswith(end)), None)
        if unit:
            assert descriptor.description.endswith(f" [{unit}]")
        assert descriptor.type == node.get_parameter(descriptor.name).type_.value
        if descriptor.type in NUMBERS:
            kind, low, high = bounds_of(node, descriptor.name)
            assert -math.inf < low < high < math.inf
            assert low <= node.get_parameter(descriptor.name).value <= high
            assert isinstance(node.get_parameter(descriptor.name).value, kind)
        if descriptor.read_only:
            result = set_to(node, descriptor.name, node.get_parameter(descriptor.name).value)
            assert not result.successful
            assert "read-only" in result.reason
    fixed = {descriptor.name for descriptor in answer.descriptors if descriptor.read_only}
    assert fixed >= {"scene", "rate_hz", "seed", "base_frame"} & set(names)


@ALL
def test_what_may_change_takes_both_bounds_and_refuses_all_beyond(lab, name, scene_file):
    lab.begin({"scene": scene_file, "formation_node:station_m": [-50.0, 0.0, 0.0]})
    node, tried = lab.start(NODES[name][1]), set()
    for parameter in own_names(node):
        descriptor = node.describe_parameter(parameter)
        if descriptor.read_only or descriptor.type not in NUMBERS:
            continue
        tried.add(parameter)
        kind, low, high = bounds_of(node, parameter)
        for value in (low, high):
            result = set_to(node, parameter, kind(value))
            assert result.successful, (parameter, value, result.reason)
            assert node.get_parameter(parameter).value == value
        beyond = {float: [low - 1e-3, high + 1e-3, math.nan, math.inf], int: [low - 1, high + 1]}
        cases = [(value, parameter) for value in beyond[kind]]
        cases += [(value, "Wrong parameter type") for value in ("much", True, [1.0, 2.0])]
        for value, reason in cases:
            result = set_to(node, parameter, value)
            assert not result.successful, (parameter, value)
            assert reason in result.reason, (parameter, value)
            assert node.get_parameter(parameter).value == high
    assert tried == {
        parameter
        for parameter, declared in NODES[name][0].PARAMETERS.items()
        if type(declared.default) in (int, float) and not declared.read_only
    }


@pytest.mark.parametrize(
    ("node", "name", "words"),
    [
        ("estimator_node", "method", "sam or sam_interpolated or least_squares"),
        ("estimator_node", "beacon_position_m", "3 numbers, each from -100 to 100 m"),
        ("simulator_node", "lamp_power", "numbers, each from 0 to 100"),
    ],
)
def test_words_to_choose_from_and_bounds_of_lists_are_described(lab, scene_file, node, name, words):
    node = begin(lab, node, scene_file)
    assert node.describe_parameter(name).additional_constraints == words


def test_whole_numbers_are_taken_for_any(lab, scene_file):
    whole = {"max_imu_age_s": 2, "beacon_position_m": [1, 2, 3]}
    lab.begin({"scene": scene_file} | {f"estimator_node:{name}": whole[name] for name in whole})
    node = lab.start(estimator_node.EstimatorNode)
    for name, value in whole.items():
        present = node.get_parameter(name)
        assert np.array_equal(present.value, value)
        assert present.type_.value == node.describe_parameter(name).type
        assert present.type_.name.startswith("DOUBLE")


@pytest.mark.skipif(
    not hasattr(rclpy.node.Node, "add_pre_set_parameters_callback"), reason="Humble checks before"
)
@pytest.mark.parametrize(
    ("parameter", "given"), [("max_surge_m_per_s", 1), ("station_m", [-5, 0, 0])]
)
def test_whole_numbers_are_taken_at_run_time_too(lab, parameter, given):
    lab.begin()
    node = lab.start(formation_node.FormationNode)
    result = lab.set(node, parameter, given)
    assert result.successful, result.reason
    present = node.get_parameter(parameter)
    assert present.type_.name.startswith("DOUBLE")
    assert np.array_equal(present.value, given)
    for bad in ("fast", True, [True, False, True]):
        assert not lab.set(node, parameter, bad).successful


@pytest.mark.skipif(
    not hasattr(rclpy.node.Node, "add_pre_set_parameters_callback"), reason="Humble checks before"
)
def test_a_bare_number_is_a_list_of_one_at_run_time(lab, scene_file):
    lab.begin({"scene": scene_file})
    simulator = lab.start(simulator_node.SimulatorNode)
    for power in (0.5, 2):
        result = lab.set(simulator, "lamp_power", power)
        assert result.successful, result.reason
        assert list(simulator.get_parameter("lamp_power").value) == [power]
    result = lab.set(lab.start(formation_node.FormationNode), "station_m", -5)
    assert result.reason == "station_m: 1 values; give 3"


@pytest.mark.parametrize("given", [0.5, 2])
def test_a_bare_number_is_a_list_of_one_at_the_start(lab, scene_file, given):
    lab.begin({"scene": scene_file, "lamp_power": given})
    node = lab.start(simulator_node.SimulatorNode)
    assert list(node.get_parameter("lamp_power").value) == [given]
    assert node.describe_parameter("lamp_power").type == ParameterType.PARAMETER_DOUBLE_ARRAY


SECTIONS = {  # as ROS matches them to /rov/formation_node
    "/rov/formation_node": True,
    "/**/formation_node": True,
    "rov: formation_node": True,
    "/*/formation_node": True,
    "/**": True,
    "formation_node": False,
    "/formation_node": False,
    "/other/formation_node": False,
    "/*/*/formation_node": False,
}


@pytest.mark.parametrize("section", SECTIONS)
def test_a_section_that_does_not_reach_its_node_is_named(section, lab, tmp_path, capfd):
    value = {"ros__parameters": {"min_distance_m": 2.5}}
    for name in reversed(section.split(": ")):
        value = {name: value}
    file = tmp_path / "mine.yaml"
    strangers = {"formation_node_2": {"ros__parameters": {"x": 1}}, "/**/other_node": {}}
    file.write_text(yaml.safe_dump(value | strangers), "utf-8")
    words = ["--ros-args", "--params-file", str(file)]
    shared_node.note_arguments(words)
    lab.begin({}, *words[1:])
    node = lab.start(formation_node.FormationNode, "rov")
    assert (node.parameters["min_distance_m"] == 2.5) is SECTIONS[section]
    told = [line for line in capfd.readouterr().err.splitlines() if "does not reach" in line]
    assert len(told) == (not SECTIONS[section])
    if told:
        words = f"the section {section} does not reach /rov/formation_node; call it /**/"
        assert words in told[0]


def test_a_name_that_no_node_has_is_reported_with_the_one_that_differs_by_a_slip(
    lab, scene_file, tmp_path, capfd
):
    given = tmp_path / "mine.yaml"
    words = "staton_m: [-5.0, 0.0, 0.0]", "use_imu: true", "scene: reference", "max_range: 9.0"
    given.write_text("/**:\n  ros__parameters:\n" + "".join(f"    {word}\n" for word in words))
    lab.begin({"scene": scene_file}, "--params-file", given)
    lab.start(NODES["feature_node"][1])
    told = [line for line in capfd.readouterr().err.splitlines() if "no node has" in line]
    slip, other = sorted(line.partition("]: ")[2] for line in told)[::-1]
    assert slip == "staton_m: no node has this parameter; did you mean station_m?"
    assert other.startswith("max_range: no node has this parameter; config/follow.yaml lists")


# Node, start parameter, and what the one line must name.
BAD_STARTS = [
    ("feature_node", "min_peak_counts:=.nan", ("nan", "from 0 to 65535 counts")),
    ("feature_node", "min_peak_counts:=high", ("'high' is not a number", "from 0 to 65535 counts")),
    ("feature_node", "scene:=7", ("7 is not a text", "in quotes")),
    ("estimator_node", "use_imu:=7", ("7 is not a switch", "true or false")),
    ("feature_node", "scene:=atlantis", ("atlantis", "follow", "reference")),
    ("feature_node", "scene:=broken.yaml", ("broken.yaml: not YAML",)),
    ("feature_node", "scene:=lamb.yaml", ("scene lamb: lamb: ", "did you mean lamp?")),
    ("simulator_node", "scene:=bare.yaml", ("scene bare: ", "effects.adc", "bits from 1 to 16")),
    ("estimator_node", "neighbours:=1", ("1", "from 2 to 10000 rows")),
    ("estimator_node", "tf_parent:=leader", ("leader", "beacon or base")),
    ("estimator_node", "use_image:=false", ("least_squares", "sam_interpolated")),
    ("simulator_node", "seed:=1.5", ("1.5 is not a whole number", "from -1 to")),
    ("simulator_node", "odometry_axes:=ned", ("ned", "flu or frd")),
    ("simulator_node", "others:=/rov_2/odometry /rov-3/odometry", ("'/rov-3/odometry' cannot",)),
    ("simulator_node", "others:=rov_2//odometry", ("such as /rov_2/odometry",)),
    ("simulator_node", "others:=/{fleet}/odometry", ("'/{fleet}/odometry' cannot name a topic",)),
    ("simulator_node", "beacon_position_m:=[0.0,0.0]", ("2 values", "3")),
    ("simulator_node", "beacon_position_m:=7.0", ("7.0 is not a list of numbers",)),
    ("simulator_node", "beacon_position_m:=[true,true,true]", ("[0]: True is not a number",)),
    ("simulator_node", "lamp_power:=[]", ("not a list of numbers",)),
    ("simulator_node", "beacon_position_m:=[0.0,0.0,-101.0]", ("[2]", "-101.0", "to 100 m")),
    ("formation_node", "station_m:=[-0.4,0.0,0.0]", ("-0.4", "from -50 to -0.5 m")),
    ("formation_node", "min_distance_m:=8.0", ("8", "4.5 m from the lamp", "move station_m")),
    ("vehicles_node", "command_timeout_s:=.inf", ("inf", "from 0.05 to 60 s")),
    (
        "vehicles_node",
        "leader_path:=zigzags",
        ("'zigzags' is neither", "mean zigzag?"),
    ),
]


BAD_SCENES = {
    "broken.yaml": "lamp: {beam_sigma_deg: [",
    "lamb.yaml": "lamb: {}",
    "bare.yaml": "extends: follow\neffects: {adc: null}",
}


@pytest.mark.parametrize(("name", "given", "words"), BAD_STARTS)
def test_a_bad_start_value_ends_the_node_with_one_line(name, given, words, monkeypatch, tmp_path):
    # A node that is accepted fails the test, in place of running for ever.
    monkeypatch.setattr(shared_node, "spin", lambda executor: pytest.fail("it was accepted"))
    monkeypatch.chdir(tmp_path)
    for file, text in BAD_SCENES.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    with pytest.raises(SystemExit) as end:
        NODES[name][0].main(["--ros-args", "-p", given])
    line = end.value.code
    assert isinstance(line, str)  # Python prints a text and exits with 1
    assert "\n" not in line.strip()
    for word in (given.partition(":=")[0], *words):
        assert word in line
    assert not rclpy.ok()


def uncommented(text):
    """Return the shipped file's text as it is when every value in it is in force."""
    return re.sub(r"^#(?=/| {2})", "", text, flags=re.MULTILINE)


def sections(text):
    """Return the values of a parameter file for every node: the common ones, then its own."""
    given = {path: section["ros__parameters"] for path, section in yaml.safe_load(text).items()}
    common = given.pop("/**")
    assert set(given) == {f"/**/{name}" for name in NODES}
    return {
        name: {key: common[key] for key in common.keys() & node.PARAMETERS.keys()}
        | given[f"/**/{name}"]
        for name, (node, *_) in NODES.items()
    }


def test_the_shipped_parameter_file_changes_nothing():
    assert yaml.safe_load(FOLLOW.read_text("utf-8")) is None


@ALL
def test_the_shipped_parameter_file_shows_every_parameter_with_its_default(name):
    shown = sections(uncommented(FOLLOW.read_text("utf-8")))[name]
    declared = NODES[name][0].PARAMETERS
    assert shown == {key: parameter.default for key, parameter in declared.items()}
    assert [type(shown[key]) for key in declared] == [type(p.default) for p in declared.values()]


def comments(text):
    """Yield the node, or `**` for all, each key and the comment above it."""
    node = comment = ""
    for line in uncommented(text).splitlines():
        key, words = line.partition(":")[0].strip(), line.strip()
        if words.startswith("#"):
            comment += words[1:]
        elif words.startswith("/"):
            node, comment = key.rpartition("/")[2], ""
        elif words and key != "ros__parameters":
            yield node, key, comment
            comment = ""


def test_the_shipped_parameter_file_explains_every_parameter_in_its_unit():
    explained = set()
    for node, key, comment in comments(FOLLOW.read_text("utf-8")):
        owners = NODES if node == "**" else [node]
        for owner in owners:
            parameter = NODES[owner][0].PARAMETERS.get(key)
            if parameter is not None:
                explained.add((owner, key))
                assert len(comment.split()) >= 3, key
                if unit := parameter.quantity.unit:
                    assert re.search(rf"[ ,]{re.escape(unit)}[,.;: ]", f"{comment} "), key
    assert explained == {(name, key) for name in NODES for key in NODES[name][0].PARAMETERS}


@ALL
def test_a_file_with_one_value_changes_that_value_and_nothing_else(lab, tmp_path, name):
    module, node_type, change = NODES[name]
    mine = tmp_path / "mine.yaml"
    mine.write_text(yaml.safe_dump({f"/**/{name}": {"ros__parameters": change}}))
    lab.begin({}, "--params-file", FOLLOW, "--params-file", mine)
    node = lab.start(node_type, "/fleet/rov_2")  # the path of the file begins with /**
    present = {given: node.get_parameter(given).value for given in own_names(node)}
    assert present == {given: p.default for given, p in module.PARAMETERS.items()} | change
