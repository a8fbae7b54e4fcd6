"""Nothing broken is read: any damage to a table's files is noticed, or changes no bit of it."""

import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import ExitStack

import numpy as np
import pytest
from conftest import PATIENCE_S

from uuv_optical_array.core.parallel.cluster import on_threads
from uuv_optical_array.core.storage import files
from uuv_optical_array.estimation.table import store as store_module
from uuv_optical_array.estimation.table.disk import cached_table, load_table, save_table
from uuv_optical_array.estimation.table.store import TableStore

PLACES = 80  # a file


@pytest.fixture(params=["folder", "store"])
def whole(request, scene, table, tmp_path, monkeypatch):
    """The folder of a table, and the call that builds it anew."""
    path = tmp_path / ("t" if request.param == "folder" else "t.zarr")

    def build():
        if request.param == "folder":
            save_table(table, path)
        else:
            store = TableStore.create(path, scene)
            store.finish(on_threads(store.fill, store.chunks, 1, lambda: None))

    if request.param == "store":
        for needed in ("zarr", "dask"):
            pytest.importorskip(needed, reason="tables in chunks need the extra cluster")
        monkeypatch.setattr(store_module, "CHUNK_ROWS", 2000)  # two chunks
    build()
    return path, build


def bits(path, scene):
    table = load_table(path, scene)
    return np.asarray(table.poses).tobytes() + table.parameters.tobytes()


def contents(path):
    return {file.name: file.read_bytes() for file in sorted(path.iterdir())}


def flipped(data, place, bit):
    return data[:place] + bytes([data[place] ^ (1 << bit)]) + data[place + 1 :]


def harms(data, rng):
    """Yield what a file may become: flipped anywhere, cut off, grown, or overwritten."""
    places = {0, len(data) - 1, *rng.integers(0, len(data), PLACES).tolist()}
    for place in sorted(places):
        yield flipped(data, place, int(rng.integers(8)))
    for size in (0, len(data) // 2, len(data) - 1):
        yield data[:size]
    yield data + b"\n"
    yield bytes(len(data))


def test_any_damage_to_any_file_is_refused_with_its_name_and_the_cure(whole, scene):
    path, build = whole
    rng, before = np.random.default_rng(5), contents(path)
    good = bits(path, scene)
    cure = re.compile("delete this one and build it again|run the same uuv_array table again")
    assert len(before) >= 4
    for name, data in before.items():
        for harmed in harms(data, rng):
            (path / name).write_bytes(harmed)
            with pytest.raises(ValueError, match=rf"table {path}: {name} is damaged") as refusal:
                load_table(path, scene)
            assert cure.search(str(refusal.value))
        (path / name).unlink()
        with pytest.raises(ValueError, match=f"{name} is missing") as refusal:
            load_table(path, scene)
        assert cure.search(str(refusal.value))
        (path / name).mkdir()
        with pytest.raises(ValueError, match=f"table {path}: "):
            load_table(path, scene)
        (path / name).rmdir()
        (path / name).write_bytes(data)
    for surplus in ("poses.npy~", "9.0"):
        (path / surplus).write_bytes(b"x")
        with pytest.raises(ValueError, match=f"{surplus} does not belong there"):
            load_table(path, scene)
        (path / surplus).unlink()
    # What was mended by hand is as before, and so is what the cure gives.
    assert bits(path, scene) == good
    shutil.rmtree(path)
    build()
    assert contents(path) == before
    assert bits(path, scene) == good


def test_files_of_another_table_do_not_pass_for_its_own(scene, table, tmp_path):
    other = type(table)(scene, table.poses, table.parameters * (1 + 1e-15))
    for name, each in (("t", table), ("other", other)):
        save_table(each, tmp_path / name)
    shutil.copy(tmp_path / "other" / "parameters.npy", tmp_path / "t")
    with pytest.raises(ValueError, match=r"parameters.npy is damaged"):
        load_table(tmp_path / "t", scene)


def test_the_checksums_are_those_of_sha256sum(scene, table, tmp_path):
    save_table(table, tmp_path / "t")
    said = subprocess.run(
        ["sha256sum", "--check", "SHA256SUMS"],
        cwd=tmp_path / "t",
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout.splitlines() == ["parameters.npy: OK", "poses.npy: OK", "table.yaml: OK"]


def test_a_header_of_an_unfinished_store_that_is_damaged_is_refused(scene, tmp_path):
    pytest.importorskip("zarr", reason="tables in chunks need the extra cluster")
    store, rng = TableStore.create(tmp_path / "t.zarr", scene), np.random.default_rng(6)
    for name in (".zarray", ".zattrs", "SHA256SUMS"):
        data = (store.path / name).read_bytes()
        for harmed in harms(data, rng):
            (store.path / name).write_bytes(harmed)
            with pytest.raises(ValueError, match=f"{name} is damaged"):
                TableStore.create(store.path, scene)
        (store.path / name).write_bytes(data)
    TableStore.create(store.path, scene)


# A process that builds a table, says where it writes, and waits there to be killed or to go on.
BUILDER = """import sys
import numpy as np
from uuv_optical_array.estimation.table.disk import save_table
from uuv_optical_array.estimation.table.signature_table import build_table
from uuv_optical_array.forward.scene import load_scene

def save_in_two(file, array, save=np.save):
    file.write_bytes(b"half")
    print(file.parent.name, flush=True)
    sys.stdin.read()
    save(file, array)

np.save = save_in_two
save_table(build_table(load_scene(sys.argv[1])), sys.argv[2])
"""


@pytest.fixture
def builder(scene_file):
    """Start processes that are in the midst of writing a table; yields their start."""
    with ExitStack() as all_ended:

        def start(path):
            process = subprocess.Popen(
                [sys.executable, "-c", BUILDER, scene_file, str(path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            all_ended.enter_context(process)
            all_ended.callback(process.kill)
            return process, process.stdout.readline().strip()

        yield start


def kill(process):
    process.kill()
    assert process.wait(PATIENCE_S) == -signal.SIGKILL


def test_the_cache_loses_what_a_killed_builder_left_and_keeps_what_a_live_one_writes(
    builder, scene, table, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cache = files.cache_dir()
    killed, left = builder(cache / "another")
    living, kept = builder(cache / "another")
    kill(killed)
    assert {left, kept} <= set(os.listdir(cache))
    cached_table(scene)
    assert [name for name in os.listdir(cache) if name.startswith(".")] == [kept]
    living.communicate(timeout=PATIENCE_S)
    np.testing.assert_array_equal(load_table(cache / "another", scene).poses, table.poses)


def test_a_table_saved_where_a_builder_was_killed_clears_what_it_left(builder, table, tmp_path):
    (tmp_path / ".t.mine").mkdir()
    process, left = builder(tmp_path / "t")
    kill(process)
    assert left in os.listdir(tmp_path)
    save_table(table, tmp_path / "t")
    assert sorted(os.listdir(tmp_path)) == [".t.mine", "t"]


def test_what_zarr_leaves_of_a_chunk_is_removed_when_the_table_is_finished(scene, tmp_path):
    for needed in ("zarr", "dask"):
        pytest.importorskip(needed, reason="tables in chunks need the extra cluster")
    store = TableStore.create(tmp_path / "t.zarr", scene)
    (store.path / "0.0.0123abcd.partial").write_bytes(b"half")
    store.finish(on_threads(store.fill, store.chunks, 1, lambda: None))
    assert not list(store.path.glob("*.partial"))
    load_table(store.path, scene)
