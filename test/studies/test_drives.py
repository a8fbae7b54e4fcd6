"""``uuv_array study drives``: the course, figures of planted errors, and the command."""

import functools

import command_line
import numpy as np
import pytest
from blind import Blind
from command_line import json_of, text_of

from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies import drives
from uuv_optical_array.studies.drives import LAST_S, Drive, course, drive, figures, report
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


def test_a_sea_is_one_draw_of_the_prior_and_stays(monkeypatch):
    seas, model = [], drives.ForwardModel

    class Watched(model):
        def light(self, pose, roll, offsets):
            seas.append({name: float(off) for name, off in offsets.items()})
            return super().light(pose, roll, offsets)

    scene = load_scene("follow")
    monkeypatch.setattr(drives, "ForwardModel", Watched)
    monkeypatch.setattr(drives, "Pipeline", lambda estimator: estimator)
    for i in range(200):
        found = drive(Blind(scene), LAST_S, 0.2, np.random.default_rng(i))
        assert not found.tracks.posed.any()
        assert seas[-1] == seas[-2]
    stds = scene.prior.nuisance_std()
    drawn = [list(sea.values()) for sea in seas[::2]]
    assert np.std(drawn, axis=0) == pytest.approx(list(stds.values()), rel=4 / np.sqrt(2 * 200))


def test_the_command_prints_the_same_figures_as_text_and_as_json():
    words = ("--drives", "2", "--seconds", "12", "--rate", "1")
    found = json_of(run, *words)
    assert found["complete"]
    assert found["frames"] == 24
    assert report(found) in text_of(run, *words)
