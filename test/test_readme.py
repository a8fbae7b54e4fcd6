"""The README's tables are the code's own declarations."""

import importlib
from pathlib import Path

import pytest

from uuv_optical_array.commands import COMMANDS
from uuv_optical_array.core import files
from uuv_optical_array.nodes.shared.parameters import markdown_table

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
NODES = ("simulator", "feature", "estimator", "formation", "vehicles")


@pytest.mark.parametrize("node", NODES)
def test_parameter_table_of_each_node_is_the_declared_one(node):
    module = importlib.import_module(f"uuv_optical_array.nodes.{node}_node")
    assert markdown_table(module.PARAMETERS) in README


def test_every_ready_scene_and_every_command_is_named():
    scenes = sorted(path.stem for path in files.shared_file("config/scenes").glob("*.yaml"))
    assert all(f"| `{scene}` |" in README for scene in scenes)
    commands = [module.__name__.rpartition(".")[2] for module in COMMANDS]
    assert all(f"uuv_array {command}" in README for command in commands)
