"""What serves numbers and arrays alike: each helper in NumPy, and the same source compiled."""

import os
from typing import NamedTuple

import numpy as np
import pytest
from command_line import python
from needs import numba
from scipy.special import erfcx, log_ndtr, ndtr

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.elementwise import (
    borrowed,
    cos,
    exp,
    expm1,
    maximum,
    minimum,
    partition,
    sin,
    workspace,
    zeros,
)

both = pytest.mark.parametrize("fast", [False, pytest.param(True, marks=numba)], ids=str)


def as_given(function, fast):
    return compilation.compiled(function) if fast else function


def shapes(component, count):
    return workspace(3, component, count).shape, zeros(2, 4, component).shape


@both
def test_arrays_for_one_pose_have_no_axis_for_poses(fast):
    assert as_given(shapes, fast)(1.5, 7) == ((3, 7), (2, 4))
    assert shapes(np.zeros((5, 1)), 7) == ((3, 5, 7), (2, 4, 5, 1))


def sums_of_arrays(count):
    """Two of each, so that one that is written to cannot be the other."""
    one, other, none = workspace(3, 0.0, count), workspace(3, 0.0, count), zeros(3, 5, 0.0)
    one[:], other[:] = 1.0, 2.0
    return one.sum(), other.sum(), none.sum()


@both
def test_arrays_small_or_large_are_their_own(fast):
    call = as_given(sums_of_arrays, fast)
    for count in (0, 1, 600, 1_000_000, 1, 0):  # the largest is more than a stack
        assert call(count) == (3 * count, 6 * count, 0)


class Pair(NamedTuple):
    numbers: np.ndarray
    nested: tuple
    half: float


def sum_of_borrowed(pair):
    kept = borrowed(pair)
    kept.numbers[0] += 1  # they are the same arrays
    return kept.numbers.sum() + kept.nested[0].sum() + kept.half


@both
def test_borrowed_arrays_are_those_that_were_given(fast):
    pair = Pair(np.arange(3.0), (np.ones((2, 2)),), 0.5)
    assert as_given(sum_of_borrowed, fast)(pair) == 8.5
    assert pair.numbers[0] == 1


FRAMES = """
import numpy as np
from numba.core.runtime import rtsys
from uuv_optical_array import Estimator, ForwardModel, NoPose, load_scene
scene = load_scene("follow")
model, estimator = ForwardModel(scene), Estimator(scene, compiled=True)
rng = np.random.default_rng(1)
images = model.expose(np.tile([-5.0, 0.4, 0.2, 0.05, 0.1], (20, 1)), rng)
images[:, 0, 0] = 0.0  # some get no pose
for _ in range(2):
    for image in images:
        try:
            estimator.estimate(image)
        except NoPose:
            pass
    stats = rtsys.get_allocation_stats()
    print(stats.alloc, stats.alloc - stats.free)
"""


def partitioned(values, n):
    partition(values, n)
    return values


@both
@pytest.mark.parametrize("count", [1, 2, 9, 25])
def test_a_partition_has_each_value_where_sorting_has_it(count, fast):
    call, rng = as_given(partitioned, fast), np.random.default_rng(count)
    for values in (rng.random(count), rng.integers(0, 3, count) * 1.0, np.arange(count, 0.0, -1)):
        for n in range(count):
            found, ordered = call(values.copy(), n), np.sort(values)
            assert found[n] == ordered[n]
            np.testing.assert_array_equal(np.sort(found[:n]), ordered[:n])
            np.testing.assert_array_equal(np.sort(found[n:]), ordered[n:])


@numba
def test_compiled_frames_give_back_what_they_allocate(compiled_fit):
    first, second = (
        [int(number) for number in line.split()]
        for line in python(FRAMES, env={**os.environ, "NUMBA_NRT_STATS": "1"}).stdout.splitlines()
    )
    assert second[0] > first[0]
    assert second[1] == first[1]


def spaced(low, high, count=20_000):
    return np.random.default_rng(5).uniform(low, high, count)


UP = np.geomspace(1e-300, 700, 400)
POWERS = [spaced(-708, 700), spaced(-1, 1), [0.0, -0.0, -1e-300, -707.99, 700]]
SCALED = [spaced(-26, 40), 10 ** spaced(1, 150), [0.0, 24.99, 25.0, 25.01]]
TURNS = [spaced(-7, 7), np.pi / 2 * np.arange(-4, 5), [0.0, -0.0, 1e-300]]
NORMAL = [spaced(-40, 10), -(10 ** spaced(0, 100)), [0.0, -1.0, -0.999, 37.0]]
NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(
    ("theirs", "numbers", "rtol", "atol", "edges"),
    [
        (exp, POWERS, 4e-16, 0, {-708.1: 0, -1e200: 0, -INF: 0, NAN: NAN}),
        (expm1, [-UP, [0.0], UP], 1e-15, 0, {-1e5: -1, -INF: -1}),
        (sin, TURNS, 0, 4e-16, {600.0: np.sin(600.0), NAN: NAN, INF: NAN}),
        (cos, TURNS, 0, 4e-16, {600.0: np.cos(600.0), NAN: NAN, INF: NAN}),
        (erfcx, SCALED, 1e-12, 0, {}),
        (ndtr, NORMAL, 1e-12, 1e-300, {-1e100: 0.0, 1e100: 1.0}),
        (log_ndtr, NORMAL, 1e-12, 1e-300, {-1e100: -5e199}),
    ],
)
@numba
def test_a_function_is_that_of_numpy_or_scipy(theirs, numbers, rtol, atol, edges):
    function, numbers = compilation.compiled(lambda x: theirs(x)), np.concatenate(numbers)
    found = [function(x) for x in numbers]
    np.testing.assert_allclose(found, theirs(numbers), rtol=rtol, atol=atol)
    at_edges = [function(x) for x in edges]
    np.testing.assert_allclose(at_edges, list(edges.values()), rtol=1e-6)


@both
def test_the_larger_and_the_smaller_keep_a_nan_that_is_given_first(fast):
    larger = as_given(lambda x, low: maximum(x, low), fast)
    smaller = as_given(lambda x, high: minimum(x, high), fast)
    for x in (-INF, -3.0, 1.0, 2.0, 5.0, INF):
        assert (larger(x, 1.0), smaller(x, 2.0)) == (max(x, 1.0), min(x, 2.0))
    assert np.isnan([larger(NAN, 0.0), smaller(NAN, 1.0)]).all()


def test_without_numba_asking_for_it_is_refused_with_the_cure_and_numpy_goes_on():
    code = (
        "import sys; sys.modules['numba'] = None\n"
        "from uuv_optical_array.core.numerics import compilation\n"
        "from uuv_optical_array.estimation.information.linearised import Lineariser, write_linear\n"
        "from uuv_optical_array.forward.model import ForwardModel\n"
        "from uuv_optical_array.forward.scene import load_scene\n"
        "model = ForwardModel(load_scene('reference'))\n"
        "print(compilation.installed(), model.light([-4.0, 0, 0, 0, 0]).max())\n"
        "Lineariser(model, (), compilation.compiled(write_linear))\n"
    )
    run = python(code)
    installed, light = run.stdout.split()
    assert installed == "False"
    assert float(light) == pytest.approx(900.0)
    assert "ValueError: compiled: " in run.stderr
    assert "-m pip install 'numba" in run.stderr
