"""A large table on disk: the rows of one in memory, resumed, and never damaged unnoticed."""

import contextlib
import os
import re
import shutil
import signal
import socket
import sys
from unittest.mock import patch

import numpy as np
import pytest
import yaml
from command_line import interrupted, python, run, text_of
from conftest import PATIENCE_S
from scenes import changed

from uuv_optical_array.estimation import large_table
from uuv_optical_array.estimation.large_table import build_large_table, load_table
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.scene import load_scene, save_scene, scene_from_settings

SPANS = {
    "x_m": [-8.0, 4.0, 7],
    "y_m": [-0.6, 0.6, 4],
    "z_m": [-0.3, 0.5, 3],
    "pitch_deg": [-20.0, 20.0, 3],
    "yaw_deg": [-5.0, 5.0, 2],
}
POSES, BLOCK, BLOCKS = 7 * 4 * 3 * 3 * 2, 64, 8


@pytest.fixture(autouse=True)
def extra():
    # Here and not above: to launch_testing a module that is skipped skips its whole folder.
    for needed in ("zarr", "distributed"):
        pytest.importorskip(needed, reason="large tables need the extra cluster")


def scene_with(group="table", **values):
    return changed(changed("reference", table=SPANS), **{group: values})


def build(path, scene=None, **options):
    build_large_table(path, scene or scene_with(), block_rows=BLOCK, **{"threads": 1, **options})
    return path


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    return build(tmp_path_factory.mktemp("large") / "whole.zarr")


@pytest.fixture
def copied(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "t.zarr")


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def assert_same_rows(folder, whole):
    """Compare to rounding, as what is compiled may take over between two builds."""
    import zarr

    assert contents(folder).keys() >= contents(whole).keys()
    rows, expected = (zarr.open_array(str(path), mode="r")[:] for path in (folder, whole))
    np.testing.assert_allclose(rows, expected, atol=1e-12)


def assert_equal_tables(one, other):
    np.testing.assert_array_equal(one.poses, other.poses)
    np.testing.assert_allclose(one.parameters, other.parameters, atol=1e-12)


def test_the_rows_are_those_of_a_table_in_memory_by_any_number_of_threads(finished, tmp_path):
    scene = scene_with()
    table = build_table(scene)
    assert 100 < len(table.poses) < POSES - 100
    assert build_large_table(finished, scene) == len(table.poses)
    # Under another name it is the same scene.
    renamed = scene_from_settings(scene.settings(), "renamed")
    assert_equal_tables(load_table(finished, renamed), table)
    assert_same_rows(build(tmp_path / "t.zarr", threads=2), finished)
    assert len(contents(finished)) == BLOCKS + 2


def test_nothing_is_warned_of_where_dasks_usual_port_is_taken(tmp_path, recwarn):
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # it is taken
            stack.enter_context(socket.create_server(("", 8787)))
        build(tmp_path / "t.zarr")
    assert not [str(one.message) for one in recwarn if "8787" in str(one.message)]


CUT_OFF = """import os, pathlib, sys, yaml
from uuv_optical_array.estimation import large_table
from uuv_optical_array.forward.scene import scene_from_settings
def die(*arguments, **options): os._exit(9)
def blocks(numbers):
    numbers = iter(numbers)
    yield next(numbers)
    os.replace = os.rename = pathlib.Path.replace = die
    yield from numbers
scene = scene_from_settings(yaml.safe_load(sys.argv[2]), "changed")
large_table.build_large_table(
    sys.argv[1], scene, threads=1, block_rows=64, progress=blocks)"""


def test_a_build_that_is_killed_leaves_whole_blocks_and_goes_on_with_the_others(finished, tmp_path):
    """It ends at the call that moves a block into its place."""
    path, settings = tmp_path / "t.zarr", yaml.safe_dump(scene_with().settings())
    assert python(CUT_OFF, path, settings).returncode == 9
    blocks = [name for name in contents(path) if re.fullmatch(r"\d+\.0", name)]
    assert 1 <= len(blocks) < BLOCKS
    with pytest.raises(ValueError, match=r"[1-7] of 8 blocks.*again to finish"):
        load_table(path, scene_with())
    written = {name: (path / name).stat().st_mtime_ns for name in blocks}
    build(path)
    assert {name: (path / name).stat().st_mtime_ns for name in blocks} == written
    assert_same_rows(path, finished)


def test_ctrl_c_stops_the_command_and_the_same_command_finishes(tmp_path, monkeypatch):
    spans = {axis: [*span[:2], 11] for axis, span in SPANS.items()}
    save_scene(changed("reference", table=spans), tmp_path / "sea.yaml", "A sea.")
    program = "from uuv_optical_array.programs import uuv_array; uuv_array()"
    words = ["table", "--scene", "sea.yaml", "-o", "deep/t"]
    process = [sys.executable, "-c", program, *words, "--workers", "1"]
    # The first line comes once the first block is there.
    code, out, error = interrupted(process, b"\n", cwd=tmp_path)
    assert (code, re.findall(rb"Traceback|WARNING|ERROR", error)) == (130, []), error
    assert out == b"interrupted: the same command continues what is in deep/t\n"
    monkeypatch.chdir(tmp_path)
    out = text_of(run, *words)
    table = build_table(load_scene(str(tmp_path / "sea.yaml")))
    assert f"deep/t: {len(table.poses)} signatures of {11**5} poses" in out
    assert "scene sea, " in out
    assert_equal_tables(load_table(tmp_path / "deep/t", table.scene), table)


def damages(data, rng):
    """Yield what a file may become: with a bit flipped anywhere, cut off, grown, or zero."""
    for place in {0, len(data) - 1, *rng.integers(0, len(data), 40).tolist()}:
        yield data[:place] + bytes([data[place] ^ 1 << rng.integers(8)]) + data[place + 1 :]
    yield from (data[: len(data) // 2], data[:-1], b"", data + b"\n", bytes(len(data)))


def test_damage_to_any_file_is_refused_with_the_cure_or_changes_nothing(finished, copied):
    scene, rng, refused = scene_with(), np.random.default_rng(5), 0
    whole = load_table(finished, scene)
    cure = "delete this one and build it again|run the same uuv_array table again|for this scene"
    last = f"{BLOCKS - 1}.0"
    for name in (".zarray", ".zattrs", "0.0", last):
        file, data = copied / name, contents(finished)[name]
        for damaged in damages(data, rng):
            file.write_bytes(damaged)
            table, refusal = whole, None
            try:
                table = load_table(copied, scene)
            except ValueError as error:
                refusal, refused = str(error), refused + 1
            assert refusal is None or re.search(rf"table {copied}: .*({cure})", refusal), refusal
            np.testing.assert_array_equal(table.poses, whole.poses)
            np.testing.assert_array_equal(table.parameters, whole.parameters)
        file.write_bytes(data)
    assert refused > 40 * 2


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda block: block.write_bytes(b""), r"block 7.0 is damaged.*to mend it"),
        (lambda block: block.unlink(), "7 of 8 blocks are there"),
        (lambda block: block.rename(block.with_name("99.0")), r"block 7.0 is damaged \(missing\)"),
    ],
    ids=["empty", "missing", "of no block"],
)
def test_a_block_that_is_not_its_own_is_refused_and_computed_again(finished, copied, spoil, words):
    """The last block is dark, and is not taken for one when it is missing."""
    spoil(copied / f"{BLOCKS - 1}.0")
    with pytest.raises(ValueError, match=words):
        load_table(copied, scene_with())
    assert_same_rows(build(copied), finished)


@pytest.mark.parametrize(
    ("group", "values", "words"),
    [
        ("lamp", {"beam_sigma_deg": 9.0}, ["lamp.beam_sigma_deg", "8.0 there", "9.0 here"]),
        ("effects", {"forward_scatter": {"window_m": 0.3}}, ["forward_scatter", "absent", "0.3"]),
        ("table", {"yaw_deg": [6.0, 6.0, 1]}, ["table.yaw_deg", "[-5.0,", "[6.0,"]),
        ("signature", {"lift": 0.0}, ["signature.lift", "1.0 there", "0.0 here"]),
    ],
)
def test_a_table_of_another_scene_is_refused_with_what_differs(finished, group, values, words):
    before = contents(finished)
    for attempt in (load_table, build_large_table):
        with pytest.raises(ValueError, match="another scene") as refusal:
            attempt(finished, scene_with(group, **values))
        assert all(word in str(refusal.value) for word in words)
        assert "array.width_m" not in str(refusal.value)
    assert contents(finished) == before


@pytest.mark.parametrize("kind", ["nothing", "folder", "file", "array"])
def test_what_is_no_table_is_refused_and_not_changed(tmp_path, kind):
    path = tmp_path / "mine"
    if kind == "file":
        path.write_text("mine")
    elif kind != "nothing":
        path.mkdir()
        (path / "notes.txt").write_text("mine")
    if kind == "array":
        import zarr

        zarr.open_array(str(path), mode="a", shape=(3,), dtype="f8")
    before = None if kind in ("nothing", "file") else contents(path)
    with pytest.raises(ValueError, match=rf"table {path}: "):
        load_table(path, scene_with())
    if kind == "nothing":
        return
    with pytest.raises(ValueError, match="name another folder"):
        build_large_table(path, scene_with())
    assert path.read_text() == "mine" if before is None else contents(path) == before


def test_a_grid_in_the_dark_or_beyond_the_disk_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no pose of the table has 1 count"):
        build(tmp_path / "dark.zarr", scene_with("table", x_m=[2.0, 4.0, 2]))
    spans = {axis: [*span[:2], 10_000] for axis, span in SPANS.items()}
    with pytest.raises(ValueError, match=r"take up to 4e\+12 GB.* free; take a coarser grid"):
        build(tmp_path / "vast.zarr", scene_with("table", **spans))
    assert os.listdir(tmp_path) == ["dark.zarr"]


def test_one_of_two_workers_killed_half_way_leaves_no_trace(finished, tmp_path, monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(large_table, "WAIT_S", PATIENCE_S)

    path, slow, killed = (tmp_path / name for name in ("t.zarr", "slow.py", "killed"))
    # Each computes two blocks, and the rest once one was killed in the midst of the work.
    slow.write_text(f"""import pathlib, time
from uuv_optical_array.estimation import large_table
begun = []
def slow(*arguments, compute=large_table.grid_parameters):
    begun.append(1)
    while len(begun) > 2 and not pathlib.Path({str(killed)!r}).exists():
        time.sleep(0.01)
    return compute(*arguments)
large_table.grid_parameters = slow""")
    two = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    two["local_directory"] = tmp_path
    # It leaves variables in the environment of this process.
    with patch.dict(os.environ), LocalCluster(**two, preload=str(slow)) as cluster:

        def kills(blocks):
            for done, block in enumerate(blocks):
                if done == 2:
                    cluster.workers[0].close_gracefully()  # none is started in its place
                    os.kill(cluster.workers[0].pid, signal.SIGKILL)
                    assert len(contents(path)) < BLOCKS + 2
                    killed.touch()
                yield block

        build(path, scheduler=cluster.scheduler_address, threads=None, progress=kills)
        assert_same_rows(path, finished)
        lost = tmp_path / "lost.zarr"

        def removed(blocks):
            shutil.rmtree(lost)
            yield from blocks

        with pytest.raises(ValueError, match="a folder that all share"):
            build(lost, scheduler=cluster.scheduler_address, threads=None, progress=removed)
