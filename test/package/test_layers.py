"""What imports what: up the table of the design page, in no circle, and ROS in the nodes alone."""

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter

import pytest
from pages import PACKAGE, ROOT

PREFIX = f"{PACKAGE.name}."
DESIGN = (ROOT / "docs/design.md").read_text(encoding="utf-8")
ORDER = re.findall(r"^\| `(\w+)/` \|", DESIGN, re.MULTILINE)
ROS = re.compile(r"(rclpy|launch|ament|tf2|tf_transformations)|\w*_(msgs|interfaces)$")


def called(node):
    """Return the last name of what a call calls."""
    return getattr(node.func, "attr", None) or getattr(node.func, "id", "")


@cache
def imports(source):
    """Return the names that a module imports, at the top or inside a function."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.level == 0:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Call) and called(node).endswith(("import_module", "import__")):
            names |= {word.value for word in node.args if isinstance(word, ast.Constant)}
    return names


def ros_imports(source):
    return [name for name in imports(source) if ROS.match(name.partition(".")[0])]


def own_imports(source):
    """Return what a module imports of the package, without the package's name."""
    return {name.removeprefix(PREFIX) for name in imports(source) if name.startswith(PREFIX)}


SOURCES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path.read_text(encoding="utf-8")
    for path in sorted(PACKAGE.rglob("*.py"))
}
FOLDERS = sorted(name.removesuffix("__init__") for name in SOURCES if name.endswith("__init__"))
CORE = [name for name in SOURCES if name.partition(".")[0] not in ("nodes", "commands")]
# A study has a command; other modules of the folder are its parts, or what studies share.
STUDIES = {
    name.split(".")[1]
    for name, source in SOURCES.items()
    if name.startswith("studies.") and "def add_options(" in source
}


@cache
def imported():
    """Return what each module imports of the package; to parse them all takes seconds."""
    return {name: own_imports(source) for name, source in SOURCES.items()}


def neighbours(modules, folder):
    """Return what each file or folder of a folder, such as ``core.``, imports of the others."""
    own = {name: name[len(folder) :].split(".")[0] for name in modules if name.startswith(folder)}
    result = {entry: set() for entry in own.values() if entry != "__init__"}
    for name in own.keys() - {f"{folder}__init__"}:
        for other in modules[name]:
            if other.startswith(folder):
                result[own[name]].add(other[len(folder) :].split(".")[0])
    return {entry: others & result.keys() - {entry} for entry, others in result.items()}


def test_the_table_of_the_design_has_every_folder():
    assert sorted(ORDER) == sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))


@pytest.mark.parametrize("folder", ORDER)
def test_a_folder_imports_only_from_those_above_it(folder):
    below = set(ORDER[ORDER.index(folder) :])
    assert not neighbours(imported(), "")[folder] & below


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_modules_of_a_folder_import_one_way(folder):
    TopologicalSorter(neighbours(imported(), folder)).prepare()


def test_a_study_imports_no_other():
    assert {"accuracy", "drives", "paper"} <= STUDIES
    assert not STUDIES & {"shared", "mismatches", "docking_smoother"}
    for study, others in neighbours(imported(), "studies.").items():
        assert not others & STUDIES, study


def test_no_core_module_imports_ros():
    names = {name: ros_imports(SOURCES[name]) for name in CORE}
    assert not any(names.values()), names


@pytest.mark.parametrize(
    ("source", "name"),
    [
        ("import numpy, rclpy.node as node", "rclpy.node"),
        ("def late():\n    from sensor_msgs.msg import Image", "sensor_msgs.msg.Image"),
        ("if TYPE_CHECKING:\n    import geometry_msgs.msg", "geometry_msgs.msg"),
        ("try:\n    import tf2_ros\nexcept ImportError:\n    pass", "tf2_ros"),
        ("from launch_ros.actions import Node", "launch_ros.actions.Node"),
        ("from ament_index_python import packages", "ament_index_python.packages"),
        ("import tf_transformations", "tf_transformations"),
        ("importlib.import_module('uuv_array_msgs.msg')", "uuv_array_msgs.msg"),
        ("__import__('launch')", "launch"),
    ],
)
def test_the_guards_see_every_way_to_import(source, name):
    assert ros_imports(source) == [name]
    assert ros_imports(source.replace(name.partition(".")[0], "other")) == []
    own = source.replace(name.partition(".")[0], f"{PREFIX}a")
    assert any(found.startswith("a") for found in own_imports(own))


def test_a_circle_is_seen():
    circle = {"a.one": {"a.two.thing"}, "a.two.inner": {"a.one.thing"}}
    with pytest.raises(CycleError):
        TopologicalSorter(neighbours(circle, "a.")).prepare()
