"""``uuv_array study tradeoff``: the front, what is measured, and whole runs."""

import csv
import dataclasses
import functools
import json
import math
import re

import command_line
import numpy as np
import pytest
from command_line import assert_picture
from measured import row

from uuv_optical_array.core.settings import Span
from uuv_optical_array.estimation.estimator import METHODS, Estimator
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.table.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import TableSettings, load_scene
from uuv_optical_array.forward.working_volume import lit_poses, volume_spread
from uuv_optical_array.studies import accuracy, published
from uuv_optical_array.studies.results import Results
from uuv_optical_array.studies.tradeoff import measurement
from uuv_optical_array.studies.tradeoff import plan as planned
from uuv_optical_array.studies.tradeoff import run as tradeoff_run
from uuv_optical_array.studies.tradeoff import table_cost as table_cost_module
from uuv_optical_array.studies.tradeoff.fronts import fronts, numbered
from uuv_optical_array.studies.tradeoff.measurement import measure
from uuv_optical_array.studies.tradeoff.plan import ALL_METHODS, PUBLISHED, SHAPES, Group, plan
from uuv_optical_array.studies.tradeoff.results import (
    Measurement,
    Origin,
    TableCost,
    at_one_speed,
)
from uuv_optical_array.studies.tradeoff.table_cost import table_cost

ORIGIN = Origin("sea", "f" * 64, "a, b: 2 cores", "quick", 7, 1)


@pytest.fixture(scope="module")
def scene():
    return load_scene("reference")


@pytest.fixture
def small(monkeypatch):
    """A trade-off of two arrays, one table size and both published methods, in seconds."""
    monkeypatch.setattr(planned, "SIDES", (3,))
    monkeypatch.setattr(planned, "SHAPES", ("curved",))
    monkeypatch.setattr(planned, "STEPS", (3, 4))
    monkeypatch.setattr(planned, "QUICK_STEPS", (3,))
    monkeypatch.setattr(planned, "QUICK_OWN_STEPS", (3, 4))
    monkeypatch.setattr(tradeoff_run, "FRAMES", {"quick": 5, "full": 6})
    monkeypatch.setattr(published, "SAMPLES", 2)
    span = Span(-0.3, 0.3, 3)
    coarse = TableSettings(Span(-8.0, -4.0, 3), span, span, Span(-30, 30, 3), Span(-30, 30, 3))
    monkeypatch.setattr(published, "GRID", coarse)
    # Every other test of the command can do without a process of its own.
    monkeypatch.setattr(
        tradeoff_run,
        "table_cost",
        lambda table, steps, build_s, folder: TableCost(
            steps, len(table.poses), build_s, 1.0, 0.1, 2.0, 3.0, 1.0
        ),
    )


run = functools.partial(command_line.run, "study", "tradeoff")


# --- the front -----------------------------------------------------------------------------


def test_settings_within_a_step_are_alike_and_the_simplest_is_kept():
    rows = [
        row(side=7, position=0.500, ms=1.00),
        row(side=5, position=0.505, ms=1.01, rows=9999),
        row(side=5, position=0.504, ms=1.01, rows=1024),
        row(side=3, position=0.500, ms=2.0),
    ]
    assert fronts(rows)["position"].tolist() == [False, False, True, False]


def test_a_slow_spell_of_the_machine_moves_no_setting_off_the_front():
    """The same two settings, one of them measured while everything took three times as long."""
    slow = row(position=0.5, ms=3.0, p99_ms=6.0, model_ms=1.5, models=2.0)
    rows = [slow, row(position=0.1, ms=2.0, p99_ms=3.0, model_ms=0.5, models=4.0)]
    assert fronts(rows)["position"].tolist() == [True, True]
    told = at_one_speed(rows)
    assert [line.model_ms for line in told] == [1.0, 1.0]
    assert [line.median_ms for line in told] == pytest.approx([2.0, 4.0])
    assert [line.p99_ms for line in told] == pytest.approx([4.0, 6.0])
    assert at_one_speed([]) == []


def test_settings_without_poses_or_worse_than_a_guess_are_on_no_front():
    position, angle = volume_spread()
    rows = [
        row(ms=0.1, lost=0.02),
        row(ms=0.2, position=1.01 * position, angle=1.01 * angle),
        row(ms=0.3, position=math.nan, angle=math.nan, lost=1.0),
        row(ms=5.0, position=0.5, angle=2 * angle),
        row(ms=7.0, position=2 * position, angle=1.0),
    ]
    found = fronts(rows)
    assert found["position"].nonzero()[0].tolist() == [3]
    assert found["angle"].nonzero()[0].tolist() == [4]
    assert numbered(rows) == [3, 4]
    assert numbered([]) == []


# --- what is measured ----------------------------------------------------------------------


def settings(groups):
    return [(m, g.shape, g.detectors_per_side, g.steps) for g in groups for m in g.methods]


@pytest.mark.parametrize("name", ["reference", "follow"])
def test_full_plan_is_every_setting_once_and_quick_is_part_of_it(name):
    scene = load_scene(name)
    full, quick = settings(plan(scene, "full")), settings(plan(scene, "quick"))
    wanted = {
        (method, shape, side, steps)
        for shape in SHAPES
        for side in (3, 5, 7, 21)
        for method in ALL_METHODS
        for steps in ((0,) if method in PUBLISHED else (4, 6, 10, 16, 25))
    }
    assert sorted(full) == sorted(wanted)
    assert len(set(quick)) == len(quick)
    assert set(quick) < wanted
    assert {setting[0] for setting in quick} == set(ALL_METHODS)
    own = scene.array.shape, scene.array.detectors_per_side
    assert full[0][1:3] == quick[0][1:3] == own


def test_an_array_of_another_size_is_measured_too(scene):
    array = dataclasses.replace(scene.array, detectors_per_side=9)
    groups = plan(dataclasses.replace(scene, array=array), "quick")
    assert groups[0].detectors_per_side == 9
    assert {group.detectors_per_side for group in groups} == {3, 5, 7, 9, 21}


def test_rows_hold_the_errors_of_the_estimators_own_study(scene):
    group = Group("curved", 3, 4, METHODS)
    rows = {row.method: row for row in measure(scene, group, 12, 5)}
    inside = group.scene(scene)
    model, rng = ForwardModel(inside), np.random.default_rng([5, 3, 0])
    poses = lit_poses(model, 12, rng)
    images = model.expose(poses, rng)
    for method in METHODS:
        found = accuracy.measure(Estimator(build_table(inside), method), poses, images)
        rms, row = found.rms_error, rows[method]
        assert row.position_m == pytest.approx(math.hypot(*rms[:3]), rel=1e-9)
        assert row.angle_deg == pytest.approx(math.degrees(math.hypot(*rms[3:])), rel=1e-9)
        assert row.bound_position_m == pytest.approx(math.hypot(*found.rms_bound[:3]), rel=1e-9)
        assert row.table_rows == 4**5
        assert 0 < row.median_ms <= row.p99_ms
        assert row.models == pytest.approx(row.median_ms / row.model_ms)


def test_large_arrays_get_the_same_table_in_smaller_blocks(scene):
    inside = Group("curved", 41, 3, METHODS).scene(scene)
    blocks = []
    table = build_table(inside, progress=lambda rounds: blocks.extend(rounds) or blocks)
    assert len(blocks) > 1
    images = ForwardModel(inside).expected(table.poses)
    wanted = key_parameters(images, inside.full_scale_counts, inside.signature.peak)
    assert len(table.poses) == 3**5
    np.testing.assert_allclose(table.parameters, wanted, rtol=1e-12, atol=1e-12)


def test_table_cost_counts_files_and_memory(scene, tmp_path):
    table = build_table(Group("curved", 3, 9, METHODS).scene(scene))
    found = table_cost(table, 9, 1.5, tmp_path)
    rows = 9**5
    assert found.table_rows == rows
    # Two files of five doubles a row, and a page of headers and text.
    assert found.file_mb * 1e6 == pytest.approx(80 * rows, abs=4096)
    # The index holds six doubles and a number for each row.
    assert 56 * rows / 1e6 < found.memory_mb < 10 * 56 * rows / 1e6
    assert found.memory_mb <= found.peak_mb < found.memory_mb + 200
    assert found.load_s > 0
    assert list(tmp_path.iterdir()) == []


def test_table_that_no_process_can_open_is_one_line(scene, tmp_path, monkeypatch):
    table = build_table(Group("curved", 3, 2, METHODS).scene(scene))
    monkeypatch.setattr(table_cost_module, "save_table", lambda table, path: path.mkdir())
    with pytest.raises(ValueError, match=r"table of 32 poses: a process cannot open it: .*Error"):
        table_cost(table, 2, 1.0, tmp_path)


# --- the command ---------------------------------------------------------------------------


def counted(monkeypatch, stop_after=None):
    """Count what is measured, and press Ctrl-C before the group of that number."""
    heard, honest = [], measurement.measure

    def measured(scene, group, *others):
        if len(heard) == stop_after:
            raise KeyboardInterrupt
        heard.append(group)
        return honest(scene, group, *others)

    monkeypatch.setattr(tradeoff_run, "measure", measured)
    return heard


@pytest.mark.usefixtures("sketched")
def test_a_run_that_was_stopped_goes_on_where_it_was(small, scene, tmp_path, capsys, monkeypatch):
    folder = tmp_path / "out"
    first = counted(monkeypatch, stop_after=2)
    run("--output", folder, code=130)
    kept = (folder / "tradeoff.csv").read_text()
    assert len(kept.splitlines()) == 1 + 2 * len(METHODS)
    for picture in ("tradeoff.png", "table_cost.png"):
        assert_picture(folder / picture)
    assert "interrupted: 6 of" in capsys.readouterr().out

    second = counted(monkeypatch)
    run("--output", folder)
    assert not set(first) & set(second)
    assert {*first, *second} == set(plan(scene, "quick"))
    whole = (folder / "tradeoff.csv").read_text()
    assert whole.startswith(kept)

    third = counted(monkeypatch)
    run("--output", folder, "--pictures", ".svg")
    assert third == []
    assert (folder / "tradeoff.svg").read_bytes().startswith(b"<?xml")
    assert (folder / "tradeoff.csv").read_text() == whole


def test_what_is_printed_is_what_the_file_holds(small, tmp_path, capsys):
    run("--full", "--json", "--output", tmp_path)
    out, err = capsys.readouterr()
    told = json.loads(out)
    assert re.search(r"16 settings; about \d+ min; into ", err)
    assert told["complete"] is True
    assert (told["scene"], told["mode"], told["frames"]) == ("reference", "full", 6)
    with (tmp_path / "tradeoff.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(told["settings"]) == 2 * (2 * len(METHODS) + len(PUBLISHED))
    for line, setting in zip(lines, told["settings"], strict=True):
        for key, value in setting.items():
            assert line[key] == str(value) or (value is None and line[key] in ("nan", "inf"))
    assert set(told["fronts"]) == {"position", "angle"}
    assert [*map(str, (tmp_path / "tradeoff.png", tmp_path / "table_cost.png"))] == told["pictures"]
    with (tmp_path / "tables.csv").open(newline="") as file:
        assert [int(line["steps"]) for line in csv.DictReader(file)] == [3, 4]


def test_a_folder_of_another_run_is_refused_and_left_alone(small, tmp_path, monkeypatch):
    Results(tmp_path / "tradeoff.csv", Measurement, ORIGIN).append([row()])
    before = (tmp_path / "tradeoff.csv").read_bytes()
    heard = counted(monkeypatch)
    error = run("--output", tmp_path, code=1)
    assert error.startswith(f"uuv_array study tradeoff: {tmp_path}/tradeoff.csv: ")
    assert "\n" not in error
    assert heard == []
    assert (tmp_path / "tradeoff.csv").read_bytes() == before


def test_nothing_is_drawn_of_nothing(small, tmp_path, capsys, monkeypatch):
    counted(monkeypatch, stop_after=0)
    run("--output", tmp_path, code=130)
    assert capsys.readouterr().out == "interrupted: nothing measured\n"
    assert list(tmp_path.iterdir()) == []


def test_seed_out_of_bounds_is_refused(tmp_path):
    assert "--seed" in run("--seed", "-1", "--output", tmp_path / "a", code=2)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("name", ["tradeoff", "advise"])
def test_help_has_examples(capsys, name):
    command_line.run(name, "--help")
    examples = capsys.readouterr().out.partition("examples:")[2]
    assert len(re.findall(rf"^  uuv_array {name}\b", examples, re.MULTILINE)) >= 3
