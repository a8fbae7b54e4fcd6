"""Small linear systems: Cholesky's factor beside LAPACK's, compiled and not, and solutions."""

import numpy as np
import pytest
from needs import numba
from scipy import linalg

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.linear_algebra import (
    cholesky,
    orthonormal,
    solve,
    solve_lower,
    solve_upper,
    triangular_factor,
)

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(params=[False, pytest.param(True, marks=numba)], ids=["plain", "compiled"])
def functions(request):
    functions = cholesky, solve_lower, solve_upper
    return [compilation.compiled(each) if request.param else each for each in functions]


@pytest.mark.parametrize("size", [1, 2, 5, 12])
def test_factor_and_solutions_are_lapacks(functions, size):
    factorise, lower, upper = functions
    rng = np.random.default_rng(size)
    root = rng.standard_normal((size, size + 2)) * 10.0 ** rng.uniform(-3, 3, (size, 1))
    matrix, vector = root @ root.T, rng.standard_normal(size)
    own, below, above = matrix.copy(), vector.copy(), vector.copy()
    own[np.triu_indices(size, 1)] = np.nan  # which is neither read nor written
    assert factorise(own)
    assert np.isnan(own[np.triu_indices(size, 1)]).all()
    theirs = linalg.cholesky(matrix, lower=True)
    np.testing.assert_allclose(np.tril(own), theirs, rtol=1e-9)
    lower(own, below)
    np.testing.assert_allclose(
        below, linalg.solve_triangular(theirs, vector, lower=True), rtol=1e-9
    )
    upper(own, above)
    np.testing.assert_allclose(
        above, linalg.solve_triangular(theirs, vector, lower=True, trans="T"), rtol=1e-9
    )


@pytest.mark.parametrize(
    "matrix",
    [
        [[0.0]],
        [[-1.0]],
        [[np.nan]],
        [[1.0, 1.0], [1.0, 1.0]],
        [[1.0, 2.0], [2.0, 1.0]],
        [[1.0, 0, 0], [0, 1, 0], [0, 0, -1e-9]],
        [[1.0, np.nan], [np.nan, 1.0]],
    ],
    ids=str,
)
def test_a_matrix_that_is_not_positive_definite_is_refused(functions, matrix):
    assert not functions[0](np.array(matrix))


@pytest.mark.parametrize("columns", [(), (3,)])
def test_a_system_is_solved_as_numpy_solves_it_and_a_singular_one_is_refused(columns):
    rng = np.random.default_rng(6)
    matrix, right = rng.standard_normal((6, 6)), rng.standard_normal((6, *columns))
    before = matrix.copy(), right.copy()
    np.testing.assert_array_equal(solve(matrix, right), np.linalg.solve(matrix, right))
    np.testing.assert_array_equal(matrix, before[0])
    np.testing.assert_array_equal(right, before[1])
    matrix[:, 5] = 0.0
    with pytest.raises(np.linalg.LinAlgError):
        solve(matrix, right)


@pytest.mark.parametrize("shape", [(5, 5), (25, 5), (9, 18)])
def test_the_factors_of_qr_are_numpys(shape):
    matrix = np.random.default_rng(shape[0]).standard_normal(shape)
    basis, factor = np.linalg.qr(matrix)
    np.testing.assert_allclose(orthonormal(matrix), basis, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(triangular_factor(matrix), factor, rtol=1e-13, atol=1e-13)
