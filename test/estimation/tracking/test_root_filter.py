"""Corrections on roots of covariances: against the dense formulas of a Kalman filter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uuv_optical_array.estimation.tracking.filter.root_filter import (
    Belief,
    Reading,
    correct,
    triangular,
    weigh,
)

pytestmark = pytest.mark.filterwarnings("error")


def problem(seed, size, count, spoilt):
    """Return a belief and readings of it, with unlike scales."""
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-2, 2, size)
    root = triangular(scales[:, None] * rng.standard_normal((size, size + 3)))
    shared = scales[:, None] * rng.standard_normal((size, count if spoilt else 0))
    slopes = rng.standard_normal((count, size)) / scales
    noise = rng.uniform(0.1, 2.0, count)
    by_shared = rng.uniform(0.0, 2.0, count) if spoilt else np.zeros(0)
    belief = Belief(rng.standard_normal(size), root, shared)
    return belief, Reading(rng.standard_normal(count), slopes, noise, by_shared)


def dense(belief, reading):
    """Return covariances of the state, of it with the readings, and of these."""
    covariance = belief.root @ belief.root.T + belief.shared @ belief.shared.T
    both = covariance @ reading.slopes.T
    spread = reading.slopes @ both + np.diag(reading.noise**2)
    if len(reading.spoilt):
        by_shared = belief.shared * reading.spoilt
        spread += reading.slopes @ by_shared + (reading.slopes @ by_shared).T
        spread += np.diag(reading.spoilt**2)
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
def test_a_correction_is_that_of_the_dense_formulas(given_problem, learnt):
    belief, reading = given_problem
    covariance, both, spread = dense(belief, reading)
    best = np.linalg.solve(spread, both.T).T[:learnt]
    stds = np.sqrt(covariance.diagonal())
    gain_of, distance = weigh(belief, reading, learnt)
    gain = gain_of()
    np.testing.assert_allclose(gain / stds[:learnt, None], best / stds[:learnt, None], atol=1e-9)
    # Of the readings' information about a jump: its estimate, squared by its covariance.
    whole = np.linalg.solve(spread, np.column_stack([reading.residual, reading.slopes[:, :5]]))
    about = reading.slopes[:, :5].T @ whole
    jump = about[:, 0] @ np.linalg.pinv(about[:, 1:], rcond=1e-12) @ about[:, 0]
    if len(reading.residual) >= 5:
        assert distance == pytest.approx(np.sqrt(jump), rel=1e-6)
    else:  # as many directions as readings: all of them count
        all_of_it = reading.residual @ np.linalg.solve(spread, reading.residual)
        assert distance == pytest.approx(np.sqrt(all_of_it), rel=1e-6)
    after = correct(belief, reading, gain)
    padded = np.zeros((len(stds), len(reading.residual)))
    padded[:learnt] = gain
    np.testing.assert_allclose(after.mean, belief.mean + padded @ reading.residual, rtol=1e-12)
    expected = covariance - padded @ both.T - both @ padded.T + padded @ spread @ padded.T
    apart = (after.covariance - expected) / np.outer(stds, stds)
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)
    # What spoils readings for ever goes on doing so: by its part of the error.
    left = belief.shared - padded @ reading.slopes @ belief.shared
    left = left - padded * reading.spoilt if len(reading.spoilt) else left
    np.testing.assert_allclose((after.shared - left) / stds[:, None], 0.0, atol=1e-9)
    np.testing.assert_array_equal(after.root, np.triu(after.root))


@pytest.mark.parametrize("shape", [(1, 1), (4, 9), (5, 2), (6, 6)])
def test_a_triangular_root_is_of_the_same_covariance(shape):
    root = np.random.default_rng(0).standard_normal(shape)
    found = triangular(root)
    np.testing.assert_allclose(found @ found.T, root @ root.T, atol=1e-12)
    np.testing.assert_array_equal(found, np.triu(found))
