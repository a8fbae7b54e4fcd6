"""What is compiled is kept on disk: once for all processes, and not for ever."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from uuv_optical_array.control.follow_record import least_distance
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.information.likelihood import censored

numba = pytest.importorskip("numba", reason="Numba is not installed")
pytestmark = pytest.mark.skipif(not compilation.installed(), reason="Numba is not installed")

WAIT_AND_COMPILE = """
import sys
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.unknowns.coordinates import quarter_turn
compilation.compiled(quarter_turn)
print("ready", flush=True)
sys.stdin.readline()
function = compilation.prepare(quarter_turn, 0.1, 0.2)
print(sum(function.stats.cache_misses.values()), function(0.1, 0.2))
"""
FOLDER = (
    "from uuv_optical_array.core.numerics import compilation; print(compilation.cache_folder())"
)


def test_of_processes_that_need_a_function_at_once_one_compiles_it(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    command = [sys.executable, "-c", WAIT_AND_COMPILE]
    processes = [subprocess.Popen(command, env=environment, **pipes) for _ in range(3)]
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    answers = sorted(process.communicate()[0].strip() for process in processes)
    assert answers == ["0 (0.2, -0.1)", "0 (0.2, -0.1)", "1 (0.2, -0.1)"]


def test_the_folder_in_use_is_kept_and_of_others_the_latest(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def folder():
        command = [sys.executable, "-c", FOLDER]
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return run.stdout.strip()

    own = folder()
    assert os.path.isdir(own)
    # Other versions were used since, the last one most recently.
    for hours in range(10):
        other = tmp_path / "compiled" / f"version {hours}"
        other.mkdir()
        os.utime(other, (time.time(), time.time() - 3600 * (10 - hours)))
    os.utime(own, (0, 0))
    assert folder() == own
    kept = {path.name for path in (tmp_path / "compiled").iterdir()}
    assert kept == {os.path.basename(own), *(f"version {hours}" for hours in range(3, 10))}


def test_another_copy_of_the_sources_or_a_newer_one_has_a_folder_of_its_own(tmp_path):
    # Numba compiles anew there, and nobody is to wait for what he takes for compiled.
    package = Path(compilation.__file__).parents[2]
    copy = tmp_path / "copy" / package.name
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))

    def folder(path):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(path)}
        options = {"env": environment, "capture_output": True, "text": True, "check": True}
        return subprocess.run([sys.executable, "-c", FOLDER], cwd=path, **options).stdout

    folders = [folder(package.parent), folder(copy.parent), folder(package.parent)]
    os.utime(copy / "core" / "geometry.py")
    folders.append(folder(copy.parent))
    assert folders[0] == folders[2]
    assert len(set(folders)) == 3


def test_a_function_whose_changes_would_go_unnoticed_is_not_compiled():
    with pytest.raises(ValueError, match=r"least_distance.*move the function"):
        compilation.compiled(least_distance)


WITH_INNER_FUNCTIONS = """
import numba
from uuv_optical_array.core.numerics import compilation, linked_functions
from uuv_optical_array.estimation.information.likelihood import censored
numba.__version__ = {version!r}
function = compilation.prepare(censored, 3.0, 5.0, 1.0, 2.0)
print(bool(linked_functions.options()), *function(3.0, 5.0, 1.0, 2.0))
"""


@pytest.mark.parametrize("known", [True, False])
def test_on_a_numba_that_is_not_known_inner_functions_are_compiled_in_its_own_way(tmp_path, known):
    version = numba.__version__ if known else "99.0.0"
    run = subprocess.run(
        [sys.executable, "-c", WITH_INNER_FUNCTIONS.format(version=version)],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    linked, *answer = run.stdout.split()
    assert linked == str(known)
    np.testing.assert_allclose([float(x) for x in answer], censored(3.0, 5.0, 1.0, 2.0), rtol=1e-12)
