"""A table built in chunks: the ordinary one's rows, the same bytes by any way, and resumed."""

import dataclasses
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import PATIENCE_S, dask_workers, filled_while_a_worker_dies

from uuv_optical_array.commands import main
from uuv_optical_array.core.parallel import cluster
from uuv_optical_array.core.parallel.cluster import on_cluster, on_threads, threads_within
from uuv_optical_array.core.storage import memory
from uuv_optical_array.core.storage.memory import machine_bytes, serving_bytes
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.table import store as store_module
from uuv_optical_array.estimation.table.disk import load_table, save_table
from uuv_optical_array.estimation.table.signature_table import GridPoses, build_table, grid_axes
from uuv_optical_array.estimation.table.store import TableStore
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

SPANS = {
    "x_m": [-8.0, 4.0, 7],
    "y_m": [-0.6, 0.6, 4],
    "z_m": [-0.3, 0.5, 3],
    "pitch_deg": [-20.0, 20.0, 3],
    "yaw_deg": [-5.0, 5.0, 2],
}
ROWS, CHUNK = 7 * 4 * 3 * 3 * 2, 64


def scene_with(group=None, name="small", **values):
    settings = load_scene("reference").settings()
    settings["table"] = dict(SPANS)
    if group is not None:
        settings[group].update(values)
    return scene_from_settings(settings, name)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    # Here and not above: to launch_testing a module that is skipped skips its whole folder.
    for needed in ("zarr", "dask"):
        pytest.importorskip(needed, reason="tables in chunks need the extra cluster")
    monkeypatch.setattr(store_module, "CHUNK_ROWS", CHUNK)


@pytest.fixture
def computed(monkeypatch):
    """List the chunks that are computed."""
    chunks = []
    compute = TableStore.compute

    def counted(self, chunk):
        chunks.append(chunk)
        return compute(self, chunk)

    monkeypatch.setattr(TableStore, "compute", counted)
    return chunks


def build(path, scene=None, threads=1):
    store = TableStore.create(path, scene or scene_with())
    store.finish(on_threads(store.fill, store.chunks, threads, lambda: None))
    return store


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_the_rows_are_those_of_a_table_built_in_memory(tmp_path):
    whole = build_table(scene_with())
    assert 100 < len(whole.poses) < ROWS - 100
    build(tmp_path / "t.zarr")
    table = load_table(tmp_path / "t.zarr", scene_with())
    np.testing.assert_array_equal(np.asarray(table.poses), whole.poses)
    np.testing.assert_allclose(table.parameters, whole.parameters, atol=1e-12)
    assert len(table.poses) == len(whole.poses)


def test_an_estimate_is_that_of_the_ordinary_table(tmp_path):
    scene = scene_with("table", x_m=[-8.0, -4.0, 7])
    build(tmp_path / "t.zarr", scene)
    whole = build_table(scene)
    table = load_table(tmp_path / "t.zarr", scene)
    for row in (0, 17, 300):
        for method in ("sam", "sam_interpolated", "least_squares"):
            image = ForwardModel(scene).expected(whole.poses[row])
            one, other = (
                Estimator(t, method).estimate(image, whole.parameters[row]) for t in (table, whole)
            )
            np.testing.assert_allclose(one.pose, other.pose, atol=1e-6)


@pytest.mark.parametrize("lit", [None, [3, 5, 100, 200, 503]])
def test_poses_of_a_grid_are_indexed_as_an_array(lit):
    axes = grid_axes(scene_with().table)
    every = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 5)
    rows = None if lit is None else np.array(lit)
    poses, array = GridPoses(axes, rows), every if lit is None else every[lit]
    mask = np.arange(len(array)) % 2 == 1
    for index in (0, -1, slice(1, 4), slice(None), [2, 0, 2], np.array([[1, 2], [3, -1]]), mask):
        np.testing.assert_array_equal(poses[index], array[index])
    assert poses.shape == array.shape
    np.testing.assert_array_equal(np.asarray(poses), array)
    for index in (len(array), -len(array) - 1, mask[:-1]):
        with pytest.raises(IndexError):
            poses[index]


def test_one_and_two_threads_write_the_same_bytes(tmp_path):
    one, two = (build(tmp_path / f"{n}.zarr", threads=n) for n in (1, 2))
    assert contents(one.path) == contents(two.path)
    assert len(contents(one.path)) == len(one.chunks) + 4 == -(-ROWS // CHUNK) + 4
    assert load_table(one.path, scene_with()).parameters.dtype == np.float64


def test_many_batches_give_each_chunk_once_and_in_order(monkeypatch):
    monkeypatch.setattr(cluster, "BATCH", 3)
    ticks = []
    squares = on_threads(lambda i: i * i, range(10), 2, lambda: ticks.append(1))
    assert squares == [i * i for i in range(10)]
    assert len(ticks) == 10


def test_the_order_of_the_chunks_leaves_no_trace(tmp_path):
    forth = build(tmp_path / "forth.zarr")
    back = TableStore.create(tmp_path / "back.zarr", scene_with())
    back.finish([back.fill(chunk) for chunk in reversed(back.chunks)])
    assert contents(forth.path) == contents(back.path)


def test_an_interrupted_build_goes_on_where_it_stopped(tmp_path, computed, monkeypatch):
    whole = contents(build(tmp_path / "whole.zarr").path)
    computed.clear()
    stop = TableStore.create(tmp_path / "t.zarr", scene_with())

    def interrupted(chunk):
        if len(stop.present()) == 3:
            raise KeyboardInterrupt
        return stop.fill(chunk)

    with pytest.raises(KeyboardInterrupt):
        on_threads(interrupted, stop.chunks, 1, lambda: None)
    done = set(stop.present())
    assert len(done) == 3
    with pytest.raises(ValueError, match=r"3 of 8 chunks.*again to finish"):
        load_table(stop.path, scene_with())
    computed.clear()
    assert contents(build(tmp_path / "t.zarr").path) == whole
    assert set(computed) == set(stop.chunks) - done
    assert len(computed) == len(stop.chunks) - 3
    computed.clear()
    assert contents(build(tmp_path / "t.zarr").path) == whole
    assert computed == []


def half(data):
    return data[: len(data) // 2]


def flipped(data):
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


def unseen_by_zstd(data):
    """Flip the bit of the frame's header that a decoder ignores (RFC 8878, 3.1.1.1.1.3)."""
    return data[:4] + bytes([data[4] ^ 0x10]) + data[5:]


def empty(data):
    return b""


def overwritten(data):
    return b"x" * len(data)


@pytest.mark.parametrize("harm", [half, flipped, unseen_by_zstd, empty, overwritten])
def test_a_damaged_chunk_is_refused_and_mended(tmp_path, computed, harm):
    store = build(tmp_path / "t.zarr")
    whole = contents(store.path)
    computed.clear()
    (store.path / "1.0").write_bytes(harm(whole["1.0"]))
    with pytest.raises(ValueError, match=r"1.0 is damaged.*to mend it"):
        load_table(store.path, scene_with())
    build(store.path)
    assert computed == [1]
    assert contents(store.path) == whole


def test_a_chunk_that_vanished_is_not_taken_for_darkness(tmp_path):
    store = build(tmp_path / "t.zarr")
    (store.path / f"{store.chunks[-1]}.0").unlink()
    with pytest.raises(ValueError, match=r"is missing.*to mend it"):
        load_table(store.path, scene_with())


def test_a_dark_chunk_has_a_file_too(tmp_path):
    store = build(tmp_path / "t.zarr")
    dark = store.chunks[-1]
    assert np.isnan(store.compute(dark)).all()
    assert (store.path / f"{dark}.0").is_file()


def test_a_chunk_cut_off_while_it_is_written_is_not_there(tmp_path):
    """The process is killed in the middle of a write, at the call that names the file."""
    code = """
import os, sys
import uuv_optical_array.estimation.table.store as s
from uuv_optical_array.forward.scene import load_scene, scene_from_settings
import yaml
s.CHUNK_ROWS = 64
store = s.TableStore.create(sys.argv[1], scene_from_settings(yaml.safe_load(sys.argv[2]), "small"))
store.fill(0)
def die(*args, **options): os._exit(9)
import pathlib
os.replace = os.rename = pathlib.Path.replace = die
store.fill(1)
"""
    settings = yaml.safe_dump(scene_with().settings())
    path = tmp_path / "t.zarr"
    # The store itself begins with a rename, and the first chunk is whole.
    done = subprocess.run(
        [sys.executable, "-c", code, path, settings], check=False, timeout=PATIENCE_S
    )
    assert done.returncode == 9
    store = TableStore.create(path, scene_with())
    assert store.present() == [0]
    assert load_after(build(path)) == load_after(build(tmp_path / "u.zarr"))


def load_after(store):
    return load_table(store.path, store.scene).parameters.tobytes()


def test_the_store_of_another_scene_is_refused_and_kept(tmp_path):
    other = scene_with("lamp", beam_sigma_deg=9.0)
    store = build(tmp_path / "t.zarr", other)
    before = contents(store.path)
    for attempt in (TableStore.create, load_table):
        with pytest.raises(ValueError, match=r"another scene.*lamp.beam_sigma_deg is 9.0 there"):
            attempt(store.path, scene_with())
    assert contents(store.path) == before


@pytest.mark.parametrize("kind", ["folder", "file", "table", "array"])
def test_what_is_no_such_store_is_refused_and_kept(tmp_path, kind):
    path = tmp_path / "t.zarr"
    if kind == "file":
        path.write_text("mine")
    elif kind == "table":
        save_table(build_table(scene_with()), path)
    else:
        path.mkdir()
        (path / "notes.txt").write_text("mine")
        if kind == "array":
            (path / ".zarray").write_text(
                '{"chunks": [1], "compressor": null, "dtype": "<f8", "fill_value": 0.0, '
                '"filters": null, "order": "C", "shape": [1], "zarr_format": 2}'
            )
    with pytest.raises(ValueError, match="name another folder"):
        TableStore.create(path, scene_with())
    assert path.is_file() or len(os.listdir(path)) >= 1
    with pytest.raises(ValueError, match=r"name it \*.zarr"):
        TableStore.create(tmp_path / "t.table", scene_with())


def test_a_grid_in_the_dark_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no pose of the table has 1 count"):
        build(tmp_path / "t.zarr", scene_with("table", x_m=[2.0, 4.0, 2]))


def test_a_table_too_large_to_serve_is_refused_with_the_figures(tmp_path, monkeypatch):
    store = build(tmp_path / "t.zarr")
    save_table(build_table(scene_with()), tmp_path / "t")
    rows = len(load_table(store.path, scene_with()).poses)
    # The last byte decides.
    monkeypatch.setattr(memory, "machine_bytes", lambda: serving_bytes(rows))
    assert len(load_table(store.path, scene_with()).poses) == rows
    monkeypatch.setattr(memory, "machine_bytes", lambda: serving_bytes(rows) - 1)
    for path in (store.path, tmp_path / "t"):
        with pytest.raises(ValueError, match=rf"{rows} rows need .* GB .*at most {rows - 1} rows"):
            load_table(path, scene_with())
    with pytest.raises(ValueError, match=rf"scene small: the table's {ROWS} rows need"):
        build_table(scene_with())


def test_a_grid_beyond_any_machine_is_refused_before_it_is_begun(tmp_path):
    spans = {axis: [*SPANS[axis][:2], 10_000] for axis in SPANS}
    with pytest.raises(ValueError, match=r"need 1\.8e\+1\d GB of memory.*coarser grid"):
        build_table(scene_with("table", **spans))
    with pytest.raises(ValueError, match=r"take up to 4\.0e\+12 GB.* free; take a coarser grid"):
        TableStore.create(tmp_path / "t.zarr", scene_with("table", **spans))
    assert not list(tmp_path.iterdir())


def test_the_memory_is_that_of_the_machine_or_of_the_container(monkeypatch, tmp_path):
    total = int(re.search(r"MemTotal:\s+(\d+)", Path("/proc/meminfo").read_text())[1]) * 1024
    monkeypatch.setattr(memory, "CGROUP", tmp_path / "max")
    assert machine_bytes() == pytest.approx(total, rel=0.05)
    (tmp_path / "max").write_text("max\n")
    assert machine_bytes() == pytest.approx(total, rel=0.05)
    (tmp_path / "max").write_text("123456789\n")
    assert machine_bytes() == 123456789


def test_threads_fit_into_the_memory_that_is_given():
    gigabyte = 1_000_000_000
    assert threads_within(None, gigabyte, 3) == 3
    assert threads_within("100GB", gigabyte, 3) == 3
    assert 1 <= threads_within("4GB", gigabyte, 100) <= 3
    with pytest.raises(ValueError, match=r"1.00 GB is too little; one thread needs [12]\.\d\d GB"):
        threads_within("1GB", gigabyte)
    with pytest.raises(ValueError, match="'much' is no size"):
        threads_within("much", gigabyte)


def test_the_command_builds_resumes_and_refuses(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sea.yaml").write_text(yaml.safe_dump(scene_with().settings()))

    def run(*words):
        with pytest.raises(SystemExit) as end:
            main(["table", "--scene", "sea.yaml", *words])
        return end.value.code, capsys.readouterr().out

    fill, filled = TableStore.fill, []

    def interrupted(self, chunk):
        if len(filled) == 3:
            raise KeyboardInterrupt
        filled.append(chunk)
        return fill(self, chunk)

    monkeypatch.setattr(TableStore, "fill", interrupted)
    code, out = run("--threads", "1")
    assert code == 130
    assert re.search(r"interrupted: \d of 8 chunks are in sea.zarr; the same command goes on", out)
    monkeypatch.setattr(TableStore, "fill", fill)
    code, out = run("--memory", "4GB")
    assert code == 0
    assert "of 8 chunks are there already" in out
    rows = len(load_table("sea.zarr", scene_with()).poses)
    assert f"sea.zarr: {rows} signatures" in out
    assert "a node needs 0.25 GB" in out
    assert "limits of their own" in run("--memory", "2GB", "--scheduler", "tcp://x:1")[0]
    assert "give at least 1" in run("--threads", "0")[0]
    assert "name it *.zarr" in run("--threads", "1", "-o", "sea.table")[0]


@pytest.fixture
def two_workers(tmp_path):
    # Workers compute small chunks too.
    small = f"import uuv_optical_array.estimation.table.store as s; s.CHUNK_ROWS = {CHUNK}\n"
    with dask_workers(tmp_path, small) as cluster:
        yield cluster


def test_two_workers_one_killed_half_way_write_the_same_bytes(tmp_path, two_workers):
    address, workers = two_workers
    whole = contents(build(tmp_path / "whole.zarr").path)
    store = TableStore.create(tmp_path / "t.zarr", scene_with())
    lit = filled_while_a_worker_dies(store, address, workers, 0.2)
    store.finish(lit)
    assert contents(store.path) == whole
    with pytest.raises(ValueError, match=r"worker tcp.* memory limit .* GB.* more --memory-limit"):
        on_cluster(store.fill, store.chunks, address, 10**15, lambda: None)
    # A worker that does not see the folder says so.
    lost = dataclasses.replace(store, path=tmp_path / "elsewhere.zarr")
    with pytest.raises(ValueError, match="a folder that all share"):
        on_cluster(lost.fill, [0], address, 1, lambda: None)


def test_without_the_extra_the_error_names_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(ValueError, match=r"\[cluster\]"):
        TableStore.create(tmp_path / "t.zarr", scene_with())
    assert not list(tmp_path.iterdir())
    monkeypatch.setitem(sys.modules, "dask", None)
    with pytest.raises(ValueError, match=r"\[cluster\]"):
        cluster.on_threads(abs, [1], 1, lambda: None)
