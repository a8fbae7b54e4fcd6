"""Without an extra, what needs it says in one line what to install; the rest does without."""

import sys

import command_line
import pytest

from uuv_optical_array.core.extras import NotInstalled, install_line, needs

# A machine without some packages: none of them can be imported.
WITHOUT = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {missing!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
from uuv_optical_array import programs
sys.argv[1:] = {words!r}
programs.{program}()
"""
ROS = ("rclpy", "sensor_msgs", "nav_msgs", "geometry_msgs", "std_msgs", "diagnostic_msgs")


def without(missing, program, *words, folder=None):
    """Run a program without some packages; return exit code and what it wrote."""
    code = WITHOUT.format(missing=missing, program=program, words=list(map(str, words)))
    done = command_line.python(code, cwd=folder)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("uuv_array", ("follow",)),
        ("uuv_array", ("commission",)),
        ("estimator_node", ()),
        ("vehicles_node", ()),
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
