"""Cholesky's factor of small matrices, in compiled code and out of it.

For the five to a dozen rows of a pose with its nuisances a call of LAPACK takes longer than the
sums.
"""

import math
from typing import Any


def cholesky(matrix: Any) -> bool:
    """Replace the lower triangle of a symmetric matrix by its Cholesky factor.

    - matrix: shape ``(p, p)``; the upper triangle is neither read nor written.
    - returned bool: whether the matrix is positive definite; if not, it is left half done.
    """
    for i in range(len(matrix)):
        for j in range(i + 1):
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
    """Replace b by the x of ``L x = b``.

    - factor: as `cholesky` leaves it, shape ``(p, p)``; of a shorter vector only as many rows and
      columns are used.
    - vector: shape ``(p,)`` or shorter.
    """
    for i in range(len(vector)):
        rest = vector[i]
        for k in range(i):
            rest -= factor[i, k] * vector[k]
        vector[i] = rest / factor[i, i]


def solve_upper(factor: Any, vector: Any) -> None:
    """Replace b by the x of ``L' x = b``, as `solve_lower`."""
    for i in range(len(vector) - 1, -1, -1):
        rest = vector[i]
        for k in range(i + 1, len(vector)):
            rest -= factor[k, i] * vector[k]
        vector[i] = rest / factor[i, i]
