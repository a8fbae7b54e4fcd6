"""What a track's images do not believe is hardly believed by those after, for long."""

import math

import numpy as np
import pytest

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.tracking.doubted_detectors import DoubtedDetectors
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

SECOND_NS = 10**9


def believed(**doubts):
    weights = np.ones(4)
    for place, doubt in doubts.items():
        weights[int(place[1:])] = 1 - doubt
    return weights


def test_a_doubt_fades_within_half_a_minute_and_a_new_one_counts_at_once():
    doubted = DoubtedDetectors()
    np.testing.assert_array_equal(doubted.trust(0, believed()), np.ones(4))
    # It is known by the image itself.
    np.testing.assert_array_equal(doubted.trust(SECOND_NS, believed(_1=0.9)), np.ones(4))
    faded = 0.9 * math.exp(-0.1)
    one = [1, (1 - faded) ** 2, 1, 1]
    np.testing.assert_allclose(doubted.trust(4 * SECOND_NS, believed(_2=0.5)), one)
    both = [1, (1 - faded * math.exp(-0.2)) ** 2, (1 - 0.5 * math.exp(-0.2)) ** 2, 1]
    np.testing.assert_allclose(doubted.trust(10 * SECOND_NS, believed()), both)
    np.testing.assert_allclose(doubted.trust(1000 * SECOND_NS, believed()), np.ones(4))


@pytest.mark.parametrize(("dirty", "runs", "most"), [(True, 1, 75), (False, 2, 6)])
def test_a_track_is_not_misled_by_dirt_that_some_images_do_not_tell(
    dirty, runs, most, compiled_fit
):
    """From afar one image of four tells one of two dirty detectors; else NEES is 150 in each run.

    The track of a run with dirt has a NEES of 40 at most.
    """
    estimator = Estimator(load_scene("follow")).wait()
    model, nees = ForwardModel(estimator.scene), []
    times = np.arange(100)
    level = np.full((100, 3), [0.0, 0.02, -0.02])
    poses = np.column_stack([-7.5 + 0.02 * times, 0.1 * np.sin(0.05 * times), level])
    lights = model.light(poses)
    if dirty:
        lights[:, [0, 4], [4, 1]] *= 0.8
    for seed in range(1, runs + 1):
        pipeline, rng = Pipeline(estimator), np.random.default_rng(seed)
        for i, (pose, light) in enumerate(zip(poses, lights, strict=True)):
            track = pipeline.answer(i * SECOND_NS // 5, model.read(light, rng)).track
            if track is not None and i > 50:
                off = track.pose - pose
                nees.append(off @ np.linalg.solve(track.covariance, off))
    assert len(nees) > 40 * runs
    assert np.mean(nees) < most
