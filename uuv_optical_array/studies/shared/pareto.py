"""Pareto-optimal choices."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.geometry import Array

# Costs that differ by less than 10 % count as equal: that is noise, or not worth a decision.
STEP = 1.1


def pareto_front(costs: ArrayLike) -> NDArray[np.bool_]:
    """Find the Pareto-optimal points, shape ``(n,)``, among costs ``(n, k)``.

    A point is dominated by one that costs no more in anything and less in something; equal points
    do not dominate each other. A point with a nan or an infinity is never optimal.
    """
    costs = np.asarray(costs, dtype=float)
    front = np.isfinite(costs).all(axis=1)
    points = np.unique(costs[front], axis=0)  # sorted: only an earlier one can dominate
    kept: list[Array] = []
    for point in points:
        if not any((other <= point).all() for other in kept):
            kept.append(point)
    if kept:
        front &= (costs[:, None] == np.array(kept)).all(axis=2).any(axis=1)
    return front


def thinned_front(effort: ArrayLike, costs: ArrayLike) -> list[int]:
    """Find few points that represent all: their places, none of which represents another.

    A point represents another one that takes no less effort, ``(n,)``, and whose costs, ``(n, k)``
    and > 0, are each at least its own over `STEP`.
    """
    effort, costs = np.asarray(effort), np.asarray(costs, dtype=float)
    kept: list[int] = []
    # A later point never represents an earlier one: that would need a smaller product.
    for i in np.lexsort((costs.prod(axis=1), effort)).tolist():
        if not any((costs[other] <= STEP * costs[i]).all() for other in kept):
            kept.append(i)
    return kept
