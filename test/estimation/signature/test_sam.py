"""The spectral angle against closed forms, and the nearest rows against an exact brute force."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uuv_optical_array.estimation.signature.spectral_angle import (
    SpectralIndex,
    spectral_angle,
)

pytestmark = [pytest.mark.filterwarnings("error"), pytest.mark.usefixtures("strict_but_for_zeros")]
BAD = (math.nan, math.inf, -math.inf)


def exact_angle(u, v):
    """Angle between vectors of exact numbers: one rounding each in two roots and one atan2."""
    dot = sum(a * b for a, b in zip(u, v, strict=True))
    cross_squared = sum(a * a for a in u) * sum(b * b for b in v) - dot * dot
    return math.atan2(math.sqrt(cross_squared), dot)


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-6, 1.0])
def test_an_angle_is_right_to_twelve_digits_near_zero_and_near_pi(angle):
    cos, sin = math.cos(angle), math.sin(angle)
    u, v = np.array([5.0, 0.0, 0.0]), np.array([3 * cos, 0.0, 3 * sin])
    assert spectral_angle(u, v) == pytest.approx(angle, rel=1e-12, abs=0)
    assert spectral_angle(u, -v) == pytest.approx(math.pi - angle, rel=1e-15, abs=0)


@given(st.lists(st.integers(-9, 9), min_size=4, max_size=4).filter(any), st.data())
def test_the_angle_is_symmetric_and_does_not_see_the_scale(u, data):
    v = data.draw(st.lists(st.integers(-9, 9), min_size=4, max_size=4).filter(any))
    scale = st.sampled_from([5e-324, 1e-300, 1e-160, 1e-7, 1.0, 1e7, 1e160, 1e300])
    a, b = data.draw(scale), data.draw(scale)
    angle = spectral_angle(np.array(u) * a, np.array(v) * b)
    assert angle == pytest.approx(exact_angle(u, v), abs=2e-15)
    assert angle == spectral_angle(np.array(v) * b, np.array(u) * a)


def test_angles_broadcast_as_their_vectors_do():
    u, v = np.random.default_rng(2).integers(-9, 9, (2, 4, 1, 3)) * 2 + 1
    angles = spectral_angle(u, v.reshape(1, 4, 3))
    assert angles.shape == (4, 4)
    for i, j in np.ndindex(4, 4):
        expected = exact_angle(u[i, 0].tolist(), v[j, 0].tolist())
        assert angles[i, j] == pytest.approx(expected, abs=2e-15)


@pytest.mark.parametrize(
    ("bad", "why"),
    [([0.0, 0.0, 0.0], "zero"), *(([1.0, bad, 0.0], "not finite") for bad in BAD)],
)
def test_a_vector_without_a_direction_is_refused_everywhere(bad, why):
    good = [1.0, 2.0, 3.0]
    for call in (
        lambda: spectral_angle(bad, good),
        lambda: spectral_angle([good, good], [good, bad]),
        lambda: SpectralIndex([good, bad, good]),
        lambda: SpectralIndex([good, good]).nearest(bad),
    ):
        with pytest.raises(ValueError, match=why):
            call()


@pytest.mark.parametrize("shape", [(0, 5), (5,), (2, 3, 4)])
def test_a_table_without_rows_is_refused(shape):
    with pytest.raises(ValueError, match="rows have shape"):
        SpectralIndex(np.ones(shape))


def table_and_query(rng):
    """Return whole rows of which some are equal, and a query that may be one of them."""
    dimension, reach = rng.integers(2, 7), rng.choice([1, 3, 50])
    vectors = rng.integers(-reach, reach + 1, (60, dimension))
    vectors = vectors[vectors.any(axis=1)]
    distinct = rng.integers(1, min(len(vectors), 31))
    rows = np.concatenate(
        [vectors[:distinct], vectors[rng.integers(distinct, size=rng.integers(21))]]
    )
    query = rows[0] if rng.random() < 0.5 else vectors[-1]
    return rng.permutation(rows), query


@pytest.mark.parametrize("seed", range(10))
def test_the_nearest_rows_are_those_of_an_exact_brute_force(seed):
    rng = np.random.default_rng(seed)
    for _ in range(30):
        rows, query = table_and_query(rng)
        k = rng.integers(1, 61)
        angles, found = SpectralIndex(rows.astype(float)).nearest(query, k)
        exact = np.array([exact_angle(row, query.tolist()) for row in rows.tolist()])
        size = min(k, len(rows))
        assert angles.shape == found.shape == (size,)
        assert len(set(found.tolist())) == size
        np.testing.assert_allclose(angles, np.sort(exact)[:size], atol=2e-15)
        np.testing.assert_allclose(angles, exact[found], atol=2e-15)
        assert (np.diff(angles) >= 0).all()
        # Equal rows tie exactly: the lower row numbers come, and come first.
        for row in np.unique(rows, axis=0):
            (equal,) = np.nonzero((rows == row).all(axis=1))
            chosen = found[np.isin(found, equal)]
            np.testing.assert_array_equal(chosen, equal[: len(chosen)])


def test_rows_a_billionth_of_a_radian_apart_are_told_apart():
    # By arccos (eq. 13 of the paper) many more than the nearest five lie at no angle at all.
    steps = np.random.default_rng(1).permutation(200)
    rows = np.stack([np.cos(steps * 1e-9), np.sin(steps * 1e-9)], axis=-1)
    query = np.array([math.cos(37.3e-9), math.sin(37.3e-9)])
    angles, found = SpectralIndex(rows).nearest(query, 5)
    np.testing.assert_array_equal(steps[found], [37, 38, 36, 39, 35])
    np.testing.assert_allclose(angles, np.array([0.3, 0.7, 1.3, 1.7, 2.3]) * 1e-9, rtol=1e-6)


def fractions(vectors):
    return [[Fraction(float(x)) for x in vector] for vector in vectors]


def exact_order(rows, query):
    """Rows by the exact angle and then by number: cos^2 with its sign, in whole fractions."""
    dots = [sum(a * b for a, b in zip(row, query, strict=True)) for row in rows]
    near = [dot * abs(dot) / sum(a * a for a in row) for dot, row in zip(dots, rows, strict=True)]
    return sorted(range(len(rows)), key=lambda i: (-near[i], i))


@pytest.mark.parametrize("number", [np.float64, np.float32])
@pytest.mark.parametrize("k", [1, 4, 99])
def test_rows_come_in_the_order_of_exact_fractions_with_their_angles(k, number):
    rng = np.random.default_rng(k)
    rows = rng.standard_normal((60, 6)).astype(number)
    rows[40:] = rows[rng.integers(0, 40, 20)]  # some thrice, so that a tie outgrows a small k
    rows[50:55] = rows[0]
    turned = rows[:5] + 1e-9 * rng.standard_normal((5, 6))
    queries = np.concatenate([rows[[0, 45, 59]], turned, -rows[:2], rng.standard_normal((9, 6))])
    index, least, exact = SpectralIndex(rows), [], fractions(rows)
    for query, whole in zip(queries, fractions(queries), strict=True):
        angles, found = index.nearest(query, k)
        assert found.tolist() == exact_order(exact, whole)[:k]
        assert angles.dtype == np.float64
        expected = [exact_angle(exact[row], whole) for row in found]
        np.testing.assert_allclose(angles, expected, rtol=0, atol=2e-15)
        least.append(angles[0])
    assert least[:3] == [0, 0, 0], "a query that is a row is at no angle from it"
    assert 1e-11 < min(least[3:8]) < max(least[3:8]) < 1e-8


@pytest.mark.parametrize("length", [2, 6, 7, 8, 25, 441])
def test_a_single_vector_is_scaled_as_one_of_many_to_the_last_bit(length):
    rng = np.random.default_rng(length)
    rows = rng.standard_normal((300, length))
    small = np.where(np.arange(300)[:, None] % 7 == 0, rng.integers(-150, 1, (300, length)), 0)
    for table in (rows, rows * 10.0 ** (rng.integers(-140, 140, (300, 1)) + small)):
        assert [SpectralIndex(table).nearest(row)[0][0] for row in table[::10]] == [0.0] * 30


@pytest.mark.parametrize("shape", [(), (2,), (4,), (5, 3), (3, 0)])
def test_a_query_of_another_length_is_refused_with_the_right_one(shape):
    with pytest.raises(ValueError, match=r"give \(3,\)"):
        SpectralIndex(np.eye(3)).nearest(np.ones(shape))


def test_a_single_query_almost_opposite_to_every_row_has_an_exact_angle():
    # By the chord alone the nearest of these would be off by some 1e-13 rad.
    rows = [[-math.cos(d), math.sin(d), 0.0] for d in (1e-4, 1e-3, 1e-5)]
    angles, found = SpectralIndex(rows).nearest([2.0, 0.0, 0.0], 2)
    np.testing.assert_array_equal(found, [1, 0])
    np.testing.assert_allclose(angles, math.pi - np.array([1e-3, 1e-4]), rtol=0, atol=1e-15)
