"""Pareto-optimal choices: those that no other beats in everything."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.geometry import Array

# Costs that differ by less than 10 % count as equal: that is noise, or not worth a decision.
STEP = 1.1


def pareto_front(costs: ArrayLike) -> NDArray[np.bool_]:
    """Find the points that no other point beats.

    A point is beaten by one that costs no more in anything and less in something; equal points
    do not beat each other.

    Parameters
    ----------
    costs
        Less is better, shape ``(n, k)``; a point with a nan or an infinity is on no front.

    Returns
    -------
    ndarray of bool
        Which points are on the front, shape ``(n,)``.
    """
    costs = np.asarray(costs, dtype=float)
    front = np.isfinite(costs).all(axis=1)
    points = np.unique(costs[front], axis=0)  # sorted: only an earlier one can beat a point
    kept: list[Array] = []
    for point in points:
        if not any((other <= point).all() for other in kept):
            kept.append(point)
    if kept:
        front &= (costs[:, None] == np.array(kept)).all(axis=2).any(axis=1)
    return front


def thinned_front(effort: ArrayLike, costs: ArrayLike) -> list[int]:
    """Find few points that stand for all.

    A point stands for another one that takes no less effort and whose costs, each of them, are no
    more than `STEP` times smaller than its own.

    Parameters
    ----------
    effort
        Compared as it is, shape ``(n,)``.
    costs
        Compared in steps, > 0, shape ``(n, k)``.

    Returns
    -------
    list of int
        The points; none of them stands for another.
    """
    effort, costs = np.asarray(effort), np.asarray(costs, dtype=float)
    kept: list[int] = []
    # A later point stands for an earlier one never: that would need a smaller product.
    for i in np.lexsort((costs.prod(axis=1), effort)).tolist():
        if not any((costs[other] <= STEP * costs[i]).all() for other in kept):
            kept.append(i)
    return kept
