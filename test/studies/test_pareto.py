"""Pareto fronts against their definition."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uuv_optical_array.studies.shared.pareto import pareto_front

NUMBER = st.sampled_from([0.0, 1.0, 2.0, 3.0, math.nan, math.inf, -math.inf])


def beaten(point, by):
    """The definition: no worse in anything and better in something."""
    return all(b <= a for a, b in zip(point, by, strict=True)) and any(
        b < a for a, b in zip(point, by, strict=True)
    )


@given(st.integers(1, 3).flatmap(lambda k: st.lists(st.tuples(*[NUMBER] * k), max_size=12)))
def test_front_is_what_its_definition_says(points):
    costs = np.reshape(points, (len(points), len(points[0]) if points else 2))
    real = [all(map(math.isfinite, point)) for point in points]
    wanted = [
        mine and not any(other and beaten(a, b) for b, other in zip(points, real, strict=True))
        for a, mine in zip(points, real, strict=True)
    ]
    assert pareto_front(costs).tolist() == wanted


@given(st.lists(st.tuples(st.floats(1, 9), st.floats(1, 9)), min_size=1, max_size=20))
def test_front_of_real_numbers(points):
    wanted = [not any(beaten(a, b) for b in points) for a in points]
    assert pareto_front(points).tolist() == wanted
