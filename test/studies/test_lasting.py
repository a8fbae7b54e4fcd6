"""``uuv_array study lasting``: a sea that stays as it is, planted errors, and the command."""

import functools

import command_line
import numpy as np
import pytest
from command_line import json_of, text_of
from onlooker import Onlooker

from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.lasting import Drive, drive, figures, kinds_that_last, report
from uuv_optical_array.studies.shared.errors import FrameErrors

run = functools.partial(command_line.run, "study", "lasting")


def test_what_is_drawn_at_random_is_drawn_once_for_a_drive():
    onlooker = Onlooker(load_scene("reference"))
    (dead,) = kinds_that_last("dead_detector", onlooker.scene)
    drives = [drive(onlooker, dead, 10.0, 1.0, np.random.default_rng(seed)) for seed in range(5)]
    assert all(not each.tracks.posed.any() for each in drives)
    dark = np.array(onlooker.images).reshape(5, 10, -1) <= 2
    places = [set(np.flatnonzero(each.all(axis=0))) for each in dark]
    assert all(places)
    assert len(set().union(*places)) > 1


def test_kinds_whose_poses_are_elsewhere_are_left_out():
    names = {kind.name for kind in kinds_that_last(None, load_scene("follow"))}
    assert {"moffat", "hidden_row_0.5", "nothing"} < names
    assert not {"near_2m", "aside_1.5m"} & names


def planted(errors):
    spread = np.where(np.isnan(errors[:, :1, None]), np.nan, np.eye(5))
    return FrameErrors(errors, spread, np.empty(0), np.empty(0))


def test_figures_are_those_of_planted_errors():
    single, track = np.zeros((10, 5)), np.ones((10, 5))
    single[:2] = np.nan
    single[2] = 7
    track[:3, 0] = 8
    track[9] = np.nan
    said = np.arange(10) == 1
    (kind,) = kinds_that_last("nothing", load_scene("follow"))
    found = figures(kind, [Drive(planted(single), planted(track), said)] * 2)
    assert (found["frames"], found["single_answered"], found["single_false"]) == (20, 16, 2)
    assert (found["track_answered"], found["track_false"], found["track_unsaid"]) == (18, 6, 4)
    assert found["track_rms_m"] == pytest.approx(np.sqrt((3 * 66 + 6 * 3) / 9))
    assert found["track_nees"] == pytest.approx((3 * 68 + 6 * 5) / 9)


def test_the_command_prints_the_same_figures_as_text_and_as_json(compiled_fit):
    words = ("--kinds", "nothing,two_dirty", "--drives", "2", "--seconds", "10", "--rate", "1")
    found = json_of(run, *words)
    assert found["complete"]
    assert [row["frames"] for row in found["kinds"]] == [20, 20]
    assert report(found["kinds"]) in text_of(run, *words)
