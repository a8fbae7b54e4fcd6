"""``uuv_array advise``: its choice on measurements made by hand."""

import functools
import math
import re

import command_line
import measured
import pytest
import yaml
from command_line import json_of, text_of
from scenes import changed

from uuv_optical_array.commands.advise import Need, advise, calibrating
from uuv_optical_array.forward.scene import load_scene, scene_from_settings
from uuv_optical_array.studies import tradeoff
from uuv_optical_array.studies.shared.results import write
from uuv_optical_array.studies.tradeoff import origin_of

SCENE = load_scene("reference")
NEED = Need(rate_hz=10.0, position_m=0.2, angle_deg=10.0)


def row(method="least_squares", side=5, rows=1024, position=0.1, p99=50.0, **others):
    return measured.row(
        method, side, rows, position, **{"median_ms": 5.0, "models": 10.0, "p99_ms": p99, **others}
    )


run = functools.partial(command_line.run, "advise")


@pytest.fixture
def folder(tmp_path):
    """Measurements of this machine: 3 x 3 is too coarse, 7 x 7 too slow at 100 Hz."""
    rows = [
        row("moments", 3, 0, position=0.01, p99=0.1, steps=0),
        row(side=3, position=0.25, p99=8.0),
        row(side=5, rows=100_000, steps=10, p99=9.0, median_ms=2.0),
        row(side=5, position=0.12, p99=10.0),
        row("sam", 5, 1024, position=0.6, p99=0.5),
        row(side=7, position=0.05, angle=1.0, p99=20.0),
    ]
    write(tmp_path / "tradeoff.csv", origin_of(SCENE, "quick"), [vars(one) for one in rows])
    return tmp_path


def test_cheapest_is_fewest_detectors_then_smallest_table_then_least_time():
    best = row(side=3, rows=1000, median_ms=9.0)
    others = [
        row(side=5, rows=10, median_ms=0.1),
        row(side=3, rows=2000, median_ms=0.1),
        row(side=3, rows=1000, median_ms=9.1),
    ]
    for at in range(4):
        assert advise([*others[:at], best, *others[at:]], NEED) == (best, {})


@pytest.mark.parametrize(
    "flaw",
    [
        {"position": 0.201},
        {"angle": 10.1},
        {"p99": 100.1},
        {"without_pose": 0.011},
        {"position": math.nan, "angle": math.nan, "without_pose": 1.0},
        {"method": "look_up"},
    ],
)
def test_each_limit_counts_and_published_methods_are_no_choice(flaw):
    good = row(side=21, position=0.2, angle=10.0, p99=100.0, without_pose=0.01, median_ms=99.0)
    assert advise([row(side=2, **flaw), good], NEED) == (good, {})


def test_nearest_is_the_one_whose_worst_value_is_least_off():
    slow = row(position=0.1, angle=1.0, p99=160.0)
    both = row(position=0.3, angle=15.0, p99=1.0)
    coarse = row(position=0.5, angle=1.0, p99=1.0)
    nearest, excess = advise([slow, coarse, both, row(position=math.nan)], NEED)
    assert nearest is both
    assert excess == pytest.approx({"position_m": 0.1, "angle_deg": 5.0})
    assert advise([slow, coarse], NEED)[1] == pytest.approx({"p99_ms": 60.0})


def test_without_our_methods_there_is_no_advice():
    with pytest.raises(ValueError, match="no setting of sam, "):
        advise([row("moments")], NEED)


def test_command_names_what_to_change(folder):
    out = text_of(run, "--rate", 100, "--output", folder)
    assert out.startswith("100 Hz, 0.2 m, 10 deg: least_squares, curved 5 x 5, table 1e3\n")
    # What is printed can be pasted into the scene file.
    lines = out.partition("in the scene (reference):\n")[2].partition("parameter")[0]
    pasted = {**SCENE.settings(), **yaml.safe_load(lines)}
    made = scene_from_settings(pasted, "pasted")
    assert made.array == SCENE.array
    assert made.table.yaw_deg == (-20.0, 20.0, 4)
    assert made.table.y_m == (-0.9, 0.9, 4)
    assert "method: least_squares" in out.partition("parameter of the estimator_node:")[2]


def test_command_says_that_no_setting_meets_the_need_and_by_how_much(folder):
    words = ("--rate", 100, "--position", 0.08, "--output", folder)
    out = text_of(run, *words, code=1)
    assert out.startswith("no setting meets 100 Hz, 0.08 m, 10 deg; the nearest: ")
    assert "least_squares, curved 5 x 5, table 1e5" in out.splitlines()[0]
    assert "position is 0.1 m, 0.02 more than 0.08 (+25%)" in out
    assert "99th percentile is" not in out
    result = json_of(run, *words, code=1)
    assert (result["met"], result["settings"]) == (False, 6)
    assert result["lacks"] == pytest.approx({"position_m": 0.02})
    assert result["asked"] == {"rate_hz": 100.0, "position_m": 0.08, "angle_deg": 10.0}
    assert result["found"]["table_rows"] == 100_000
    assert result["change"]["estimator_node"] == {"method": "least_squares"}
    assert result["change"]["scene"]["array"]["detectors_per_side"] == 5
    assert result.keys() >= {"scene", "measured", "load_average", "complete"}
    result = json_of(run, "--rate", 10, "--output", folder)
    assert (result["met"], result["lacks"]) == (True, {})


def test_a_folder_without_measurements_is_refused_with_what_makes_them(tmp_path):
    said = run("--output", tmp_path, code=2)
    assert "no tradeoff.csv in it; uuv_array study tradeoff --scene reference --output" in said


def test_of_a_scene_that_is_known_exactly_it_says_so(folder):
    assert "are taken as known exactly" in text_of(run, "--rate", 100, "--output", folder)


@pytest.mark.parametrize("field", ["fingerprint", "machine"])
def test_measurements_of_elsewhere_are_not_used(field, tmp_path, capsys, monkeypatch):
    origin = origin_of(SCENE, "quick") | {field: "another"}
    write(tmp_path / "tradeoff.csv", origin, [vars(row(side=2))])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    measured = []

    def measure(scene, settings, frames, seed):
        for _ in settings:
            if len(measured) == stop_after:
                raise KeyboardInterrupt
            measured.append((frames, seed))
            yield row(side=11, shape="planar")

    monkeypatch.setattr(tradeoff, "measure", measure)
    stop_after = 1
    result = json_of(run, "--output", tmp_path, code=130)
    assert result["found"]["shape"] == "planar"
    assert (result["complete"], result["measured"]) == (False, "not kept")
    assert "radius_m" not in result["change"]["scene"]["array"]
    assert measured == [(300, 1)]
    assert "another scene or machine" in capsys.readouterr().err
    # A whole measurement is kept, and read the next time.
    stop_after = None
    measured.clear()
    results = [json_of(run, "--output", tmp_path) for _ in range(2)]
    assert len(measured) == len(tradeoff.plan(SCENE, "quick"))
    assert results[0] == results[1]
    assert results[0]["complete"] is True
    assert results[0]["measured"].startswith(str(tmp_path / "cache"))


def test_a_scene_that_is_not_exact_says_what_a_calibration_would_gain():
    text = calibrating(changed(SCENE, prior={"lamp_power_std": 0.2}), row())
    now, then = map(float, re.findall(r"([\d.]+) m ", text))
    assert now > 1.5 * then
    assert "taken as known exactly" in calibrating(SCENE, row())
