"""Corrections on roots of covariances: against the dense formulas of a Kalman filter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from uuv_optical_array.estimation.tracking.root_filter import (
    Gaussian,
    Observation,
    correct,
    triangular,
    weigh,
)

pytestmark = pytest.mark.filterwarnings("error")


def problem(seed, size, count, considered):
    """Return a state and an observation of it, with unlike scales."""
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-2, 2, size)
    root = triangular(scales[:, None] * rng.standard_normal((size, size + 3)))
    shared = scales[:, None] * rng.standard_normal((size, count if considered else 0))
    slopes = rng.standard_normal((count, size)) / scales
    noise = rng.uniform(0.1, 2.0, count)
    by_shared = rng.uniform(0.0, 2.0, count) if considered else np.zeros(0)
    state = Gaussian(rng.standard_normal(size), root, shared)
    return state, Observation(rng.standard_normal(count), slopes, noise, by_shared)


def dense(state, observation):
    """Return covariances of the state, of it with the observation, and of that."""
    covariance = state.root @ state.root.T + state.consider @ state.consider.T
    both = covariance @ observation.slopes.T
    spread = observation.slopes @ both + np.diag(observation.noise**2)
    if len(observation.consider):
        by_shared = state.consider * observation.consider
        spread += observation.slopes @ by_shared + (observation.slopes @ by_shared).T
        spread += np.diag(observation.consider**2)
        both = both + by_shared
    return covariance, both, spread


PROBLEMS = st.builds(
    problem,
    st.integers(0, 2**32 - 1),
    st.integers(6, 12),
    st.sampled_from([1, 5, 9, 40]),
    st.booleans(),
)


@given(PROBLEMS, st.sampled_from([5, 6]))
@settings(max_examples=60)
def test_a_correction_is_that_of_the_dense_formulas(given_problem, corrected):
    state, observation = given_problem
    covariance, both, spread = dense(state, observation)
    best = np.linalg.solve(spread, both.T).T[:corrected]
    stds = np.sqrt(covariance.diagonal())
    gain_of, distance, cost = weigh(state, observation, corrected)
    gain = gain_of()
    np.testing.assert_allclose(
        gain / stds[:corrected, None], best / stds[:corrected, None], atol=1e-9
    )
    # Of the information about a jump: its estimate, squared by its covariance.
    whole = np.linalg.solve(
        spread, np.column_stack([observation.innovation, observation.slopes[:, :5]])
    )
    about = observation.slopes[:, :5].T @ whole
    jump = about[:, 0] @ np.linalg.pinv(about[:, 1:], rcond=1e-12) @ about[:, 0]
    if len(observation.innovation) >= 5:
        assert distance == pytest.approx(np.sqrt(jump), rel=1e-6)
    else:  # as many directions as numbers: all of them count
        all_of_it = observation.innovation @ np.linalg.solve(spread, observation.innovation)
        assert distance == pytest.approx(np.sqrt(all_of_it), rel=1e-6)
    wider = state._replace(root=np.concatenate([state.root, state.root[:, :1]], axis=1))
    less = multivariate_normal(cov=spread).logpdf(observation.innovation)
    less -= multivariate_normal(cov=dense(wider, observation)[2]).logpdf(observation.innovation)
    more = weigh(wider, observation, corrected)[2] - cost
    assert more == pytest.approx(2 * less, rel=1e-6, abs=1e-6)
    after = correct(state, observation, gain)
    padded = np.zeros((len(stds), len(observation.innovation)))
    padded[:corrected] = gain
    np.testing.assert_allclose(after.mean, state.mean + padded @ observation.innovation, rtol=1e-12)
    expected = covariance - padded @ both.T - both @ padded.T + padded @ spread @ padded.T
    apart = (after.covariance - expected) / np.outer(stds, stds)
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)
    # Consider parameters stay: by their part of the error.
    left = state.consider - padded @ observation.slopes @ state.consider
    left = left - padded * observation.consider if len(observation.consider) else left
    np.testing.assert_allclose((after.consider - left) / stds[:, None], 0.0, atol=1e-9)
    np.testing.assert_array_equal(after.root, np.triu(after.root))


@pytest.mark.parametrize("shape", [(1, 1), (4, 9), (5, 2), (6, 6)])
def test_a_triangular_root_is_of_the_same_covariance(shape):
    root = np.random.default_rng(0).standard_normal(shape)
    found = triangular(root)
    np.testing.assert_allclose(found @ found.T, root @ root.T, atol=1e-12)
    np.testing.assert_array_equal(found, np.triu(found))
