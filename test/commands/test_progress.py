"""Progress: an end that is foretold steadily, few lines in a file, a bar on a terminal."""

import contextlib
import fcntl
import itertools
import math
import os
import pty
import struct
import termios

import pytest
from command_line import run

from uuv_optical_array.cli import progress
from uuv_optical_array.cli.options import whole_number


class Clock:
    """A clock that is set by hand."""

    def __init__(self):
        self.s = 100.0

    def __call__(self):
        return self.s


def test_rounds_of_one_length_foretell_their_end():
    for done in (1, 50, 99):
        assert progress.left_s(done, 100, 4.0 * done, None) == pytest.approx(4 * (100 - done))


@pytest.mark.parametrize("given", [(0, 100, 50.0, None), (5, 100, 2.9, None), (5, None, 9.0, None)])
def test_what_cannot_be_told_yet_is_not_told(given):
    assert math.isnan(progress.left_s(*given))


def test_an_expectation_keeps_the_first_rounds_from_foretelling_seconds_or_days():
    hour = 3600.0
    assert progress.left_s(0, 100, 0.0, hour) == hour
    # A first hundredth that took nothing, and one that took a minute instead of 36 s.
    assert 0.8 * hour < progress.left_s(1, 100, 0.01, hour) < hour
    assert hour < progress.left_s(1, 100, 60.0, hour) < 1.1 * hour
    # A machine of half the speed is found out, from an hour to two, without a jump.
    told = [progress.left_s(done, 100, 72.0 * done, hour) for done in range(101)]
    assert max(abs(b - a) for a, b in itertools.pairwise(told)) < 0.1 * hour
    assert progress.left_s(100, 100, 2 * hour, hour) == 0


def test_a_file_gets_a_line_every_ten_seconds(capsys):
    now = Clock()
    with progress._Lines(2000, "frame", "sam", None, now) as shown:
        for _ in range(2000):
            now.s += 0.0625  # which adds up exactly
            shown.update()
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "sam: 1/2000 frame, 00:00"
    assert lines[1] == "sam: 161/2000 frame, 00:10, 01:54 left"
    assert len(lines) == 14
    assert lines[-1] == "sam: 2000/2000 frame, 02:05, 00:00 left"


def test_rounds_without_a_number_are_counted(capsys):
    assert list(progress.over(iter("abc"), "step")) == ["a", "b", "c"]
    assert capsys.readouterr().err == "1 step, 00:00\n3 step, 00:00\n"


def test_an_interrupt_tells_how_far_it_came(capsys):
    rounds = progress.over(range(9), "step")
    for each in rounds:
        if each == 4:
            rounds.close()
    assert capsys.readouterr().err.splitlines()[-1] == "4/9 step, 00:00"


def test_a_terminal_gets_a_bar(monkeypatch):
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr("sys.stderr", terminal)
        with progress.counter(100, "%", "sam", expected_s=3600) as shown:
            shown.update(50)
            shown.set_description("moments")
    text = b""
    with contextlib.suppress(OSError):  # the end, once the other side is closed
        while part := os.read(ours, 65536):
            text += part
    os.close(ours)
    text = text.decode()
    assert "sam:   0%|" in text
    assert "0/100 % [00:00<1:00:00]" in text
    assert "moments:  50%|" in text
    assert text.count("\n") == 1


@pytest.mark.parametrize(("text", "number"), [("1e3", 1000), ("20000", 20000), ("-1", -1)])
def test_a_whole_number_may_be_written_as_a_power(text, number):
    assert whole_number(text) == number
    assert isinstance(whole_number(text), int)


@pytest.mark.parametrize("text", ["1.5", "1e-3", "inf", "nan", "many", ""])
@pytest.mark.parametrize(
    "words",
    [
        ("study", "accuracy", "--poses"),
        ("follow", "--seed"),
        ("table", "--threads"),
        ("study", "design", "--take"),
        ("study", "design", "--side"),
    ],
)
def test_what_is_no_whole_number_is_refused(words, text, capsys):
    run(*words, text, code=2)
    assert f"argument {words[-1]}: {text!r} is no whole number" in capsys.readouterr().err


def test_the_version_is_that_of_the_package(capsys):
    import uuv_optical_array

    run("--version")
    assert capsys.readouterr().out == f"uuv_array {uuv_optical_array.__version__}\n"
