"""What a function is over a Gaussian belief beside linear, to the second order.

Of x ~ N(m, R R') a function f has the mean ``f(m) + sum_i b_ii / 2``, and its covariance is that of
its slopes and ``sum_ij b_ij b_ij' / 2``, where ``b_ij`` are its second derivatives along columns of
R (M. Athans, R. P. Wishner and A. Bertolini, *IEEE Trans. Automatic Control* 13, 1968, 504). They
are half the differences of slopes at one standard deviation to both sides, so that they are those
over the width of the belief and not only at its middle.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import Array


class SecondOrder(NamedTuple):
    """What the second order adds to a function of k numbers.

    - shift: to its mean, shape ``(n,)``.
    - modes: root of what it adds to the covariance, shape ``(n, k * k)``.
    """

    shift: Array
    modes: Array


def second_order(
    slopes_at: Callable[[Array], Array], mean: Array, covariance: Array
) -> SecondOrder:
    """Return what the second order adds to a function over a Gaussian.

    - slopes_at: slopes of the function at a place, shape ``(n, k)``.
    - mean, covariance: of the place, shapes ``(k,)`` and ``(k, k)``.
    """
    variances, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(variances, 0.0))
    # By axis of the step, number of the function, axis of the slope.
    bends = np.array([slopes_at(mean + step) - slopes_at(mean - step) for step in root.T]) @ root
    bends = (bends + bends.transpose(2, 1, 0)) / 4
    modes = bends.transpose(1, 0, 2).reshape(bends.shape[1], -1) / np.sqrt(2)
    return SecondOrder(np.einsum("ini->n", bends) / 2, modes)
