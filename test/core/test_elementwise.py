"""What serves numbers and arrays alike: each helper in NumPy, and the same source compiled."""

import os

import numpy as np
import pytest
from command_line import python
from needs import numba
from scipy.special import erfcx, log_ndtr

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.elementwise import workspace, zeros

both = pytest.mark.parametrize("fast", [False, pytest.param(True, marks=numba)], ids=str)


def as_given(function, fast):
    return compilation.compiled(function) if fast else function


@pytest.fixture(scope="module")
def mathematics():
    return pytest.importorskip(
        "uuv_optical_array.core.numerics.compiled_math", reason="Numba is not installed"
    )


def shapes(component, count):
    return workspace(3, component, count).shape, zeros(2, 4, component).shape


@both
def test_arrays_for_one_pose_have_no_axis_for_poses(fast):
    assert as_given(shapes, fast)(1.5, 7) == ((3, 7), (2, 4))
    assert shapes(np.zeros((5, 1)), 7) == ((3, 5, 7), (2, 4, 5, 1))


def sums_of_arrays(count):
    """Two of each, so that one that is written to cannot be the other."""
    one, other, none = workspace(3, 0.0, count), workspace(3, 0.0, count), zeros(3, count, 0.0)
    one[:], other[:] = 1.0, 2.0
    return one.sum(), other.sum(), none.sum()


@both
def test_arrays_small_or_large_are_their_own(fast):
    call = as_given(sums_of_arrays, fast)
    for count in (0, 1, 600, 100_000, 1, 0):
        assert call(count) == (3 * count, 6 * count, 0)


def spaced(low, high, count=20_000):
    return np.random.default_rng(5).uniform(low, high, count)


def test_the_exponential_is_that_of_numpy_to_the_last_digit(mathematics):
    numbers = np.concatenate([spaced(-708, 700), spaced(-1, 1), [0.0, -0.0, -1e-300, -707.99, 700]])
    found = np.array([mathematics.exponential(x) for x in numbers])
    np.testing.assert_allclose(found, np.exp(numbers), rtol=4e-16)
    assert [mathematics.exponential(x) for x in (-708.1, -1e5, -1e200, -np.inf)] == [0.0] * 4
    assert np.isnan(mathematics.exponential(np.nan))


def test_the_exponential_less_one_is_that_of_numpy_to_the_last_digits(mathematics):
    small = np.geomspace(1e-300, 700, 400)
    numbers = np.concatenate([-small, [0.0], small])
    found = np.array([mathematics.exponential_less_one(x) for x in numbers])
    np.testing.assert_allclose(found, np.expm1(numbers), rtol=1e-15)
    assert [mathematics.exponential_less_one(x) for x in (-1e5, -np.inf)] == [-1.0] * 2


def test_the_logarithm_is_that_of_numpy_to_the_last_digit(mathematics):
    edges = np.nextafter(np.repeat([0.5, np.sqrt(0.5), 1.0, np.sqrt(2.0), 2.0], 2), [0.0, 9.0] * 5)
    numbers = np.concatenate([10 ** spaced(-307, 308), spaced(0.5, 2), edges, [1e-3, 1.0, 1e308]])
    found = np.array([mathematics.logarithm(x) for x in numbers])
    np.testing.assert_allclose(found, np.log(numbers), rtol=5e-16)
    assert [mathematics.logarithm(x) for x in (0.0, -0.0)] == [-np.inf] * 2
    assert np.isnan([mathematics.logarithm(x) for x in (-1.0, np.nan, np.inf, -np.inf)]).all()


def test_sine_and_cosine_are_those_of_numpy_for_some_turns(mathematics):
    quarters = np.arange(-40, 41) * np.pi / 2
    angles = np.concatenate([spaced(-30, 30), quarters, [0.0, 1e-9, -1e-300]])
    for found, expected in ((mathematics.sine, np.sin), (mathematics.cosine, np.cos)):
        values = np.array([found(x) for x in angles])
        np.testing.assert_allclose(values, expected(angles), rtol=0, atol=1e-15)
    # Small angles keep their digits.
    small = 10 ** spaced(-200, -1)
    np.testing.assert_allclose([mathematics.sine(x) for x in small], np.sin(small), rtol=4e-16)
    # What 2000 pi itself is known to, and some digits more.
    far = spaced(-1, 1) + 2000 * np.pi
    np.testing.assert_allclose([mathematics.sine(x) for x in far], np.sin(far), atol=1e-11)


def test_the_scaled_complementary_error_function_is_scipys(mathematics):
    numbers = np.concatenate([spaced(-26, 40), 10 ** spaced(1, 150), [0.0, 24.99, 25.0, 25.01]])
    found = np.array([mathematics.scaled_complementary_error(x) for x in numbers])
    np.testing.assert_allclose(found, erfcx(numbers), rtol=1e-12)


def test_the_logarithm_of_the_normal_distribution_is_scipys(mathematics):
    numbers = np.concatenate([spaced(-40, 10), -(10 ** spaced(0, 100)), [0.0, -1.0, -0.999, 37.0]])
    found = np.array([mathematics.log_normal_distribution(u) for u in numbers])
    np.testing.assert_allclose(found, log_ndtr(numbers), rtol=1e-12, atol=1e-300)
    assert mathematics.log_normal_distribution(-1e100) == pytest.approx(-5e199)


def test_without_numba_asking_for_it_is_refused_with_the_cure_and_numpy_goes_on():
    code = (
        "import sys; sys.modules['numba'] = None\n"
        "from uuv_optical_array.core.numerics import compilation\n"
        "from uuv_optical_array.estimation.information.linearised import Lineariser\n"
        "from uuv_optical_array.forward.model import ForwardModel\n"
        "from uuv_optical_array.forward.scene import load_scene\n"
        "model = ForwardModel(load_scene('reference'))\n"
        "print(compilation.installed(), model.light([-4.0, 0, 0, 0, 0]).max())\n"
        "Lineariser(model, (), compiled=True)\n"
    )
    run = python(code)
    installed, light = run.stdout.split()
    assert installed == "False"
    assert float(light) == pytest.approx(900.0)
    assert "ValueError: compiled: " in run.stderr
    assert "-m pip install 'numba'" in run.stderr


@numba
def test_where_nothing_can_be_kept_it_is_compiled_all_the_same(tmp_path):
    """The folder for it lies below a file."""
    (tmp_path / "file").write_text("")
    code = (
        "from uuv_optical_array.core.numerics import compilation\n"
        "from uuv_optical_array.core.numerics.linear_algebra import cholesky\n"
        "import numpy as np\n"
        "matrix = np.array([[4.0, 0.0], [2.0, 10.0]])\n"
        "done = compilation.compiled(cholesky)(matrix)\n"
        "print(compilation.cache_folder(), done, matrix.tolist())\n"
    )
    folder = str(tmp_path / "file" / "below")
    run = python(code, env={**os.environ, "NUMBA_CACHE_DIR": folder})
    assert run.stdout.strip() == "None True [[2.0, 0.0], [1.0, 3.0]]"
