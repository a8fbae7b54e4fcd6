"""``uuv_array`` as a user types it: help that teaches, one line for an error, a whole run."""

import importlib.util
import os
import re
import shlex
import signal

import pytest
from command_line import PROGRAM, SKETCHING, assert_picture, begun, ended, run
from conftest import PATIENCE_S
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from reference_pages.commands import command_parsers

from uuv_optical_array.commands import build_parser
from uuv_optical_array.core.messages import stamp_ns
from uuv_optical_array.recording.bag import RUN, opened


def follow(*words, start_s=PATIENCE_S, before=""):
    """Run ``uuv_array follow`` in a process of its own; the leader waits for its follower."""
    *python, code = PROGRAM
    waiting = f"from uuv_optical_array.nodes.bringup import demo; demo.START_S = {start_s}"
    code = "\n".join([before, waiting, code])
    unbuffered = {**os.environ, "PYTHONUNBUFFERED": "1"}
    return begun([*python, code, "follow", *words], env=unbuffered)


def test_help_explains_every_option_and_shows_examples_that_can_be_typed():
    whole = build_parser()
    parsers = list(command_parsers(whole))
    assert len(parsers) == len({parser.prog for parser in parsers}) == 22
    for parser in parsers:
        for action in parser._actions:
            assert len((action.help or "").split()) > 1, (parser.prog, action.dest)
        examples = re.findall(rf"^  {parser.prog}\b.*", parser.epilog, re.MULTILINE)
        assert len(examples) >= 3, parser.prog
        for example in examples:
            command = re.split(r"  +| > ", example.strip())[0]
            whole.parse_args(shlex.split(command)[1:])


@pytest.mark.parametrize("words", [(), ("fly",), ("table", "--colour", "red")])
def test_what_is_no_command_is_refused_with_the_usage(capsys, words):
    run(*words, code=2)
    assert "usage: uuv_array" in capsys.readouterr().err


def test_follow_ends_by_itself_with_a_summary_a_picture_and_a_bag(tmp_path):
    picture, bag = tmp_path / "run.png", tmp_path / "run"
    record = ("--record", bag) if importlib.util.find_spec("rosbags") else ()
    with follow("--duration", "2", "--seed", "1", "--output", picture, *record) as process:
        out, _ = ended(process)
    assert re.search(r"^sea: drawn from the prior of scene follow, seed 1: lamp.power x", out, re.M)
    poses, images = map(int, re.search(r"(\d+) poses from (\d+) images", out).groups())
    assert 0 < poses <= images
    line = re.search("^estimate RMS.*", out, re.MULTILINE)[0]
    rms = [float(number) for number in re.findall(r"([\d.]+) (?:m|deg)\b", line)]
    assert len(rms) == 5
    assert max(rms[:3]) < 1.0
    assert max(rms[3:]) < 20
    assert "followed the leader to the end" in out
    assert f"picture: {picture}" in out
    assert_picture(picture)
    if record:
        with opened(bag) as held:
            assert {channel.topic for channel, count in held.counts.items() if count} == {
                f"/{topic}" for topic in RUN
            }


def test_follow_that_never_sees_light_says_that_the_leader_was_lost(tmp_path):
    dark = tmp_path / "dark.yaml"
    dark.write_text("/**: {ros__parameters: {min_peak_counts: 60000.0}}\n", "utf-8")
    words = ("--duration", "2", "--params-file", dark, "--output", tmp_path / "x.png")
    words += ("--seed", "3", "--exact-sea", "--followers", "2")
    with follow(*words, start_s=2.0, before=SKETCHING) as process:
        out, _ = ended(process, 1)
    never = []
    for number, seed in ((1, 3), (2, 4)):
        sea = f"follower {number}: sea: exactly that of scene follow, seed {seed}"
        assert sea in out.splitlines()
        never.append(f"follower {number}: it never set off; the log says what it waited for")
    assert out.count("0 poses from") == 2
    assert f"lost the leader: {'; '.join(never)}" in out
    assert not (tmp_path / "x.png").exists()


def test_ctrl_c_ends_follow_early_with_a_summary_and_a_picture(lab, tmp_path):
    picture = tmp_path / "run.png"
    lab.begin()
    poses = lab.listen(PoseWithCovarianceStamped, "relative_pose")
    leader = lab.listen(Odometry, "leader/odometry")

    def followed():
        off = [message.header for message in leader if message.twist.twist != Twist()]
        return off and [p for p in poses if stamp_ns(p.header) > stamp_ns(off[0])][4:]

    words = ("--duration", "600", "--output", picture)
    with follow(*words, before=SKETCHING) as process:
        lab.until(lambda: followed() or process.poll() is not None, "poses")
        process.send_signal(signal.SIGINT)
        out, _ = ended(process, 130)
    assert re.search(r"[1-9]\d* poses from [1-9]\d* images", out)
    assert "followed the leader until it was interrupted" in out
    assert_picture(picture)
