"""One correction of a Gaussian state by linear readings, on roots of covariances.

With any gain K the error after it is ``(I - K H) e - K v`` (P. Joseph's form; Y. Bar-Shalom,
X.-R. Li and T. Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, ch.
5.2.5). Of a root of the covariance that is one more root, made triangular by orthogonal turns
(T. Kailath, A. H. Sayed and B. Hassibi, *Linear Estimation*, 2000, ch. 12), so no rounding and no
choice of K makes a variance negative. K may therefore leave alone what readings say nothing
trustworthy of: those rows are zero (S. F. Schmidt's filter).
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from uuv_optical_array.core.geometry import Array


class Belief(NamedTuple):
    """A Gaussian state; its covariance is ``root root' + shared shared'``.

    Parameters
    ----------
    mean
        Shape ``(d,)``.
    root
        Errors of its own, shape ``(d, k)``.
    shared
        Errors by h standard normal numbers that spoil readings for ever and are not learnt, shape
        ``(d, h)``.
    """

    mean: Array
    root: Array
    shared: Array

    @property
    def covariance(self) -> Array:
        """Shape ``(d, d)``."""
        return self.root @ self.root.T + self.shared @ self.shared.T


class Reading(NamedTuple):
    """What was read: ``residual = slopes @ (x - mean) + spoilt @ shared numbers + noise``.

    Parameters
    ----------
    residual
        Shape ``(n,)``.
    slopes
        By the state, shape ``(n, d)``.
    noise
        Root of its covariance, lower triangular, shape ``(n, n)``; diagonal where there are shared
        numbers.
    spoilt
        By the shared numbers, counts of one standard deviation: the diagonal, shape ``(n,)``, with
        h = n; or of length 0 where there are none.
    """

    residual: Array
    slopes: Array
    noise: Array
    spoilt: Array


def triangular(root: Array) -> Array:
    """Return the lower triangular root of the same covariance, shape ``(d, d)``."""
    return np.asarray(np.linalg.qr(root.T, mode="r")).T


def correct(belief: Belief, reading: Reading, learnt: int) -> tuple[Belief, float]:
    """Correct a state by readings.

    Parameters
    ----------
    belief
        Before.
    reading
        What was read.
    learnt
        How many entries of the state are corrected; those behind keep mean and covariance.

    Returns
    -------
    belief
        After.
    distance
        Mahalanobis distance of the readings from the state, in the directions in which the first
        five entries move them: the likelihood ratio test of a jump in these (A. Willsky and
        H. Jones, 1976, IEEE Trans. Automatic Control 21, 108), chi with five degrees of freedom.
    """
    mean, root, shared = belief
    residual, slopes, noise, spoilt = reading
    seen = slopes @ root
    carried = slopes @ shared
    cross = seen @ root.T + carried @ shared.T
    if len(spoilt):
        cross += spoilt[:, None] * shared.T
        spread = cross @ slopes.T + carried * spoilt
        spread[np.diag_indices_from(spread)] += noise.diagonal() ** 2 + spoilt**2
        innovation = np.linalg.cholesky(spread)
    else:
        innovation = triangular(np.hstack([noise, seen, carried]))
    white = solve_triangular(
        innovation, np.column_stack([residual, slopes[:, :5], cross]), lower=True
    )
    jump, _ = np.linalg.qr(white[:, 1:6])
    distance = float(np.linalg.norm(jump.T @ white[:, 0]))
    gain = solve_triangular(innovation, white[:, 6:], lower=True, trans="T").T
    gain[learnt:] = 0.0
    root = triangular(np.hstack([root - gain @ seen, gain @ noise]))
    shared = shared - gain @ carried
    if len(spoilt):
        shared -= gain * spoilt
    return Belief(mean + gain @ residual, root, shared), distance
