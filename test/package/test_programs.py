"""How programs start: with one thread of BLAS, and Ctrl-C meanwhile ends them with one line."""

import os
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


@pytest.mark.parametrize("wanted", ["", "2"])
def test_blas_has_one_thread_unless_the_user_wants_more(wanted, monkeypatch):
    if wanted and (os.cpu_count() or 1) < 2:
        pytest.skip("there is one processor, for which BLAS has one thread whatever is wanted")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if wanted:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", wanted)
    code = """
import os, sys
from contextlib import suppress
from uuv_optical_array import programs
sys.argv[1:] = ["--version"]
with suppress(SystemExit):
    programs.uuv_array()
import scipy.linalg
print(len(os.listdir("/proc/self/task")))
"""
    threads = int(command_line.python(code).stdout.split()[-1])
    assert threads > 1 if wanted else threads == 1
