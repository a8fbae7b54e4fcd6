"""Pareto-optimal choices."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Costs that differ by less than 10 % count as equal: that is noise, or not worth a decision.
STEP = 1.1


def pareto_front(costs: ArrayLike) -> NDArray[np.bool_]:
    """Find the Pareto-optimal points, shape ``(n,)``, among costs ``(n, k)``.

    A point is dominated by one that costs no more in anything and less in something; equal points
    do not dominate each other. A point with a nan or an infinity is never optimal.
    """
    costs = np.asarray(costs, dtype=float)
    finite = np.isfinite(costs).all(axis=1)
    no_more = (costs[:, None] <= costs).all(axis=2) & finite[:, None]
    return finite & ~(no_more & ~no_more.T).any(axis=0)
