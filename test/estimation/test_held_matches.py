"""A match held to its image: its covariance by its law, from a whole fit and the match alone."""

import math

import numpy as np
import pytest

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel


@pytest.mark.usefixtures("compiled_fit")
def test_a_match_is_as_unsure_as_it_is_off_and_as_probable_as_the_fit(scene, table):
    rng, model = np.random.default_rng(4), ForwardModel(scene)
    poses = rng.uniform([-7.5, -0.4, -0.4, -0.2, -0.2], [-4.5, 0.4, 0.4, 0.2, 0.2], (8, 5))
    # Two neighbours know little of how far off they are.
    sam = Estimator(table, "sam", math.pi, neighbours=2)
    whole, excesses = Estimator(table), []
    for image in model.expose(poses, rng):
        parameters = key_parameters(image, scene.full_scale_counts, scene.signature.peak)
        held, alone = sam.estimate(image), sam.estimate(None, parameters)
        fit = whole.estimate(image)
        off = alone.pose - fit.pose
        excesses.append(off @ np.linalg.inv(alone.covariance + fit.covariance) @ off / 5)
        expected = max(1.0, excesses[-1]) * alone.covariance + fit.covariance
        # The whole fit integrates the posterior, which is not quite Gaussian.
        slack = 0.05 * np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
        assert (abs(held.covariance - expected) < slack).all()
        np.testing.assert_array_equal(held.pose, alone.pose)
        assert held.misfit == pytest.approx(fit.misfit, rel=1e-4)
    assert min(excesses) < 1
    assert max(excesses) > 5
