"""Ctrl-C while a program is imported ends it with one line, whatever the import is at."""

import subprocess
import sys

import command_line
import pytest
from conftest import PATIENCE_S

# An exception in the import of a module that others do without would pass for its absence.
PRESS = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class CtrlC:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, CtrlC())
from uuv_optical_array import programs
sys.argv[1:] = {words!r}
programs.{program}()
"""


def pressed(program, module, *words):
    """Run a program with Ctrl-C as it imports a module; return exit code and what it wrote."""
    code = PRESS.format(program=program, module=module, words=list(words))
    done = command_line.python(code)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("module", ["uuv_optical_array.commands", "ruamel.yaml", "scipy.spatial"])
def test_a_command_says_so_and_exits_with_130(module):
    assert pressed("uuv_array", module, "limits") == (130, "interrupted\n")


@pytest.mark.parametrize(
    "program", ["simulator_node", "feature_node", "estimator_node", "formation_node"]
)
def test_a_node_ends_as_it_does_whenever_it_is_interrupted(program):
    assert pressed(program, "rclpy") == (0, "")


def test_what_a_command_imports_later_is_interrupted_in_a_line_too():
    assert pressed("uuv_array", "rclpy.exceptions", "follow") == (130, "interrupted\n")


def test_ctrl_c_that_comes_twice_does_not_kill_a_node_that_ends():
    # From the terminal and from launch.
    code = """
import atexit, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from uuv_optical_array import programs
from uuv_optical_array.nodes.shared import node
def press_twice(executor):
    executor.create_task(os.kill, os.getpid(), signal.SIGINT)
    atexit.register(os.kill, os.getpid(), signal.SIGINT)
    return spin(executor)
spin, node.spin = node.spin, press_twice
programs.vehicles_node()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, timeout=PATIENCE_S, check=False
    )
    assert (done.returncode, done.stdout) == (0, b"")
    assert b"Traceback" not in done.stderr


def test_without_ctrl_c_a_program_runs():
    code, text = pressed("vehicles_node", "none", "--ros-args", "-p", "rate_hz:=0.0")
    assert code == 1
    assert "rate_hz" in text
