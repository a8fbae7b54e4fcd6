"""A frame has the same estimate from the fit as it stands and as it is compiled."""

from contextlib import suppress

import numpy as np
import pytest

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.frame import estimate_frame
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

FRAMES = 12


@pytest.mark.skipif(not compilation.installed(), reason="Numba is not installed")
@pytest.mark.parametrize("roll", [0.0, 0.3], ids=["level", "rolled"])
def test_compiled_a_frame_has_the_estimate_that_it_has_in_numpy(table, roll):
    plain, fast = (Estimator(table, "least_squares", compiled=way) for way in (False, True))
    rng = np.random.default_rng(3)
    half = np.array([2, 0.8, 0.8, 0.4, 0.4])
    poses = [-6.0, 0, 0, 0, 0] + half * rng.uniform(-1, 1, (FRAMES, 5))
    for image in ForwardModel(table.scene).expose(poses, rng, roll):
        found, expected = (each.estimate(image, roll=roll) for each in (fast, plain))
        std = np.sqrt(expected.covariance.diagonal())
        np.testing.assert_allclose(found.pose / std, expected.pose / std, rtol=0, atol=1e-5)
        scale = np.outer(std, std)
        np.testing.assert_allclose(
            found.covariance / scale, expected.covariance / scale, rtol=0, atol=1e-7
        )
        assert found.misfit == pytest.approx(expected.misfit, rel=1e-7)
        assert found.angle_rad == pytest.approx(expected.angle_rad, abs=1e-9)


@pytest.mark.skipif(not compilation.installed(), reason="Numba is not installed")
def test_no_image_makes_the_fit_compile_once_more(compiled_fit):
    # In a node that would take half a minute in the midst of a drive.
    scene = load_scene("follow")
    model, rng = ForwardModel(scene), np.random.default_rng(4)
    estimator = Estimator(scene, compiled=True)
    fit = compilation.loaded(estimate_frame)
    before = len(fit.signatures)
    poses = [-6.0, 0, 0, 0, 0] + np.array([1.5, 0.5, 0.5, 0.3, 0.3]) * rng.uniform(-1, 1, (12, 5))
    light, slope = model.light(poses), np.linspace(0, 40, 5)
    spoilt = light.copy()
    spoilt[:, 2, 3] = 0.0
    ways = []
    for image in model.read(
        np.concatenate([light + slope, light * (1 - slope / 200), spoilt]), rng
    ):
        with suppress(NoPose):
            found = estimator.estimate(image)
            ways.append((found.clear < 1, bool(found.left_out)))
    assert np.any(ways, axis=0).all(), "of uneven light, and with a detector left out"
    assert len(fit.signatures) == before
