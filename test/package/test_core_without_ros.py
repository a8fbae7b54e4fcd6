"""The core stands without ROS: no module outside `nodes` and `commands` may import it."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import PATIENCE_S

import uuv_optical_array
from uuv_optical_array.core.numerics import compilation

PACKAGE = Path(uuv_optical_array.__file__).resolve().parent
ROS = re.compile(r"(rclpy|launch|ament|tf2|tf_transformations)|\w*_(msgs|interfaces)$")
CORE = sorted(
    path
    for path in PACKAGE.rglob("*.py")
    if path.relative_to(PACKAGE).parts[0] not in ("nodes", "commands")
)


def ros_imports(source):
    """Name the ROS packages that a module imports, at the top or inside a function."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.append(node.module)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
            ("import_module", "__import__")
        ):
            found += [
                argument.value
                for argument in node.args
                if isinstance(argument, ast.Constant) and isinstance(argument.value, str)
            ]
    return [name for name in found if ROS.match(name.partition(".")[0])]


@pytest.mark.parametrize("path", CORE, ids=[str(path.relative_to(PACKAGE)) for path in CORE])
def test_a_core_module_imports_nothing_of_ros(path):
    assert ros_imports(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "source",
    [
        "import rclpy",
        "import numpy, rclpy.node as node",
        "from rclpy.node import Node",
        "def late():\n    from sensor_msgs.msg import Image",
        "if TYPE_CHECKING:\n    import geometry_msgs.msg",
        "try:\n    import tf2_ros\nexcept ImportError:\n    pass",
        "from launch_ros.actions import Node",
        "from ament_index_python import packages",
        "import tf_transformations",
        "importlib.import_module('uuv_array_msgs.msg')",
        "__import__('launch')",
    ],
)
def test_the_guard_sees_every_way_to_import_ros(source):
    assert len(ros_imports(source)) == 1


@pytest.mark.parametrize("source", ["import numpy", "from . import launch", "x = 'rclpy'"])
def test_the_guard_lets_the_rest_pass(source):
    assert ros_imports(source) == []


IMPORT_ALL = """
import importlib, re, sys
ros, modules = re.compile(sys.argv[1]), sys.argv[2:]

class Block:
    def find_spec(self, name, path=None, target=None):
        if ros.match(name.partition(".")[0]):
            raise ImportError(f"{name}: there is no ROS here")

sys.meta_path.insert(0, Block())
try:
    import rclpy
except ImportError as error:
    assert "no ROS here" in str(error)
else:
    raise AssertionError("the block does not block")
for module in modules:
    importlib.import_module(module)
print(len(modules))
"""


def test_every_core_module_loads_on_a_computer_without_ros():
    modules = [
        ".".join((PACKAGE.name, *path.relative_to(PACKAGE).with_suffix("").parts))
        for path in CORE
        if path.name not in ("__init__.py", "__main__.py")
        # That one is Numba's, which is an extra.
        if compilation.installed() or path.stem != "compiled_math"
    ]
    assert {"uuv_optical_array.estimation.estimator", "uuv_optical_array.forward.scene"} <= set(
        modules
    )
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", IMPORT_ALL, ROS.pattern, *modules],
        cwd=PACKAGE.parent,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == str(len(modules))
