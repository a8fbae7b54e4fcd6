"""Options made from settings: their bounds, defaults and words, and the exit codes."""

import argparse
from dataclasses import dataclass
from typing import Annotated, Literal

import pytest
from command_line import run, text_of
from generated import reference
from hypothesis import given
from hypothesis import strategies as st

import uuv_optical_array
from uuv_optical_array.cli import options
from uuv_optical_array.commands import build_parser
from uuv_optical_array.core.settings import Quantity


@dataclass(frozen=True)
class Course:
    rate_hz: Annotated[float, Quantity("rate, 100 % of it", "Hz", 0.5, 1000.0)] = 10.0
    laps: Annotated[int, Quantity("laps", "", 1, 50)] = 3
    way: Annotated[Literal["out", "home"], Quantity("direction")] = "out"
    still: Annotated[bool, Quantity("without current")] = False


def parsed(*words):
    parser = argparse.ArgumentParser()
    options.add_settings(parser, Course)
    return Course(**options.settings_of(parser.parse_args(words), Course))


@given(st.floats(0.5, 1000.0), st.integers(1, 50))
def test_options_set_the_settings_that_they_were_made_from(rate, laps):
    given = parsed("--rate-hz", repr(rate), "--laps", str(laps), "--way", "home", "--still")
    assert given == Course(rate, laps, "home", True)
    assert parsed() == Course()
    assert parsed("--laps", "4e1").laps == 40


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--laps", "2.5"), "argument --laps: '2.5' is no whole number"),
        (("--laps", "inf"), "argument --laps: 'inf' is no whole number"),
        (("--laps", ""), "argument --laps: '' is no whole number"),
        (("--rate-hz", "fast"), "argument --rate-hz: 'fast' is no number"),
        (("--rate-hz", "0"), "--rate-hz: 0.0 is out of bounds; it must be from 0.5 to 1000 Hz"),
        (("--rate-hz", "nan"), "--rate-hz: nan is out of bounds"),
        (("--laps", "51"), "--laps: 51 is out of bounds; it must be from 1 to 50"),
        (("--way", "up"), "--way: invalid choice: 'up'"),
    ],
)
def test_an_error_names_option_value_and_bound(words, reason, capsys):
    with pytest.raises(SystemExit, match="2"):
        parsed(*words)
    assert reason in capsys.readouterr().err


def test_help_gives_text_unit_and_default(capsys):
    with pytest.raises(SystemExit):
        parsed("--help")
    text = " ".join(capsys.readouterr().out.split())
    assert "--rate-hz HZ rate, 100 % of it (default: 10)" in text
    assert "--laps N laps (default: 3)" in text


def test_every_default_is_a_value_that_its_option_takes():
    for parser in reference.command_parsers(build_parser()):
        for action in parser._actions:
            if action.type is not None and isinstance(action.default, int | float):
                value = action.type(str(action.default))
                assert value == action.default, (parser.prog, action.dest)


def test_the_name_of_a_study_alone_says_how_it_is_called():
    error = run("accuracy", "--json", code=2)
    assert error == "uuv_array accuracy: it is called `uuv_array study accuracy`"


# The words of a command, and what its one line of an error says.
ACCURACY, ROBUSTNESS, DESIGN = (("study", name) for name in ("accuracy", "robustness", "design"))
POSE = ("limits", "--output", "never.png", "--pose")
REFUSED = [
    (("render", "--scene", "sea.yaml"), "scene sea: effects.fog: unknown key"),
    (("render", "--seed", "-1"), "--seed: -1 is out of bounds"),
    (("table", "--scene", "nowhere.yaml", "-o", "out/t"), "nowhere.yaml: no such file"),
    (("scenes", "folow"), "did you mean follow?"),
    (("scenes", "plum"), "did you mean plume?"),
    (("scenes", "beam_sigma"), "did you mean beam_sigma_deg?"),
    (("scenes", "xyzzy"), "uuv_array scenes lists the ready ones"),
    (("scenes", "nowhere.yaml"), "nowhere.yaml: no such file"),
    (("view", "--address", ":0"), "--address: 0 is out of bounds"),
    (("view", "--screenshot", "/nowhere/view.png"), "make it first"),
    (("view", "/nowhere/bag"), "no such file or folder"),
    (("view", "bag", "--remap", "image:=a"), "FROM is one of array/image, leader/odometry"),
    (("view", "bag", "-r", "array/image"), "--remap array/image: give FROM:=TO"),
    (("calibrate", "bag", "--beacon-position", "0", "0", "nan"), "--beacon-position: nan is"),
    (("calibrate", "bag", "--max-gap-s", "0"), "--max-gap-s"),
    (("calibrate", "bag", "--pose-std", "-1", "0"), "--pose-std, position: -1.0 is out"),
    (("calibrate", "bag", "-o", "sea.txt"), ".yaml"),
    (("calibrate", "bag", "--noise", "--scene", "ideal"), "sensor_noise"),
    (
        ("follow", "--followers", "4", "--no-chain"),
        "4 is out of bounds; it must be from 1 to 3 without a chain",
    ),
    (("follow", "--duration", "nan"), "--duration: nan is out of bounds"),
    (("follow", "--duration", "soon"), "--duration: 'soon' is no number"),
    (("follow", "--params-file", "nowhere/p.yaml"), "nowhere/p.yaml: no such file"),
    (("follow", "--scene", "atlantis"), "scene atlantis: neither"),
    (("follow", "--seed", "-5"), "seed: -5 is out of bounds; it must be from -1 to"),
    (("table", "--workers", "0"), "--workers 0: give a number of threads, at least 1, or the"),
    (("table", "--workers", "many"), "--workers many: give a number of threads"),
    ((*POSE, -2000, 0, 0, 0, 0), "--pose X: -2000.0 is out of bounds; it must be"),
    ((*POSE, -6, 0, 0, 95, 0), "--pose PITCH_DEG: 95.0 is out of bounds"),
    ((*POSE, -6, "nan", 0, 0, 0), "--pose Y: nan is out of bounds"),
    ((*POSE, -6), "--pose: expected 5 arguments"),
    ((*ACCURACY, "--known", "--method", "sam"), "--known", "sam", "use least_squares"),
    ((*ACCURACY, "--known", "--lamps"), "--known", "--lamps", "leave one"),
    ((*ACCURACY, "--lamps", "--method", "sam"), "--lamps", "sam", "use least_squares"),
    ((*ACCURACY, "--lamps"), "--lamps", "reference", "no lamps"),
    ((*ACCURACY, "--drawn"), "--drawn", "reference", "prior"),
    ((*ACCURACY, "--moving"), "--moving", "reference", "lamp_drift, lamp_flicker, plume"),
    ((*ROBUSTNESS, "--kinds", "k-0.05,rain"), "--kinds", "'rain'", "nothing", "blob"),
    ((*ROBUSTNESS, "--kinds", ""), "--kinds", "''", "nothing"),
    ((*ROBUSTNESS, "--kinds", "moving"), "--kinds", "moving", "plume", "scene follow has not"),
    (("study", "drives", "--scene", "reference"), "--scene: reference has no prior"),
    ((*DESIGN, "--sweep", "span_m=1"), "span_m=1: give NAME=VALUE,... with NAME one of shape, "),
]


@pytest.mark.parametrize(("words", "told"), [(words, told) for words, *told in REFUSED])
def test_a_value_that_cannot_be_used_ends_with_2_in_one_line_and_nothing_is_written(
    words, told, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    scene = tmp_path / "sea.yaml"
    scene.write_text("extends: follow\neffects: {fog: {}}", encoding="utf-8")
    line = run(*words, code=2)
    name = " ".join(words[: 2 if words[0] == "study" else 1])
    assert line.startswith(f"uuv_array {name}: ")
    for part in told:
        assert part in line
    assert list(tmp_path.iterdir()) == [scene]
    assert capsys.readouterr().out == ""


def test_what_fails_at_run_time_ends_with_1(tmp_path):
    damaged = tmp_path / "p.yaml"
    damaged.write_text("/**: {", encoding="utf-8")
    assert str(damaged) in run("follow", "--params-file", damaged, code=1)


def test_what_has_no_possible_name_ends_with_2(tmp_path):
    for option, words in (("-o", ["table"]), ("--output", ["render"])):
        assert "name too long" in run(*words, option, tmp_path / f"{'a' * 300}.png", code=2)


def test_the_version_is_that_of_the_package():
    assert text_of(run, "--version") == f"uuv_array {uuv_optical_array.__version__}\n"
