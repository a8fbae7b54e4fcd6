"""A Gaussian belief: against the dense formulas of a Kalman filter, and Schmidt's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from uuv_optical_array.estimation.tracking.belief import (
    Belief,
    BiasSpace,
    Observation,
    correct,
    cost,
    weigh,
)
from uuv_optical_array.estimation.unknowns.constants import Constants

pytestmark = pytest.mark.filterwarnings("error")


def problem(seed, count):
    """Return a belief with so many biases and an observation, with unlike scales."""
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-2, 2, 10 + count)
    root = scales[:, None] * rng.standard_normal((10 + count, 13 + count))
    belief = Belief(scales * rng.standard_normal(10 + count), root @ root.T)
    slopes = rng.standard_normal((5, 10 + count)) / scales
    return belief, Observation(rng.standard_normal(5), slopes)


PROBLEMS = st.builds(problem, st.integers(0, 2**32 - 1), st.integers(0, 6))


@given(PROBLEMS, st.booleans())
@settings(max_examples=60)
def test_a_correction_is_a_kalman_filter_s_and_considers_biases_as_schmidt_has_it(of, teach):
    belief, (innovation, slopes) = of
    gain = (
        belief.covariance
        @ slopes.T
        @ np.linalg.inv(slopes @ belief.covariance @ slopes.T + np.eye(5))
    )
    if not teach:
        gain[10:] = 0.0
    left = np.eye(len(gain)) - gain @ slopes
    covariance = left @ belief.covariance @ left.T + gain @ gain.T
    after, stds = correct(belief, of[1], teach), np.sqrt(belief.covariance.diagonal())
    off = (after.mean - belief.mean - gain @ innovation) / stds
    np.testing.assert_allclose(off, 0.0, atol=1e-8)
    apart = (after.covariance - covariance) / np.outer(stds, stds)
    np.testing.assert_allclose(apart, 0.0, atol=1e-8)


@given(PROBLEMS)
@settings(max_examples=60)
def test_innovations_have_their_density_and_shift_the_mean_as_least_squares(of):
    belief, observation = of
    spread = observation.slopes @ belief.covariance @ observation.slopes.T + np.eye(5)
    distance, shift = weigh(belief.covariance, observation)
    square = observation.innovation @ np.linalg.solve(spread, observation.innovation)
    assert distance**2 == pytest.approx(square, rel=1e-8)
    density = multivariate_normal(np.zeros(5), spread).logpdf(observation.innovation)
    found = cost(belief.covariance, observation)
    assert found == pytest.approx(-2 * density - 5 * np.log(2 * np.pi), abs=1e-6)
    # The least squares of observation and prior, by the prior's root.
    root = np.linalg.cholesky(belief.covariance)
    rows = np.vstack([observation.slopes @ root, np.eye(len(root))])
    best = np.linalg.lstsq(rows, np.append(observation.innovation, np.zeros(len(root))), None)[0]
    np.testing.assert_allclose(
        (shift - root @ best) / np.sqrt(belief.covariance.diagonal()), 0, atol=1e-8
    )


def test_biases_hold_for_their_time_and_return_to_their_prior():
    constants = Constants(("lamp.power",), (0.2,), 0.01, 4)
    space = BiasSpace(constants, 1000.0)
    begun = space.begun(np.zeros(10), np.eye(10))
    known = begun._replace(mean=np.ones(10 + space.size), covariance=0 * begun.covariance)
    after = space.drifted(known, 7.0)
    assert space.size == 1 + 4 + 1  # the constant, gains, and the error of ranges
    kept = np.exp(-7.0 / 1000.0)
    np.testing.assert_allclose(after.mean, [*np.ones(10), *[kept] * 6], rtol=1e-12)
    expected = np.diag([*np.zeros(10), *[1 - kept**2] * 6])
    np.testing.assert_allclose(after.covariance, expected, atol=1e-12)


def test_constants_that_are_forgotten_are_the_prior_s_and_the_rest_is_kept():
    constants = Constants(("lamp.power",), (0.2,), 0.01, 4)
    space, rng = BiasSpace(constants, 1000.0), np.random.default_rng(2)
    root = rng.standard_normal((10 + space.size, 40))
    belief = Belief(rng.standard_normal(len(root)), root @ root.T)
    after = space.forgotten(belief)
    offsets = space.by_offsets @ after.covariance[10:, 10:] @ space.by_offsets.T
    np.testing.assert_allclose(offsets, [[0.04]], rtol=1e-12)
    np.testing.assert_array_equal(space.offsets(after), [0.0])
    kept = [*range(10), *range(11, 15)]
    np.testing.assert_array_equal(after.mean[kept], belief.mean[kept])
    of = np.ix_(kept, kept)
    np.testing.assert_array_equal(after.covariance[of], belief.covariance[of])
    np.testing.assert_array_equal(after.covariance[10, kept], 0.0)
