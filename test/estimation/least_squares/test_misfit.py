"""The distribution of residuals: its moments by quadrature, its tail by SciPy and by chance."""

import numpy as np
import pytest
from scenes import changed
from scipy.stats import chi2, norm

from uuv_optical_array.estimation.least_squares.misfit import (
    chi_square_score,
    cut_moments,
    residual_moments,
)
from uuv_optical_array.estimation.least_squares.problem import (
    MOST_STEPS,
    misfit,
    problem_of,
    refine,
)
from uuv_optical_array.estimation.unknowns.coordinates import from_pose
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

POSE = np.array([-5.0, 0.3, -0.2, 0.1, 0.05])
PRIOR_STD = np.array([6.0, 1.8, 1.8, 1.0, 1.0])
NUISANCES = {"lamp.power": 0.1, "ambient.level_counts": 5.0}


def test_a_limit_leaves_the_moments_that_quadrature_finds():
    """By Gauss and Legendre's rule on both sides of where the limit cuts in."""
    insides = np.concatenate([np.linspace(-8, 8, 161), [12.0, 40.0]])
    nodes, weights = np.polynomial.legendre.leggauss(100)
    moments = np.array([cut_moments(inside) for inside in insides])
    for inside, found in zip(insides, moments, strict=True):
        cut, expected = np.clip(-inside, -12, 12), np.zeros(2)
        for low, high in ((-12, cut), (cut, 12)):
            z = (low + high) / 2 + (high - low) / 2 * nodes
            left = np.maximum(z, -inside) if inside >= 0 else np.maximum(z + inside, 0.0)
            density = (high - low) / 2 * weights * norm.pdf(z)
            expected += left**2 @ density, left**4 @ density
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("readings", [9, 25, 441])
def test_the_score_is_that_of_a_chi_square_without_what_was_fitted(readings):
    for chance in (0.5, 1e-2, 1e-5):
        limit = chi2.isf(chance, readings - 5)
        score = chi_square_score(limit, float(readings), 2.0 * readings)
        # Wilson and Hilferty's cube root is that good.
        assert float(score) == pytest.approx(norm.isf(chance), abs=0.2)


@pytest.mark.parametrize("light", [0.0, 0.7, 300.0, 1022.0, 1025.0])
def test_a_residual_has_the_moments_of_readings_that_are_drawn(light):
    model = ForwardModel(load_scene("reference"))
    rng = np.random.default_rng(3)
    readings = np.clip(light + rng.standard_normal(400_000), 0, 1023)
    squares = (readings - np.clip(light, 0, 1023)) ** 2
    noise = model.noise._replace(variance=1.0)
    mean, variance = residual_moments(light, 1.0, noise)
    assert float(mean) == pytest.approx(squares.mean(), abs=5 * squares.std() / 632)
    assert float(variance) == pytest.approx(squares.var(), rel=0.05, abs=1e-3)


def scores(gain_std, gain_off, count=200, power_off=0.0):
    """Misfits of images whose gains are off by some share, as far as the prior says or not."""
    model = ForwardModel(changed("reference", prior={"gain_std": gain_std}))
    problem = problem_of(model, POSE, PRIOR_STD, NUISANCES)
    start = np.concatenate([from_pose(problem.frame, POSE, 0.0), np.zeros(2)])
    rng = np.random.default_rng(7)
    found = []
    for _ in range(count):
        offsets = {name: np.array(std * rng.standard_normal()) for name, std in NUISANCES.items()}
        offsets["lamp.power"] = offsets["lamp.power"] + power_off
        light = model.light(POSE, 0.0, offsets)
        light = light * (1 + gain_off * rng.standard_normal(light.shape))
        of_image = problem._replace(readings=model.read(light, rng).ravel())
        found.append(misfit(of_image, refine(of_image, start, MOST_STEPS).at))
    return found


def test_honest_images_leave_scores_of_a_standard_normal():
    found = scores(0.005, 0.005)
    assert abs(np.mean(found)) < 5 / np.sqrt(len(found))
    assert np.std(found) == pytest.approx(1.0, abs=0.15)


def test_an_unknown_far_outside_its_prior_counts_as_a_residual():
    near, far = (np.mean(scores(0.0, 0.0, 60, off)) for off in (0.0, 0.5))
    assert far > near + 1


def test_a_reading_that_is_not_believed_has_no_part_in_the_score():
    """A score without a reading is that of the others alone, by a sum that is written out."""
    model = ForwardModel(load_scene("reference"))
    problem, rng = problem_of(model, POSE, PRIOR_STD, {}), np.random.default_rng(2)
    at, weights = from_pose(problem.frame, POSE, 0.0), np.ones(25)
    readings = model.expose(POSE, rng).ravel()
    weights[:3] = 0.0, 0.5, 0.0
    spoilt = readings.copy()
    spoilt[[0, 2]] += 500
    found = misfit(problem._replace(readings=spoilt, weights=weights), at)
    squares = (readings - model.light(POSE).ravel()) ** 2 / (1 + 1 / 12)
    left = weights.sum() - 5
    wanted = norm.isf(chi2.sf((weights * squares).sum(), left))
    # Wilson and Hilferty's cube root is that good.
    assert float(found) == pytest.approx(wanted, abs=0.1)
