"""What is compiled is kept on disk: once for all processes, and not for ever."""

import importlib.metadata
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import python
from needs import numba

from uuv_optical_array.control.follow_record import least_distance
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.information.likelihood import censored
from uuv_optical_array.forward.optics import (
    transmit_beer,
    transmit_housing,
    transmit_lens,
    transmit_port,
)

pytestmark = numba

WAIT_AND_COMPILE = """
import os, sys
os.umask(0)
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.least_squares.misfit import chi_square_shape
compilation.compiled(chi_square_shape)
print("ready", flush=True)
sys.stdin.readline()
function = compilation.prepare(chi_square_shape, 6.0, 28.0)
print(sum(function.stats.cache_misses.values()), function(6.0, 28.0))
"""
FOLDER = (
    "from uuv_optical_array.core.numerics import compilation; print(compilation.cache_folder())"
)


def printed(code, cache, cwd=None):
    """Return the last line that a process prints that keeps what is compiled in a folder."""
    done = python(code, env={**os.environ, "NUMBA_CACHE_DIR": str(cache)}, cwd=cwd, input="go\n")
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


def at_once(code, words, **environment):
    """Start a process for each words, let them go when all are ready; return what they print."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    options = {"env": {**os.environ, **environment}, **pipes}
    processes = [subprocess.Popen([sys.executable, "-c", code, *own], **options) for own in words]
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    return [process.communicate()[0].strip() for process in processes]


def flip(path, bit):
    """Flip a bit of a file, counted from its beginning over and over."""
    content = bytearray(path.read_bytes())
    content[bit // 8 % len(content)] ^= 1 << bit % 8
    path.write_bytes(content)


@pytest.fixture(scope="module")
def begun_at_once(tmp_path_factory):
    """A cache that two processes began at once, and what they print."""
    cache = tmp_path_factory.mktemp("cache")
    return cache, sorted(at_once(WAIT_AND_COMPILE, [(), ()], NUMBA_CACHE_DIR=str(cache)))


@pytest.fixture
def kept(begun_at_once):
    """A cache in which a process kept a function."""
    return begun_at_once[0]


def test_of_processes_that_need_a_function_at_once_one_compiles_it(begun_at_once):
    _, answers = begun_at_once
    assert answers == ["0 (1.0, 2.0)", "1 (1.0, 2.0)"]


def copied(kept, cache):
    """Copy a cache; return the folder in it, and its files that are not empty."""
    shutil.copytree(kept, cache, dirs_exist_ok=True)
    (folder,) = cache.glob("compiled/*")
    return folder, [path for path in folder.rglob("*") if path.is_file() and path.stat().st_size]


def test_any_flipped_bit_is_found(kept, tmp_path):
    folder, paths = copied(kept, tmp_path)
    assert len(paths) == 3  # index, code, and their sum
    assert compilation.unharmed(folder)
    rng = np.random.default_rng(1)
    for path in paths:
        for bit in (int(bit) for bit in rng.integers(8 * path.stat().st_size, size=30)):
            flip(path, bit)
            assert not compilation.unharmed(folder), (path, bit)
            flip(path, bit)
            assert compilation.unharmed(folder), (path, bit)


@pytest.mark.parametrize("how", ["added", "gone", "of another name", "swapped", "no sum"])
def test_files_that_are_others_than_those_written_are_found(kept, tmp_path, how):
    folder, _ = copied(kept, tmp_path)
    code, index = sorted(folder.glob("*/*"))
    if how == "added":
        code.with_name("more.nbc").touch()
    elif how == "gone":
        code.unlink()
    elif how == "of another name":
        code.rename(f"{code}.other")
    elif how == "swapped":
        contents = index.read_bytes(), code.read_bytes()
        code.write_bytes(contents[0])
        index.write_bytes(contents[1])
    else:
        (folder / "sha256").unlink()
    assert not compilation.unharmed(folder)


def test_what_is_damaged_is_compiled_anew_by_one_process_of_several(kept, tmp_path):
    folder, _ = copied(kept, tmp_path)
    (folder / "fit.done").touch()
    code, index = sorted(folder.glob("*/*"))
    flip(code, 8 * (code.stat().st_size // 2))
    flip(index, 100)
    answers = at_once(WAIT_AND_COMPILE, [(), ()], NUMBA_CACHE_DIR=str(tmp_path))
    assert sorted(answers) == ["0 (1.0, 2.0)", "1 (1.0, 2.0)"]
    assert not (folder / "fit.done").exists()  # what else was there is gone, too
    assert compilation.unharmed(folder)


def test_what_another_process_adds_harms_nothing(kept, tmp_path):
    copied(kept, tmp_path)
    another = """
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.information.likelihood import censored
added = compilation.prepare(censored, 3.0, 5.0, 1.0, 2.0)
print(sum(added.stats.cache_misses.values()))
"""
    assert printed(another, tmp_path) == "1"
    both = (
        f"{WAIT_AND_COMPILE}{another}print(function.stats.cache_misses, added.stats.cache_misses)"
    )
    assert printed(both, tmp_path) == "Counter() Counter()"


def test_what_nobody_prepared_is_not_kept(kept, tmp_path):
    """Its file would be in no sum."""
    folder, _ = copied(kept, tmp_path)
    assert printed(f"{WAIT_AND_COMPILE}\nprint(function(6, 28))", tmp_path) == "(1.0, 2.0)"
    assert compilation.unharmed(folder)


def test_the_folder_in_use_is_kept_and_of_others_the_latest(tmp_path):
    own = printed(FOLDER, tmp_path)
    assert os.path.isdir(own)
    # Other versions were used since, the last one most recently.
    for hours in range(10):
        other = tmp_path / "compiled" / f"version {hours}"
        other.mkdir()
        os.utime(other, (time.time(), time.time() - 3600 * (10 - hours)))
    os.utime(own, (0, 0))
    assert printed(FOLDER, tmp_path) == own
    kept = {path.name for path in (tmp_path / "compiled").iterdir()}
    assert kept == {os.path.basename(own), *(f"version {hours}" for hours in range(3, 10))}


def test_another_copy_of_the_sources_or_a_newer_one_has_a_folder_of_its_own(tmp_path):
    # Numba compiles anew there, and nobody is to wait for what he takes for compiled.
    package = Path(compilation.__file__).parents[2]
    copy = tmp_path / "copy" / package.name
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))
    folders = [printed(FOLDER, tmp_path, path.parent) for path in (package, copy, package)]
    os.utime(copy / "core" / "geometry.py")
    folders.append(printed(FOLDER, tmp_path, copy.parent))
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
print(bool(linked_functions.options(inner=True)), *function(3.0, 5.0, 1.0, 2.0))
"""


@pytest.mark.parametrize("known", [True, False])
def test_on_a_numba_that_is_not_known_inner_functions_are_compiled_in_its_own_way(tmp_path, known):
    version = importlib.metadata.version("numba") if known else "99.0.0"
    linked, *answer = printed(WITH_INNER_FUNCTIONS.format(version=version), tmp_path).split()
    from uuv_optical_array.core.numerics import linked_functions

    assert linked == str(version.startswith(linked_functions.TRIED))
    np.testing.assert_allclose([float(x) for x in answer], censored(3.0, 5.0, 1.0, 2.0), rtol=1e-12)


def test_in_a_folder_of_this_user_alone_code_is_kept_and_in_no_other(kept, tmp_path):
    folder, _ = copied(kept, tmp_path)
    for path in (folder, folder.parent):
        assert path.stat().st_mode & 0o077 == 0, path
    folder.chmod(0o702)  # others may write
    assert printed(WAIT_AND_COMPILE, tmp_path) == "1 (1.0, 2.0)"
    if os.geteuid() != 0:
        pytest.skip("only root can give a folder away")
    os.chown(folder, 12345, -1)
    assert printed(WAIT_AND_COMPILE, tmp_path) == "1 (1.0, 2.0)"


def test_where_nothing_can_be_kept_it_is_compiled_all_the_same(tmp_path):
    (tmp_path / "file").write_text("")
    below = tmp_path / "file" / "below"
    told = f"{WAIT_AND_COMPILE}print(compilation.cache_folder(), *function(6.0, 28.0))"
    assert printed(told, below) == "None 1.0 2.0"


def test_functions_of_one_source_that_call_others_have_names_of_their_own():
    """Or one file of the cache would take beer for the housing of another, and poses were wrong."""
    transmits = transmit_beer, transmit_lens, transmit_housing, transmit_port
    names = [compilation.for_callers(each).py_func.__qualname__ for each in transmits]
    assert len(set(names)) == len(transmits)
