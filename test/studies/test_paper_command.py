"""``uuv_array study paper``: what it prints, draws and leaves, whole or cut short."""

import contextlib
import functools
import io
import json
import re
from pathlib import Path
from types import SimpleNamespace

import command_line
import numpy as np
import pytest
from second_paper import OPTIONS, second_angle

from uuv_optical_array.commands.studies import paper as command
from uuv_optical_array.studies.eren2016 import figures as paper
from uuv_optical_array.studies.eren2016 import reproduction
from uuv_optical_array.studies.eren2016.figures import STATEMENTS

run = functools.partial(command_line.run, "study", "paper")


def assert_picture(path):
    command_line.assert_picture(path, least_height=1000)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A whole run: what it wrote, and all angles that it computed, in their order."""
    picture, angles = tmp_path_factory.mktemp("whole") / "p.png", []
    compute = reproduction.angles_deg

    def recorded(*arguments, **named):
        angles.append(compute(*arguments, **named))
        return angles[-1]

    out, error = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reproduction, "angles_deg", recorded)
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
            run("--json", "--output", picture)
    return SimpleNamespace(out=out.getvalue(), error=error.getvalue(), angles=angles)


def test_json_holds_every_point_curve_size_and_choice(whole):
    found = json.loads(whole.out)
    assert "point" in whole.error
    assert "curve" in whole.error
    assert (found["scene"], found["seed"], found["complete"]) == ("eren2016", 1, True)
    assert_picture(Path(found["picture"]))
    points = [(name, p) for name, figure in found["figures"].items() for p in figure["points"]]
    assert len(points) == len(STATEMENTS)
    stated = {
        (name, p["paper_deg"], p["relation"])
        for name, p in points
        if isinstance(p["paper_deg"], float)
    }
    assert stated == {
        ("4a", 2.0, "is"),
        ("4b", 5.0, "is"),
        ("4b", 11.0, "is"),
        ("4b", 12.0, "is"),
        ("4b", 22.0, "is"),
        ("5a", 15.0, "below"),
        ("5a", 15.0, "above"),
        ("5b", 15.0, "below"),
        ("5b", 15.0, "above"),
        ("6b", 6.0, "above"),
        ("6e", 10.0, "above"),
    }
    for _, point in points:
        conditions = point["conditions"]
        if conditions["array"] != "curved" or "compared_with_detectors_per_side" in conditions:
            continue
        motion = "shift" if "shift_m" in conditions else "yaw"
        step = conditions["shift_m" if motion == "shift" else "yaw_deg"]
        expected = second_angle(
            "curved", conditions["detectors_per_side"], conditions["range_m"], motion, step
        )
        assert point["ours_deg"] == pytest.approx(expected, abs=1e-6)
        assert point["met"] in (True, None)
    assert [len(figure["curves"]) for figure in found["figures"].values()] == [
        2, 2, *(2 * [len(paper.SIDES)]), *(6 * [5]),
    ]  # fmt: skip
    by_range = found["figures"]["6b"]["curves"][4]
    assert (by_range["range_m"], by_range["detectors_per_side"]) == (8, 5)
    assert by_range["angle_deg"][7] == pytest.approx(
        second_angle("curved", 5, 8.0, "shift", 0.21), abs=1e-6
    )
    assert by_range["shift_m"][7] == pytest.approx(0.21)
    assert [row["detectors_per_side"] for row in found["sizes"]] == list(paper.SIDES)
    five = found["sizes"][1]
    assert five["angle_deg_at_0_2_m"] == pytest.approx(second_angle("curved", 5, 4.0, "shift", 0.2))
    assert five["angle_deg_at_10_deg"] == pytest.approx(second_angle("curved", 5, 4.0, "yaw", 10.0))
    assert second_angle("curved", 5, 4.0, "shift", five["least_shift_m"] - 0.03) < 15
    assert second_angle("curved", 5, 4.0, "shift", five["least_shift_m"]) >= 15
    assert found["sizes"][0]["least_yaw_deg"] is None
    # More detectors, more places for the peak of one and the same pose.
    noise = [row["noise_deg_at_8_m"] for row in found["sizes"]]
    assert noise[0] < 1 < noise[1] < noise[6] < noise[8]
    assert all(row["noise_deg_at_4_m"] < row["noise_deg_at_8_m"] for row in found["sizes"])
    assert [row["choice"] for row in found["choices"]] == [*OPTIONS, "10 bits, noise of 1 count"]
    first = found["choices"][0]["ours_deg"]
    off = [p["ours_deg"] - p["paper_deg"] for _, p in points if p["relation"] == "is"]
    assert found["choices"][0]["rms_deg"] == pytest.approx(np.linalg.norm(off) / np.sqrt(5))
    for row in found["choices"]:
        a_side = [
            (p["relation"], p["paper_deg"], row["ours_deg"][f"{name} {p['point']}"])
            for name, p in points
            if p["relation"] in ("above", "below")
        ]
        wanted = sum(
            ours is not None and (ours > stated if side == "above" else ours < stated)
            for side, stated, ours in a_side
        )
        assert row["met"] == wanted
    flat = {name for name, ours in found["choices"][11]["ours_deg"].items() if ours is None}
    assert found["choices"][11]["choice"] == "blur of 11 detectors always"
    assert len(flat) == 4
    assert all("curved 5 x 5" in name for name in flat)
    assert [first[f"{name} {p['point']}"] for name, p in points] == [
        p["ours_deg"] for _, p in points
    ]


def test_ctrl_c_reports_what_there_is(tmp_path):
    program = [*command_line.PROGRAM, "study", "paper", "--output", tmp_path / "p.png"]
    code, *told = command_line.interrupted(program, rb"\b[1-9]\d*/\d+ .*point")
    out, error = (text.decode() for text in told)
    assert code == 130, out + error
    assert "Traceback" not in error
    assert "interrupted" in out
    assert re.search(r"^1 +4a +.* 2 .* \+", out, re.M)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def stop(monkeypatch):
    """Interrupt the command at the n-th round of a bar."""

    def at(unit, number):
        def bar(rounds, name):
            for i, item in enumerate(rounds):
                if (name, i) == (unit, number):
                    raise KeyboardInterrupt
                yield item

        monkeypatch.setattr(command.progress, "over", bar)

    return at


@pytest.mark.usefixtures("sketched")
def test_an_interrupt_between_choices_draws_and_keeps_those_before(
    capsys, tmp_path, stop, whole, monkeypatch
):
    known = iter(whole.angles)
    monkeypatch.setattr(reproduction, "angles_deg", lambda *_, **__: next(known))
    stop("choice", 2)
    run("--output", tmp_path / "p.png", code=130)
    out = capsys.readouterr().out
    assert "interrupted" in out
    assert re.search(r"^3 +4b +planar 21 x 21, 4 m, yaw 5 deg +5 +5\.9 +\+0\.9$", out, re.M)
    assert re.search(r"^8 .* > 15 +28\.6 +met$", out, re.M)
    assert re.search(r"^as reconstructed .* 6 +1\.0$", out, re.M)
    assert "noise of 1 count" not in out
    assert f"picture: {tmp_path / 'p.png'}" in out
    assert_picture(tmp_path / "p.png")


def test_an_interrupt_before_the_first_point_computes_nothing(capsys, tmp_path, stop):
    stop("point", 0)
    for words in ((), ("--json",)):
        run("--output", tmp_path / "p.png", *words, code=130)
        assert capsys.readouterr().out == "interrupted: nothing computed\n"
    assert not list(tmp_path.iterdir())


def test_an_interrupt_between_points_keeps_those_before_and_draws_nothing(capsys, tmp_path, stop):
    stop("point", 4)
    run("--json", "--output", tmp_path / "p.png", code=130)
    found = json.loads(capsys.readouterr().out)
    assert not found["complete"]
    assert found["picture"] is None
    assert [len(figure["points"]) for figure in found["figures"].values()][:3] == [2, 2, 0]
    run("--output", tmp_path / "p.png", code=130)
    out = capsys.readouterr().out
    assert "interrupted" in out
    assert "no picture" in out
    assert "5.9" in out
    assert "22" not in out
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--seed", "-1"), ("--seed", "-1", "from 0")),
        (("--scene", "atlantis"), ("atlantis", "eren2016")),
        (("--scene", "sea.yaml"), ("sea.yaml", "no such file")),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, words, named):
    error = run(*words, "--output", tmp_path / "p.png", code=1)
    assert error.startswith("uuv_array study paper: ")
    for word in named:
        assert word in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [("--seed", "one"), ("--poses", "3"), ("fast",)])
def test_a_word_that_is_no_option_is_refused_by_name(capsys, words):
    run(*words, code=2)
    assert words[-1] in capsys.readouterr().err


def test_a_folder_that_is_not_there_is_refused_in_one_line_and_at_once(tmp_path):
    error = run("--output", tmp_path / "deep" / "p.png", code=1)
    assert error.startswith("uuv_array study paper: --output")
    assert f"no folder {tmp_path / 'deep'}" in error


def test_help_explains_every_option_and_shows_examples(capsys):
    run("--help")
    text = capsys.readouterr().out
    for option in ("--scene", "--seed", "--output", "--json"):
        assert re.search(rf"{option}\b.*?\s\w+ \w+", text, re.DOTALL)
    assert len(re.findall(r"^  uuv_array study paper\b", text.partition("examples:")[2], re.M)) >= 3
