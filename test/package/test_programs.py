"""How programs start: with one thread of BLAS, Ctrl-C meanwhile, and without an extra."""

import os
import subprocess
import sys
from pathlib import Path

import command_line
import pytest

from uuv_optical_array.core.extras import NotInstalled, install_line, needs
from uuv_optical_array.forward.scene import load_scene

# Something is done where a module is to be imported.
AT_IMPORT = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class Finder:
    def find_spec(self, name, path=None, target=None):
        {code}
sys.meta_path.insert(0, Finder())
from uuv_optical_array import programs
sys.argv[1:] = {words!r}
programs.{program}()
"""
PRESS = "if name == {!r}: os.kill(os.getpid(), signal.SIGINT)"
MISSING = "if name.partition('.')[0] in {!r}: raise ModuleNotFoundError('No module named it')"
ROS = ("rclpy", "sensor_msgs", "nav_msgs", "geometry_msgs", "std_msgs", "diagnostic_msgs")


def begun(program, words, code, **options):
    words = list(map(str, words))
    text = AT_IMPORT.format(program=program, code=code, words=words)
    return command_line.python(text, **options)


def pressed(program, module, *words):
    """Run a program with Ctrl-C as it imports a module; return exit code and what it wrote."""
    # An exception in the import of a module that others do without would pass for its absence.
    done = begun(program, words, PRESS.format(module))
    return done.returncode, done.stdout + done.stderr


def without(missing, program, *words, folder=None):
    """Run a program without some packages; return exit code and what it wrote."""
    done = begun(program, words, MISSING.format(missing), cwd=folder)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("module", ["uuv_optical_array.commands", "ruamel.yaml", "scipy.spatial"])
def test_a_command_says_so_and_exits_with_130(module):
    assert pressed("uuv_array", module, "limits") == (130, "interrupted\n")


@pytest.mark.parametrize("program", ["simulator_node", "estimator_node"])
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
    done = command_line.python(code)
    assert (done.returncode, done.stdout) == (0, "")
    assert "Traceback" not in done.stderr


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


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("uuv_array", ("follow",)),
        ("uuv_array", ("commission",)),
        ("estimator_node", ()),
    ],
)
def test_without_ros_a_program_says_in_one_line_what_to_install(program, words, tmp_path):
    code, out, error = without(ROS, program, *words, folder=tmp_path)
    assert (code, out) == (1, "")
    assert len(error.splitlines()) == 1
    assert "-m pip install 'ros-diagnostic-msgs'" in error
    assert error.startswith(" ".join([program, *words]) + ": No module named")
    assert not list(tmp_path.iterdir())


def test_without_ros_the_rest_works(tmp_path, scene_file):
    code, out, error = without(ROS, "uuv_array", "table", "--scene", scene_file, folder=tmp_path)
    assert code == 0, error
    assert out.startswith("small.zarr: ")
    assert "signatures" in out


def test_a_table_names_the_extra_that_it_needs(tmp_path, scene_file):
    words = ("table", "--scene", scene_file)
    code, _, error = without(("distributed", "zarr"), "uuv_array", *words, folder=tmp_path)
    assert code == 1
    assert "-m pip install 'dask' 'distributed' 'zarr>=2.18'" in error
    assert len(error.splitlines()) == 1
    assert [file.name for file in tmp_path.glob("*.zarr")] == []


@pytest.mark.parametrize(("system", "force"), [(True, "--break-system-packages "), (False, "")])
def test_the_line_that_installs_is_for_this_python(system, force, tmp_path, monkeypatch):
    """PEP 668: pip refuses a Python of the system unless it is told to go on."""
    monkeypatch.setattr(sys, "prefix", sys.base_prefix if system else str(tmp_path))
    monkeypatch.setattr("sysconfig.get_path", lambda _: str(tmp_path))
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    assert install_line("view") == f"{sys.executable} -m pip install {force}'viser>=1.1'"


def test_a_fault_of_ours_does_not_pass_for_an_extra_that_is_missing(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "other.py").write_text("from uuv_optical_array.core.extras import nothing\n")
    with pytest.raises(ImportError, match="nothing"):
        needs("ros", "other")
    (tmp_path / "missing.py").write_text("import surely_not_installed\n")
    with pytest.raises(NotInstalled, match="surely_not_installed"):
        needs("ros", "missing")


PROGRAM = "from uuv_optical_array.programs import uuv_array; uuv_array()"


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    """A picture of an odd name, by a process in odd surroundings, and what that printed."""
    folder = tmp_path_factory.mktemp("odd")
    style = folder / "matplotlibrc"
    style.write_text("text.usetex: True\naxes.facecolor: black\nfont.size: 30\n", "utf-8")
    told = {"MPLBACKEND": "module://of_a_notebook", "MATPLOTLIBRC": str(style)}
    told["PYTHONIOENCODING"] = "utf-8:strict"
    picture = os.fsdecode(os.fsencode(folder) + b"/\xe8.png")
    done = command_line.python(PROGRAM, "budget", "--output", picture, env=os.environ | told)
    assert done.returncode == 0, done.stderr
    return Path(picture), done.stdout


def test_a_picture_is_the_same_whatever_matplotlib_is_told_elsewhere(odd, tmp_path):
    command_line.run("budget", "--output", tmp_path / "plain.png")
    assert odd[0].read_bytes() == (tmp_path / "plain.png").read_bytes()


def test_with_streams_that_are_closed_a_command_does_its_work(tmp_path):
    line = 'exec "$0" -c "$1" budget --output "$2" <&- >&- 2>&-'
    picture = tmp_path / "x.png"
    code = command_line.SKETCHING + PROGRAM
    shell = ["sh", "-c", line, sys.executable, code, str(picture)]
    assert subprocess.run(shell, check=False).returncode == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_names_of_files_may_be_of_any_bytes(odd, tmp_path):
    scene = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xe9.yaml"))
    scene.write_text("extends: reference\n", "utf-8")
    assert load_scene(scene).name == "\ufffd"  # which titles and files take
    picture, printed = odd
    assert "\\udce8.png" in printed
    assert picture.is_file()
