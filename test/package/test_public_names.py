"""What ``import uuv_optical_array`` offers; no two modules of tests have one name."""

from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import pytest
from command_line import python

import uuv_optical_array

ROOT = Path(__file__).parents[2]
NAMES = [name for name in uuv_optical_array.__all__ if name != "__version__"]


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_is_there_and_documented(name):
    assert getattr(uuv_optical_array, name).__doc__


def test_the_version_is_that_of_the_package():
    assert uuv_optical_array.__version__ == ElementTree.parse(ROOT / "package.xml").findtext(
        "version"
    )
    assert f'version="{uuv_optical_array.__version__}"' in (ROOT / "setup.py").read_text()


def test_a_name_that_is_not_public_is_refused():
    with pytest.raises(AttributeError, match="nonsense"):
        _ = uuv_optical_array.nonsense


def test_importing_the_package_imports_none_of_its_modules():
    program = (
        "import sys, uuv_optical_array; "
        "print(sum(name.startswith('uuv_optical') for name in sys.modules))"
    )
    assert python(program).stdout.strip() == "1"


SIMULATION = """import numpy as np
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
ForwardModel(load_scene("reference")).light(np.tile([-6.0, 0, 0, 0, 0], (10_000, 1)))"""
NODES = "simulator", "feature", "estimator", "formation", "follower", "vehicles"


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        (SIMULATION, {"numba"}),
        (
            "from uuv_optical_array.commands import build_parser; build_parser()",
            {"matplotlib", "rclpy", "numba", "dask", "zarr", "rosbags"},
        ),
        # Each takes a good part of a second to import, and no node needs it before its first frame.
        (
            "; ".join(f"import uuv_optical_array.nodes.{node}_node" for node in NODES),
            {"matplotlib", "numba", "scipy.stats"},
        ),
    ],
    ids=["simulation and tables", "commands", "nodes"],
)
def test_what_only_some_need_is_not_loaded_for_the_others(code, heavy):
    done = python(f"{code}\nimport sys; print(*{heavy} & set(sys.modules))")
    assert (done.returncode, done.stdout) == (0, "\n"), done.stderr


def test_each_module_of_tests_and_benchmarks_has_a_name_of_its_own():
    """launch_testing imports each by its name alone."""
    names = [
        path.stem for folder in ("test", "benchmarks") for path in (ROOT / folder).rglob("*.py")
    ]
    assert {name for name, count in Counter(names).items() if count > 1} <= {"__init__"}
