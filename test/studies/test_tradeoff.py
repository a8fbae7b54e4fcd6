"""``uuv_array study tradeoff``: the front, what is measured, and whole runs."""

import csv
import dataclasses
import functools
import math
import re

import command_line
import numpy as np
import pytest
from command_line import assert_picture, json_of
from hypothesis import given
from hypothesis import strategies as st
from measured import ALL_METHODS, row
from scenes import changed

from uuv_optical_array.estimation.estimator import METHODS, Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import GUESSED, HIGH, LOW, lit_poses
from uuv_optical_array.studies import tradeoff
from uuv_optical_array.studies.tradeoff import (
    FRAMES,
    PUBLISHED,
    SHAPES,
    Setting,
    fronts,
    measure,
    numbered,
    plan,
)

SCENE = load_scene("reference")
PLAN = [
    *(Setting(method, "curved", side, 3) for side in (3, 5) for method in METHODS),
    Setting("moments", "planar", 3, 0),
    Setting("look_up", "planar", 3, 0),
]


@pytest.fixture
def small(monkeypatch):
    """A trade-off of a few settings, in seconds."""
    monkeypatch.setattr(tradeoff, "plan", lambda scene, mode: PLAN)
    monkeypatch.setitem(FRAMES, "quick", 5)


run = functools.partial(command_line.run, "study", "tradeoff")


def test_settings_within_a_step_are_equal_and_the_simplest_is_on_the_front():
    rows = [
        row(side=7, position=0.500, ms=1.00),
        row(side=5, position=0.505, ms=1.01, rows=9999),
        row(side=5, position=0.504, ms=1.01, rows=1024),
        row(side=3, position=0.500, ms=2.0),
    ]
    assert fronts(rows)["position"] == [rows[2]]


# Steps of 10 % in time and in error, the last of which is worse than a guess; detectors; whether
# frames are left without a pose.
SETTINGS = st.tuples(
    st.integers(0, 3), st.sampled_from([0, 1, 2, 30]), st.integers(2, 4), st.booleans()
)


@given(st.lists(SETTINGS, max_size=12))
def test_a_front_is_what_its_definition_says(drawn):
    """Of all with poses and better than a guess, what no other beats, nor equals more simply."""
    rows = [
        row(side=side, rows=i, models=1.1**time, position=0.1 * 1.1**error, lost=0.02 * lost)
        for i, (time, error, side, lost) in enumerate(drawn)
    ]
    able = {
        i: (time, error, (side, i))
        for i, (time, error, side, lost) in enumerate(drawn)
        if error < 30 and not lost
    }

    def beaten(mine, other):
        no_worse = other[0] <= mine[0] and other[1] <= mine[1]
        return no_worse and (other[:2] != mine[:2] or other[2] < mine[2])

    wanted = {i for i, mine in able.items() if not any(beaten(mine, o) for o in able.values())}
    assert {rows.index(one) for one in fronts(rows)["position"]} == wanted


def test_a_slow_spell_of_the_machine_moves_no_setting_off_the_front():
    """The same two settings, one of them measured while everything took three times as long."""
    slow = row(position=0.5, ms=3.0, p99_ms=6.0, model_ms=1.5, models=2.0)
    rows = [slow, row(position=0.1, ms=2.0, p99_ms=3.0, model_ms=0.5, models=4.0)]
    assert fronts(rows)["position"] == rows


def test_settings_without_poses_or_worse_than_a_guess_are_on_no_front():
    position, angle = GUESSED
    rows = [
        row(ms=0.1, lost=0.02),
        row(ms=0.2, position=1.01 * position, angle=1.01 * angle),
        row(ms=0.3, position=math.nan, angle=math.nan, lost=1.0),
        row(ms=5.0, position=0.5, angle=2 * angle),
        row(ms=7.0, position=2 * position, angle=0.9 * angle),
    ]
    found = fronts(rows)
    assert found == {"position": [rows[3]], "angle": [rows[4]]}
    assert numbered(rows) == rows[3:]
    assert numbered([]) == []


@pytest.mark.parametrize(
    "scene", [SCENE, load_scene("follow"), changed(SCENE, array={"detectors_per_side": 9})]
)
def test_full_plan_is_every_setting_once_and_quick_is_part_of_it(scene):
    sides = {3, 5, 7, 21, scene.array.detectors_per_side}
    full, quick = ([*map(dataclasses.astuple, plan(scene, mode))] for mode in ("full", "quick"))
    wanted = {
        (method, shape, side, steps)
        for shape in SHAPES
        for side in sides
        for method in ALL_METHODS
        for steps in ((0,) if method in PUBLISHED else (4, 6, 10, 16, 25))
    }
    assert sorted(full) == sorted(wanted)
    assert len(set(quick)) == len(quick)
    assert set(quick) < wanted
    assert {setting[0] for setting in quick} == set(ALL_METHODS)
    assert {setting[2] for setting in quick} == sides
    own = scene.array.shape, scene.array.detectors_per_side
    assert full[0][1:3] == quick[0][1:3] == own


def test_rows_hold_the_errors_of_the_estimators():
    settings = [Setting(method, "curved", 3, 4) for method in METHODS]
    rows = {row.method: row for row in measure(SCENE, settings, 12, 5)}
    assert len({row.build_s for row in rows.values()}) == 1  # one table for all
    inside = settings[0].scene(SCENE)
    model, rng = ForwardModel(inside), np.random.default_rng([5, 3, 0])
    poses = lit_poses(model, 12, rng)
    images = model.expose(poses, rng)
    parameters = key_parameters(images, inside.full_scale_counts, inside.signature.peak)
    bounds = cramer_rao_bound(model, poses)
    bound = np.sqrt(np.mean(bounds.std**2, axis=0))
    # A pose in the volume is known as a Gaussian of the variance of its uniform distribution.
    known = np.linalg.inv(bounds.information + np.diag(12 / (HIGH - LOW) ** 2))
    floor = np.sqrt(np.mean(np.diagonal(known, axis1=1, axis2=2), axis=0))
    for method in METHODS:
        estimator, row = Estimator(build_table(inside), method).wait(), rows[method]
        estimates = map(estimator.estimate, images, parameters)
        errors = np.array([estimate.pose for estimate in estimates]) - poses
        rms = np.sqrt(np.mean(errors**2, axis=0))
        assert row.position_m == pytest.approx(math.hypot(*rms[:3]), rel=1e-9)
        assert row.angle_deg == pytest.approx(math.degrees(math.hypot(*rms[3:])), rel=1e-9)
        assert row.bound_position_m == pytest.approx(math.hypot(*bound[:3]), rel=1e-9)
        assert row.floor_position_m == pytest.approx(math.hypot(*floor[:3]), rel=1e-9)
        assert row.floor_angle_deg == pytest.approx(math.degrees(math.hypot(*floor[3:])), rel=1e-9)
        assert row.table_rows == 4**5
        assert 0 < row.median_ms <= row.p99_ms
        assert row.models == pytest.approx(row.median_ms / row.model_ms)


@pytest.mark.usefixtures("sketched", "small")
def test_what_is_measured_is_written_and_drawn(tmp_path, capsys):
    folder = tmp_path / "out"
    result = json_of(run, "--output", folder)
    assert re.search(r"\b8/8 setting", capsys.readouterr().err)
    assert result["complete"] is True
    assert (result["scene"], result["mode"], result["frames"]) == ("reference", "quick", 5)
    assert result["pictures"] == [str(folder / f"tradeoff{suffix}") for suffix in (".png", ".pdf")]
    assert_picture(folder / "tradeoff.png")
    assert (folder / "tradeoff.pdf").read_bytes().startswith(b"%PDF")
    lines = list(csv.DictReader((folder / "tradeoff.csv").read_text().splitlines()))
    assert [line["method"] for line in lines] == [*METHODS, *METHODS, "moments", "look_up"]
    for line, setting in zip(lines, result["settings"], strict=True):
        for key, value in setting.items():
            assert line[key] == str(value) or (value is None and line[key] in ("nan", "inf"))
    assert set(result["fronts"]) == {"position", "angle"}


@pytest.mark.usefixtures("sketched", "small")
@pytest.mark.parametrize("stop_after", [0, 6])
def test_a_run_that_is_stopped_writes_what_it_has(tmp_path, capsys, monkeypatch, stop_after):
    done = []

    def measured(scene, settings, *others):
        for setting in settings:
            if len(done) == stop_after:
                raise KeyboardInterrupt
            done.append(setting)
            yield from measure(scene, [setting], *others)

    monkeypatch.setattr(tradeoff, "measure", measured)
    run("--output", tmp_path, code=130)
    out, error = capsys.readouterr()
    if not stop_after:
        assert out == ""
        assert error.endswith("interrupted\n")
        assert list(tmp_path.iterdir()) == []
        return
    assert "interrupted: 6 of 8 settings" in out
    assert len((tmp_path / "tradeoff.csv").read_text().splitlines()) == 1 + 2 * len(METHODS)
    assert_picture(tmp_path / "tradeoff.png")
