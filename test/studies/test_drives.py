"""``uuv_array study drives``: the course, figures of planted errors, and the command."""

import functools

import command_line
import numpy as np
import pytest
from command_line import json_of, text_of
from onlooker import Onlooker
from scenes import changed

from uuv_optical_array.forward.drawn_sea import draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.studies.drives import LAST_S, Drive, drive, figures, report
from uuv_optical_array.studies.shared.course import course
from uuv_optical_array.studies.shared.errors import FrameErrors

run = functools.partial(command_line.run, "study", "drives")


def test_a_course_goes_from_afar_to_near_and_back_within_what_a_vehicle_can_do():
    times_s = np.linspace(0, 60, 6001)
    poses = course(times_s, 60.0, np.random.default_rng(1))
    assert poses[[0, 3000, -1], 0] == pytest.approx([-8, -4, -8])
    assert np.abs(poses[:, 1:3]).max() == pytest.approx(0.36, rel=0.2)
    assert np.degrees(np.abs(poses[:, 3:]).max()) == pytest.approx(8, rel=0.2)
    speeds = np.abs(np.diff(poses, axis=0)) / 0.01
    assert (speeds.max(axis=0) < [0.25, 0.1, 0.1, 0.05, 0.05]).all()


def planted(errors, std):
    spread = np.where(np.isnan(errors[:, :1, None]), np.nan, np.diag(np.square(std)))
    return FrameErrors(errors, spread, np.empty(0), np.empty(0))


def test_figures_are_those_of_planted_errors():
    std = np.array([0.1, 0.2, 0.2, 0.01, 0.01])
    # One standard deviation off everywhere, but for one frame 7 off in pitch and one without pose.
    errors = np.tile(std, (40, 1))
    errors[0, 3] *= 7
    errors[1] = np.nan
    first = Drive(planted(errors, std), planted(3 * np.tile(std, (10, 1)), std))
    second = Drive(planted(2 * errors[2:], std), planted(3 * np.tile(std, (10, 1)), std))
    found = figures([first, second])
    assert (found["drives"], found["frames"], found["refused"]) == (2, 78, 1)
    assert found["beyond_6_sigma"] == 1
    assert found["nees_mean"] == pytest.approx(((38 * 5 + 4 + 49) / 39 + 20) / 2)
    # Of the last ten frames of both: once and twice the standard deviation, beside three times.
    assert found["rms_tracked"]["y"] == pytest.approx(0.2 * np.sqrt(2.5))
    assert found["rms_single"]["pitch"] == pytest.approx(np.degrees(0.03))
    assert found["range_ratio"] == pytest.approx(np.sqrt(2.5) / 3)


def test_a_sea_is_one_draw_of_the_prior_and_stays():
    # What a brighter lamp does is the same at each pose, and here nothing else differs.
    scene = changed("ideal", prior={"known": "exactly", "lamp_power_std": 0.3})
    count, model = 6, ForwardModel(scene)
    for seed in range(5):
        onlooker = Onlooker(scene)
        drive(onlooker, LAST_S, count / LAST_S, np.random.default_rng(seed))
        rng = np.random.default_rng(seed)
        power = np.exp(draw_sea(scene, rng).offsets["lamp.power"])
        poses = course(np.arange(count) * LAST_S / count, LAST_S, rng)
        assert abs(power - 1) > 0.01
        # Each image is asked for twice: for the track, and by itself.
        np.testing.assert_allclose(onlooker.images[::2], power * model.light(poses), rtol=1e-9)


def test_the_command_prints_the_same_figures_as_text_and_as_json():
    words = ("--drives", "2", "--seconds", "12", "--rate", "1")
    found = json_of(run, *words)
    assert found["complete"]
    assert found["frames"] == 24
    assert report(found) in text_of(run, *words)
