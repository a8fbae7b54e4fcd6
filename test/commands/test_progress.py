"""Progress: the remaining time, few lines in a file, a bar on a terminal."""

import contextlib
import fcntl
import itertools
import math
import os
import pty
import re
import struct
import termios

import pytest

from uuv_optical_array.cli import progress


def test_rounds_of_one_length_foretell_their_end():
    for done in (1, 50, 99):
        assert progress.left_s(done, 100, 4.0 * done, None) == pytest.approx(4 * (100 - done))


@pytest.mark.parametrize("given", [(0, 100, 50.0, None), (5, 100, 2.9, None), (5, None, 9.0, None)])
def test_a_remaining_time_that_is_not_known_is_nan(given):
    assert math.isnan(progress.left_s(*given))


def test_an_expectation_keeps_the_first_rounds_from_foretelling_seconds_or_days():
    hour = 3600.0
    assert progress.left_s(0, 100, 0.0, hour) == hour
    # A first hundredth that took nothing, and one that took a minute instead of 36 s.
    assert 0.8 * hour < progress.left_s(1, 100, 0.01, hour) < hour
    assert hour < progress.left_s(1, 100, 60.0, hour) < 1.1 * hour
    # On a machine of half the speed the foretold end moves from one hour to two without a jump.
    ends = [progress.left_s(done, 100, 72.0 * done, hour) for done in range(101)]
    assert max(abs(b - a) for a, b in itertools.pairwise(ends)) < 0.1 * hour
    assert progress.left_s(100, 100, 2 * hour, hour) == 0


def test_a_file_gets_a_line_for_the_first_round_and_the_last_one(capsys):
    with progress.counter(2000, "frame") as bar:
        for _ in range(2000):
            bar.update()
    assert capsys.readouterr().err == "1/2000 frame [00:00<?]\n2000/2000 frame [00:00<?]\n"


def test_a_file_gets_lines_at_their_interval(capsys, monkeypatch):
    monkeypatch.setattr(progress, "EVERY_S", 0.0)
    list(progress.over(range(5), "step"))
    assert re.findall(r"^(\d)/5 step", capsys.readouterr().err, re.MULTILINE) == list("12345")


def test_rounds_without_a_number_are_counted(capsys):
    assert list(progress.over(iter("abc"), "step")) == ["a", "b", "c"]
    assert capsys.readouterr().err == "1 step [00:00]\n3 step [00:00]\n"


def test_an_interrupt_tells_how_far_it_came(capsys):
    rounds = progress.over(range(9), "step")
    for i in rounds:
        if i == 4:
            rounds.close()
    assert capsys.readouterr().err.splitlines()[-1] == "4/9 step [00:00<?]"


def test_a_terminal_gets_a_bar():
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    with (
        os.fdopen(theirs, "w") as terminal,
        contextlib.redirect_stderr(terminal),
        progress.counter(100, "%", expected_s=3600) as shown,
    ):
        shown.update(50)
        shown.set_description("moments")
    text = b""
    with contextlib.suppress(OSError):  # the end, once the other side is closed
        while part := os.read(ours, 65536):
            text += part
    os.close(ours)
    text = text.decode()
    assert "  0%|" in text
    assert "0/100 % [00:00<1:00:00]" in text
    assert "moments:  50%|" in text
    assert text.count("\n") == 1
