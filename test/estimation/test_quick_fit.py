"""The quick fit that answers until the whole one is compiled: nearer than a match, never surer."""

import math

import numpy as np
import pytest

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.table.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel

FRAMES = 40
CHI2_5_ONE_OF_A_MILLION = 35.9  # which chi-square of five degrees of freedom exceeds so often


@pytest.mark.parametrize("shape", ["curved", "planar"])
def test_it_is_nearer_than_the_mean_of_the_matches_and_knows_how_near(scene, table, shape):
    if shape == "planar":
        table = build_table(scene.with_shape("planar"))
    rng = np.random.default_rng(12)
    poses = rng.uniform([-7, -0.4, -0.4, -0.25, -0.25], [-5, 0.4, 0.4, 0.25, 0.25], (FRAMES, 5))
    images = ForwardModel(table.scene).expose(poses, rng)
    errors = {}
    for method, quick in (("sam_interpolated", False), ("least_squares", True)):
        estimator = Estimator(table, method, math.pi, compiled=False, quick=quick)
        found = [estimator.estimate(image) for image in images]
        off = np.array([each.pose for each in found]) - poses
        errors[method] = np.linalg.norm(off[:, :3], axis=1)
        squares = [o @ np.linalg.solve(f.covariance, o) for o, f in zip(off, found, strict=True)]
        assert np.mean(squares) < 8
        assert np.max(squares) < CHI2_5_ONE_OF_A_MILLION
    match, fit = (np.sqrt(np.mean(each**2)) for each in errors.values())
    assert fit < 0.6 * match, (fit, match)
