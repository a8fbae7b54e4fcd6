"""The SROS2 policy is that of the nodes' interfaces; nodes write into cache and log alone."""

import os
import sys
from fnmatch import fnmatch
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rclpy
from command_line import begun, ended, python

from uuv_optical_array import programs
from uuv_optical_array.core.storage import files
from uuv_optical_array.nodes.bringup import security

POLICY = files.shared_file("config/security/policy.xml")
# The elements that one of the SROS2 policy schema 0.2.0 may hold, and the attributes that it has.
SCHEMA = {
    "policy": ({"enclaves"}, [{"version"}]),
    "enclaves": ({"enclave"}, [set()]),
    "enclave": ({"profiles"}, [{"path"}]),
    "profiles": ({"profile"}, [set()]),
    "profile": ({"topics", "services"}, [{"ns", "node"}]),
    "topics": ({"topic"}, [{"publish"}, {"subscribe"}]),
    "services": ({"service"}, [{"reply"}]),
}
# What every node of rclpy has beside the entities of its own.
OF_ROS = {
    ("topics", "publish"): {"/rosout"},
    ("topics", "subscribe"): {"/clock"},
    ("services", "reply"): {"~/*"},
}


OF_ALL = {"/rosout", "/clock", "/diagnostics", "/tf", "/tf_static", "/parameter_events"}


def rules(node):
    """Return what a node declares, as rclpy's own lists of its entities have it."""
    own = node.get_fully_qualified_name()
    services = {service.service_name.replace(own, "~", 1) for service in node.services}
    return {
        ("topics", "publish"): {each.topic_name for each in node.publishers},
        ("topics", "subscribe"): {each.topic_name for each in node.subscriptions},
        ("services", "reply"): services,
    }


def enclaves(text):
    found = ElementTree.fromstring(text).iter("enclave")
    return {
        Path(each.get("path")).name: ElementTree.tostring(each, "unicode").strip() for each in found
    }


def test_every_node_that_is_installed_has_an_enclave():
    scripts = {script.name for script in entry_points(group="console_scripts")}
    nodes = {name for name in scripts & set(dir(programs)) if name.endswith("_node")}
    assert "estimator_node" in nodes
    assert nodes <= set(security.PROCESSES)


@pytest.mark.usefixtures("compiled_fit")
def test_the_policy_is_made_of_the_nodes_and_allows_each_what_it_declares_and_no_more(
    lab, scene_file, capsys
):
    lab.begin({"scene": scene_file, "estimator_node:method": "sam"})
    declared = {}

    def noted(executable, make):
        for node in make():
            declared[executable, node.get_name()] = rules(node)
            yield node

    processes = {
        executable: lambda executable=executable, make=make: noted(executable, make)
        for executable, make in security.PROCESSES.items()
    }
    text = security.policy(processes)
    kept = enclaves(POLICY.read_text(encoding="utf-8"))
    if find_spec("viser") is None:
        assert "view_node is left out: " in capsys.readouterr().err
        del kept["view_node"]
    assert enclaves(text) == kept
    assert set(kept) == {executable for executable, _ in declared}
    allowed = {}
    for enclave in ElementTree.fromstring(text).iter("enclave"):
        executable = Path(enclave.get("path")).name
        for profile in enclave.iter("profile"):
            allowed[executable, profile.get("node").removesuffix("*")] = {
                (group.tag, verb): {entry.text for entry in group}
                for group in profile
                for verb in group.attrib
            }
    for groups in declared.values():
        assert all(service.startswith("~/") for service in groups["services", "reply"])
        groups["services", "reply"] = set()  # all are the node's own, which one rule allows
    assert allowed == {
        name: {group: names | OF_ROS[group] for group, names in groups.items()}
        for name, groups in declared.items()
    }


def test_a_namespace_has_enclaves_and_names_of_its_own(lab, scene_file):
    """So that followers in namespaces do not mix: no topic but those of ROS is outside."""
    given = {"scene": scene_file, "estimator_node:method": "sam", "publish_tf": True}
    lab.begin(given, "-r", "__ns:=/fleet/rov")
    ours = {name: make for name, make in security.PROCESSES.items() if name.endswith("_node")}
    enclaves = [*ElementTree.fromstring(security.policy(ours)).iter("enclave")]
    for enclave in enclaves:
        assert enclave.get("path").startswith("/uuv_optical_array/fleet/rov/")
        for profile in enclave.iter("profile"):
            assert profile.get("ns") == "/fleet/rov"
    topics = {topic.text for enclave in enclaves for topic in enclave.iter("topic")}
    assert "/fleet/rov/array/features" in topics
    outside = {topic for topic in topics if not topic.startswith(("/fleet/rov/", "~/"))}
    assert outside <= OF_ALL, outside


# What others' nodes serve and say, by the sources of RViz 14.3.1 and rosbag2 0.33.3: the node by
# which RViz hears /tf has its address in its name.
OTHERS = [
    ("rviz2", "rviz", "services", "~/reset_time"),
    ("rviz2", "transform_listener_impl_55ba0e4bba60", "services", "~/get_type_description"),
    ("rviz2", "transform_listener_impl_55ba0e4bba60", "topics", "/tf_static"),
    ("ros2_bag", "rosbag2_recorder", "services", "~/is_discovery_running"),
    ("ros2_bag", "rosbag2_recorder", "topics", "/events/rosbag2_messages_lost"),
]


@pytest.mark.parametrize(("executable", "node", "group", "name"), OTHERS)
def test_the_policy_allows_what_rviz_and_rosbag2_have(executable, node, group, name):
    root = ElementTree.parse(POLICY).getroot()
    (enclave,) = root.findall(f".//enclave[@path='/uuv_optical_array/{executable}']")
    (profile,) = [each for each in enclave.iter("profile") if fnmatch(node, each.get("node"))]
    assert any(fnmatch(name, entry.text) for entry in profile.findall(f"{group}/*"))


def test_a_policy_is_printed_where_ros_is_secured_too():
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    secured = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    command = [sys.executable, "-m", security.__name__, "--ros-args", "-r", "__ns:=/rov"]
    with begun(command, env=environment | secured) as process:
        printed, told = ended(process)
    assert set(enclaves(printed)) <= set(security.PROCESSES)
    assert "vehicles_node" not in told  # whose leader waits, where it runs


@pytest.mark.parametrize(
    ("word", "code", "text"),
    [("--help", 0, "[--ros-args ...]"), ("--namespace", 2, "unrecognized arguments: --namespace")],
)
def test_help_and_a_wrong_option_end_the_program_without_a_policy(
    monkeypatch, capsys, word, code, text
):
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "false")  # as the program has it
    with pytest.raises(SystemExit) as end:
        security.main([word])
    printed, told = capsys.readouterr()
    assert end.value.code == code
    assert text in printed + told
    assert "<policy" not in printed
    assert not rclpy.ok()


def test_the_policy_has_the_form_of_the_schema():
    root = ElementTree.parse(POLICY).getroot()
    assert (root.tag, root.get("version")) == ("policy", "0.2.0")
    for element in root.iter():
        if element.tag in ("topic", "service"):
            assert element.text.startswith(("/", "~/"))
            assert "*" not in element.text or (element.tag, element.text) == ("service", "~/*")
            assert not [*element, *element.attrib]
            continue
        children, attributes = SCHEMA[element.tag]
        assert {child.tag for child in element} <= children
        assert len(element)
        assert set(element.keys()) in attributes
        if element.tag in ("topics", "services"):
            assert set(element.attrib.values()) == {"ALLOW"}


def test_sros2_takes_the_policy():
    reason = "no sros2: the policy was held to its form alone, and no node was run secured"
    sros2 = pytest.importorskip("sros2.policy", reason=reason)
    sros2.load_policy(POLICY)


# Runs all nodes for a moment, and prints every path that was opened for writing, made or renamed.
WRITES = """
import os, sys
paths = []
def hook(event, arguments):
    if event == "open":
        path, mode, flags = arguments
        if isinstance(path, int) or not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            return
        paths.append(path)
    elif event in ("os.mkdir", "os.remove", "os.rename", "os.symlink", "os.link", "os.truncate"):
        paths.extend(path for path in arguments[:2] if isinstance(path, (str, bytes)))
sys.addaudithook(hook)
import rclpy
from uuv_optical_array.nodes.shared.node import fastest_executor, spin, start
from uuv_optical_array.nodes.bringup.security import PROCESSES
start(["--ros-args", "-p", "scene:=" + sys.argv[1], "-p", "estimator_node:method:=sam"])
executor = fastest_executor()
nodes = [node for name in ("simulator_node", "feature_node", "estimator_node", "formation_node",
         "vehicles_node") for node in PROCESSES[name]()]
for node in nodes:
    executor.add_node(node)
spin(executor, lambda: not nodes[3].diagnostics.totals["answered"])
rclpy.try_shutdown()
open(os.environ["XDG_CACHE_HOME"] + "/witness", "w").close()  # the hook sees it
print(*sorted({os.path.abspath(os.fsdecode(path)) for path in paths}), sep="\\n")
"""


def test_nodes_write_into_the_cache_and_the_log_alone(tmp_path, scene_file):
    own, others = tmp_path / "own", [tmp_path / name for name in ("home", "here", "scratch")]
    for folder in (own, *others):
        folder.mkdir()
    places = {"HOME": "home", "PWD": "here", "TMPDIR": "scratch"}
    environment = {
        **os.environ,
        **{name: str(tmp_path / place) for name, place in places.items()},
        "XDG_CACHE_HOME": str(own),
        "ROS_LOG_DIR": str(own),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }
    done = python(WRITES, scene_file, env=environment, cwd=tmp_path / "here")
    assert done.returncode == 0, done.stderr
    written = [Path(line) for line in done.stdout.splitlines()]
    kept = (own, Path(os.environ["NUMBA_CACHE_DIR"]).resolve(), Path("/dev"))
    astray = [path for path in written if not any(path.is_relative_to(each) for each in kept)]
    assert not astray
    assert own / "witness" in written
    for folder in others:
        assert not list(folder.rglob("*"))
