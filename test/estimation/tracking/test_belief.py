"""Pose and rate given the biases: against the dense formulas of a Kalman filter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import (
    Biases,
    BiasSpace,
    Motion,
    Observation,
    correct,
    triangular,
    weigh,
)
from uuv_optical_array.estimation.unknowns.constants import Constants

pytestmark = pytest.mark.filterwarnings("error")


def problem(seed, count):
    """Return pose and rate, so many biases and an observation, with unlike scales."""
    rng = np.random.default_rng(seed)
    scales, by_scale = 10.0 ** rng.uniform(-2, 2, 10), 10.0 ** rng.uniform(-1, 1, count)
    root = triangular(scales[:, None] * rng.standard_normal((10, 13)))
    slopes = scales[:, None] * rng.standard_normal((10, count)) * by_scale
    factor = rng.standard_normal((count, count + 2)) / by_scale[:, None]
    motion = Motion(scales * rng.standard_normal(10), root, slopes)
    by_pose = rng.standard_normal((5, 5)) / scales[:5]
    by_biases = rng.standard_normal((5, count)) * by_scale
    observation = Observation(rng.standard_normal(5), by_pose, by_biases)
    return motion, Biases(rng.standard_normal(count), factor @ factor.T), observation


PROBLEMS = st.builds(problem, st.integers(0, 2**32 - 1), st.integers(0, 6))


def dense(motion, biases, observation):
    """Return covariances of motion and biases together, of them with the numbers, and of these."""
    root, by = motion.root, motion.slopes
    of_biases = biases.covariance
    both = np.block(
        [[root @ root.T + by @ of_biases @ by.T, by @ of_biases], [of_biases @ by.T, of_biases]]
    )
    slopes = np.hstack([observation.by_pose, np.zeros((5, 5)), observation.by_biases])
    return both, both @ slopes.T, slopes @ both @ slopes.T + np.eye(5)


@given(PROBLEMS)
@settings(max_examples=60)
def test_given_the_biases_a_correction_is_a_kalman_filter_s(given_problem):
    motion, biases, observation = given_problem
    after, stds = correct(motion, observation), np.linalg.norm(motion.root, axis=1)
    covariance, slopes = (
        motion.root @ motion.root.T,
        np.hstack([observation.by_pose, np.zeros((5, 5))]),
    )
    gain = np.linalg.solve(slopes @ covariance @ slopes.T + np.eye(5), slopes @ covariance).T
    left = np.eye(10) - gain @ slopes
    # Were the biases others, mean and innovation would be others, and so would the mean after.
    for more in (np.zeros(len(biases.mean)), *np.eye(len(biases.mean))):
        before = motion.mean + motion.slopes @ more
        innovation = observation.innovation - observation.by_biases @ more
        innovation -= slopes @ motion.slopes @ more
        expected = before + gain @ innovation
        off = (after.mean + after.slopes @ more - expected) / stds
        np.testing.assert_allclose(off, 0.0, atol=1e-8 * (1 + np.abs(expected / stds).max()))
    apart = after.root @ after.root.T - left @ covariance @ left.T - gain @ gain.T
    np.testing.assert_allclose(apart / np.outer(stds, stds), 0.0, atol=1e-9)
    np.testing.assert_array_equal(after.root, np.triu(after.root))


@given(PROBLEMS)
@settings(max_examples=60)
def test_considered_biases_lower_the_gain_as_schmidt_has_it_and_innovations_have_their_density(
    given_problem,
):
    motion, biases, observation = given_problem
    both, with_numbers, spread = dense(motion, biases, observation)
    gain = np.linalg.solve(spread, with_numbers[:10].T).T
    after, innovation = correct(motion, observation, biases.covariance), observation.innovation
    stds = np.sqrt(both.diagonal()[:10])
    mean = motion.mean + gain @ innovation
    scale = 1 + np.abs(mean / stds).max()
    np.testing.assert_allclose((after.mean - mean) / stds, 0.0, atol=1e-8 * scale)
    best = both[:10, :10] - gain @ with_numbers[:10].T
    apart = (after.covariance(biases) - best) / np.outer(stds, stds)
    np.testing.assert_allclose(apart, 0.0, atol=1e-8)
    distance, cost = weigh(motion, biases, observation)
    squared = innovation @ np.linalg.solve(spread, innovation)
    assert distance == pytest.approx(np.sqrt(squared), rel=1e-6)
    density = multivariate_normal(cov=spread, allow_singular=True).logpdf(innovation)
    assert cost == pytest.approx(-2 * density - 5 * np.log(2 * np.pi), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (4, 9), (5, 2), (6, 6)])
def test_a_triangular_root_is_of_the_same_covariance(shape):
    root = np.random.default_rng(0).standard_normal(shape)
    found = triangular(root)
    np.testing.assert_allclose(found @ found.T, root @ root.T, atol=1e-12)
    np.testing.assert_array_equal(found, np.triu(found))


def test_a_pose_is_as_uncertain_when_shades_become_others_but_less_by_those_to_come():
    space = BiasSpace(Constants(("lamp.power",), (0.1,), unclear_lasts_s=3.0), 1e9)
    motion, biases, _ = problem(2, 6)
    after = space.shades_drifted(motion, 1.5)
    prior = biases._replace(covariance=np.eye(6))
    np.testing.assert_allclose(after.covariance(prior), motion.covariance(prior), rtol=1e-9)
    np.testing.assert_array_equal(after.slopes[:, 0], motion.slopes[:, 0])
    np.testing.assert_allclose(after.slopes[:, 1:], np.exp(-0.5) * motion.slopes[:, 1:])


@given(st.integers(0, 2**32 - 1), st.sampled_from([(3, 2), (5, 1)]), st.booleans())
def test_what_a_shade_leaves_of_it_is_noise_of_clear_frames_where_the_scene_names_shades(
    seed, sizes, names_shades
):
    """The rest is 2 % of the light, RMS, by each smooth pattern of up to second order."""
    rng, (side, lamps) = np.random.default_rng(seed), sizes
    count = side**2 * lamps
    lasts_s = 5.0 if names_shades else 0.0
    constants = Constants(("a", "b"), (0.1, 0.2), 0.05, side**2, None, lasts_s, lamps=lamps)
    light, variances = rng.uniform(5, 300, (4, count)), rng.uniform(0.5, 9.0, (4, count))
    variances[:, rng.integers(count)] = np.inf
    slopes = rng.standard_normal((4, count, 7))
    readings = LinearisedReadings(
        np.zeros((4, 7)), rng.standard_normal((4, count)), slopes, light, variances
    )
    found = BiasSpace(constants, 60.0).whitened(readings, slopes)
    found = np.concatenate([found[0][..., None], *found[1:]], axis=2)
    u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-1, 1, side)] * 2, indexing="ij"))
    smooth, _ = np.linalg.qr(np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1))
    modes = np.tile(0.02 * side * smooth[:, 1:] * names_shades, (lamps, 1))
    for k in range(4):
        lit = np.isfinite(variances[k])
        by_gains = 0.05 * np.tile(np.eye(side**2), (lamps, 1)) * light[k][:, None]
        parts = readings.residuals[k][:, None], slopes[k], by_gains
        rows = np.hstack(parts)[lit] * [1, *[1] * 5, 0.1, 0.2, *[1] * side**2]
        shades = (light[k][:, None] * modes)[lit]
        noise = np.diag(variances[k][lit]) + shades @ shades.T
        expected = rows.T @ np.linalg.solve(noise, rows)
        np.testing.assert_allclose(found[k].T @ found[k], expected, rtol=1e-7, atol=1e-7)
