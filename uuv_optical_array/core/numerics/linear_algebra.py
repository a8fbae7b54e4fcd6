"""Linear algebra of matrices so small that the checks around LAPACK take longer than the sums.

`solve` and the factors of QR call LAPACK without them. Cholesky's is written out, for compiled
loops.
"""

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack


def solve(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what `numpy.linalg.solve` returns, and raise its LinAlgError, in a fifth of the time.

    Shapes ``(n, n)`` and ``(n,)`` or ``(n, m)``.
    """
    *_, solution, singular = lapack.dgesv(matrix, right)
    if singular:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(solution)


def triangular_factor(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R of the QR decomposition, shape ``(min(n, m), m)`` for a matrix of ``(n, m)``."""
    factor = lapack.dgeqrf(matrix)[0][: min(matrix.shape)]
    return np.asarray(factor * _upper_mask(factor.shape))


def orthonormal(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Q of the QR decomposition, shape ``(n, min(n, m))`` for a matrix of ``(n, m)``."""
    reflectors, scales, *_ = lapack.dgeqrf(matrix)
    return np.asarray(lapack.dorgqr(reflectors[:, : len(scales)], scales)[0])


@cache
def _upper_mask(shape: tuple[int, ...]) -> NDArray[np.float64]:
    return np.triu(np.ones(shape))


def cholesky(matrix: Any) -> bool:
    """Replace the lower triangle of a symmetric matrix by its Cholesky factor; the upper is unused.

    Where the matrix is not positive definite the result is false, and the triangle half done.
    """
    for j in range(len(matrix)):
        # Row by row each number would wait for the one before it.
        for i in range(j, len(matrix)):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = rest / matrix[j, j]
            elif rest > 0:
                matrix[i, i] = math.sqrt(rest)
            else:
                return False
    return True


def solve_lower(factor: Any, vector: Any) -> None:
    """Replace b by the x of ``L x = b``; for a shorter b by a part of the factor of `cholesky`."""
    for i in range(len(vector)):
        rest = vector[i]
        for k in range(i):
            rest -= factor[i, k] * vector[k]
        vector[i] = rest / factor[i, i]


def solve_upper(factor: Any, vector: Any) -> None:
    """Replace b by the x of ``L' x = b``, as `solve_lower`."""
    for i in range(len(vector) - 1, -1, -1):
        vector[i] /= factor[i, i]
        for k in range(i):
            vector[k] -= factor[i, k] * vector[i]
