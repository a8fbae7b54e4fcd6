"""Options made from settings: their bounds, defaults and words, and the exit codes."""

import argparse
from dataclasses import dataclass
from typing import Annotated, Literal

import pytest
from command_line import run, text_of
from hypothesis import given
from hypothesis import strategies as st
from reference_pages.commands import command_parsers

import uuv_optical_array
from uuv_optical_array.cli import options
from uuv_optical_array.commands import build_parser
from uuv_optical_array.core.settings import Place, Quantity, declared


@dataclass(frozen=True)
class Course:
    rate_hz: Annotated[float, Quantity("rate, 100 % of it", "Hz", 0.5, 1000.0)] = 10.0
    laps: Annotated[int, Quantity("laps", "", 1, 50)] = 3
    way: Annotated[Literal["out", "home"], Quantity("direction")] = "out"
    buoy_m: Annotated[Place, Quantity("the buoy", "m", -9, 9)] = (0.0, 1.5, -2.0)


def parsed(*words):
    parser = argparse.ArgumentParser(formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_set(parser, declared(Course))
    return Course(**dict(parser.parse_args(words).set))


@given(st.floats(0.5, 1000.0), st.integers(1, 50), st.tuples(*3 * [st.floats(-9, 9)]))
def test_settings_have_the_values_that_they_are_given_last(rate, laps, buoy):
    given = "laps=2", f"rate_hz={rate!r}", f"laps={laps}", "way=home", "buoy_m=" + str([*buoy])
    words = [word for value in given for word in ("--set", value)]
    assert parsed(*words) == Course(rate, laps, "home", buoy)
    assert parsed() == Course()
    assert parsed("--set", "laps=4e1").laps == 40
    assert parsed("--set", "buoy_m=1,-2,3e0").buoy_m == (1.0, -2.0, 3.0)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (
            "laps=2.5",
            "laps: 2.5 is not a whole number; give a whole number without a unit, from 1 to 50",
        ),
        ("laps=inf", "laps: inf is not a whole number"),
        ("laps=", "laps: '' is not a whole number"),
        ("laps=51", "laps: 51 is out of bounds; it must be from 1 to 50"),
        ("rate_hz=fast", "rate_hz: 'fast' is not a number; give a number without a unit, from 0.5"),
        ("rate_hz=0", "rate_hz: 0.0 is out of bounds; it must be from 0.5 to 1000 Hz"),
        ("rate_hz=nan", "rate_hz: nan is out of bounds"),
        ("way=up", "way: 'up' is unknown; choose out or home"),
        ("buoy_m=1,2", "buoy_m: [1.0, 2.0] is not a place; give [x, y, z]"),
        ("buoy_m=1,2,east", "buoy_m[2]: 'east' is not a number"),
        ("buoy_m=1,2,10", "buoy_m[2]: 10.0 is out of bounds; it must be from -9 to 9 m"),
        ("laps", "laps: no value; give laps=VALUE"),
        ("lap=1", "lap: unknown key; did you mean laps?"),
        ("tide=1", "tide: unknown key; known here: rate_hz, laps, way, buoy_m"),
    ],
)
def test_an_error_names_setting_value_and_bound(words, reason, capsys):
    with pytest.raises(SystemExit, match="2"):
        parsed("--set", words)
    assert f"argument --set: {reason}" in capsys.readouterr().err


def test_help_gives_text_unit_and_default(capsys):
    with pytest.raises(SystemExit):
        parsed("--help")
    lines = capsys.readouterr().out.splitlines()
    assert lines[-4:] == [
        "  rate_hz=HZ: rate, 100 % of it (default: 10)",
        "  laps=N: laps (default: 3)",
        "  way={out,home}: direction (default: out)",
        "  buoy_m=X,Y,Z: the buoy, m (default: 0,1.5,-2)",
    ]


def test_every_default_is_a_value_that_its_option_takes():
    for parser in command_parsers(build_parser()):
        for action in parser._actions:
            if action.type is not None and isinstance(action.default, int | float):
                value = action.type(str(action.default))
                assert value == action.default, (parser.prog, action.dest)


def test_the_name_of_a_study_alone_says_how_it_is_called():
    error = run("accuracy", "--json", code=2)
    assert error == "uuv_array accuracy: it is called `uuv_array study accuracy`"


def test_each_command_that_writes_takes_the_short_name_of_its_output():
    helps = [parser.format_help() for parser in command_parsers(build_parser())]
    long = [text for text in helps if "  --output" in text or ", --output" in text]
    assert len(long) > 10
    assert not [text for text in long if "  -o " not in text]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("budget", "--lamp-w", "2"), "--lamp-w 2; it is called `--set lamp_w=VALUE`"),
        (("view", "--beacon-position=1"), "; it is called `--set beacon_position_m=VALUE`"),
        (("calibrate", "bag", "--image-topic", "a"), "a; it is called `--set image_topic=VALUE`"),
        (("budget", "--tide", "2"), "--tide 2"),
        (("budget", "bag", ""), "bag "),
        (("budget", ""), ""),
    ],
)
def test_an_option_that_is_a_setting_now_says_how_it_is_called(words, told):
    error = run(*words, code=2)
    assert error.startswith(f"uuv_array {words[0]}: error: unrecognized arguments: ")
    assert error.endswith(told)
    assert ("called" in error) == ("called" in told)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("folow",), "did you mean follow?"),
        (("study", "acuracy"), "did you mean accuracy?"),
        (("limits", "--shape", "planr"), "did you mean planar?"),
        (("render", "--scnee", "follow"), "did you mean --scene?"),
    ],
)
def test_a_word_with_a_slip_says_which_was_perhaps_meant(words, told):
    assert run(*words, code=2).endswith(f"; {told}")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--scnee", "f", "follow"), "--scnee; give options after the command"),
        (("--scene=f", "follow"), "--scene; give options after the command"),
        (("study", "--sed", "2", "accuracy"), "--sed; give options after the command"),
        (("--verison", "follow"), "--verison; did you mean --version?"),
    ],
)
def test_an_option_before_the_command_is_named_and_not_its_value(words, told):
    assert run(*words, code=2) == f"uuv_array: error: unrecognized arguments: {told}"


def test_the_options_of_the_program_itself_may_be_abbreviated():
    assert text_of(run, "--vers") == text_of(run, "--version")
    assert text_of(run, "study", "--he") == text_of(run, "study", "-h")


def test_a_word_that_is_like_none_gets_no_hint():
    assert "did you mean" not in run("quux", code=2)


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
    (
        ("follow", "--leader-path", "zigzags"),
        "'zigzags' is neither a ready path nor a file; did you mean",
    ),
    (("view", "--address", ":0"), "--address: 0 is out of bounds"),
    (("view", "--screenshot", "/nowhere/view.png"), "make it first"),
    (("view", "/nowhere/bag"), "no such file or folder"),
    (("view", "bag", "--set", "image=a"), "image: unknown key; known here: image_topic, "),
    (("view", "bag", "--set", "image_topic"), "image_topic: no value; give image_topic=VALUE"),
    (("view", "--set", "image_topic=a"), "--set image_topic: no bag is read; name one, or leave"),
    (("calibrate", "bag", "--set", "commands_topic=a"), "commands_topic: unknown key"),
    (("calibrate", "bag", "--set", "states_topic=a"), "states_topic: unknown key"),
    (("calibrate", "bag", "--set", "beacon_position_m=0,0,nan"), "beacon_position_m[2]: nan is"),
    (("calibrate", "bag", "--set", "max_gap_s=0"), "max_gap_s: 0.0 is out of bounds"),
    (("calibrate", "bag", "--set", "position_std_m=-1"), "position_std_m: -1.0 is out"),
    (("calibrate", "bag", "-o", "sea.txt"), ".yaml"),
    (("calibrate", "bag", "--noise", "--scene", "ideal"), "sensor_noise"),
    (
        ("follow", "--followers", "4", "--no-chain"),
        "4 is out of bounds; it must be from 1 to 3 without a chain",
    ),
    (("follow", "--duration", "nan"), "--duration: nan is out of bounds"),
    (("follow", "--duration", "soon"), "--duration: 'soon' is not a number"),
    (("follow", "--params-file", "nowhere/p.yaml"), "nowhere/p.yaml: no such file"),
    (("follow", "--scene", "atlantis"), "scene atlantis: neither"),
    (("follow", "--seed", "-5"), "seed: -5 is out of bounds; it must be from -1 to"),
    (("table", "--workers", "0"), "--workers 0: give a number of threads, at least 1, or the"),
    (("table", "--workers", "many"), "--workers many: give a number of threads"),
    ((*POSE, -2000, 0, 0, 0, 0), "--pose X: -2000.0 is out of bounds; it must be"),
    ((*POSE, -6, 0, 0, 95, 0), "--pose PITCH_DEG: 95.0 is out of bounds"),
    ((*POSE, -6, "nan", 0, 0, 0), "--pose Y: nan is out of bounds"),
    ((*POSE, -6), "--pose: expected 5 arguments"),
    # Python 3.11 takes the former for an option.
    ((*POSE, "-2e3", 0, "-1.5E-3", 0, 0), "--pose X: -2000.0 is out of bounds; it must be"),
    (("view", "--address", "[::1]:0"), "--address: 0 is out of bounds"),
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
    ((*DESIGN, "--sweep", "span_m=1"), "span_m: unknown key; known here: shape, "),
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
