"""Progress: the remaining time, few lines in a file, a bar on a terminal."""

import contextlib
import fcntl
import os
import pty
import re
import struct
import termios

import pytest

from uuv_optical_array.cli import progress


@pytest.fixture
def clock(monkeypatch):
    """The time that progress goes by: a microsecond a look, and what a test adds."""
    now_s = [1e9]

    def time():
        now_s[0] += 1e-6
        return now_s[0]

    monkeypatch.setattr("tqdm.std.time", time)
    return now_s


def test_rounds_of_one_length_foretell_their_end(clock):
    with progress.counter(100, "step") as bar:
        clock[0] += 100
        bar.update(25)
        assert re.search(r"25/100 step \[01:40<05:00\]$", str(bar))


@pytest.mark.usefixtures("clock")
def test_a_file_gets_a_line_for_the_first_round_and_the_last_one(capsys):
    with progress.counter(2000, "frame") as bar:
        for _ in range(2000):
            bar.update()
    assert capsys.readouterr().err == "1/2000 frame [00:00<00:00]\n2000/2000 frame [00:00<00:00]\n"


def test_a_file_gets_lines_at_their_interval(capsys, clock):
    for _ in progress.over(range(9), "step"):
        clock[0] += 0.4 * progress.EVERY_S
    assert re.findall(r"^(\d)/9 step", capsys.readouterr().err, re.MULTILINE) == list("1479")


@pytest.mark.usefixtures("clock")
def test_rounds_without_a_number_are_counted(capsys):
    assert list(progress.over(iter("abc"), "step")) == ["a", "b", "c"]
    assert capsys.readouterr().err == "1 step [00:00]\n3 step [00:00]\n"


@pytest.mark.usefixtures("clock")
def test_an_interrupt_tells_how_far_it_came(capsys):
    rounds = progress.over(range(9), "step")
    for i in rounds:
        if i == 4:
            rounds.close()
    assert capsys.readouterr().err.splitlines()[-1] == "4/9 step [00:00<00:00]"


def test_a_terminal_gets_a_bar():
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    with (
        os.fdopen(theirs, "w") as terminal,
        contextlib.redirect_stderr(terminal),
        progress.counter(100, "%") as shown,
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
    assert "0/100 % [00:00<?]" in text
    assert "moments:  50%|" in text
    assert text.count("\n") == 1
