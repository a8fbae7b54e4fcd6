"""One correction of a Gaussian state by linear readings, on roots of covariances.

With any gain K the error after it is ``(I - K H) e - K v`` (P. Joseph's form; Y. Bar-Shalom,
X.-R. Li and T. Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, ch.
5.2.5). Of a root of the covariance that is one more root, made triangular by orthogonal turns
(T. Kailath, A. H. Sayed and B. Hassibi, *Linear Estimation*, 2000, ch. 12), so no rounding and no
choice of K makes a variance negative. K may therefore leave alone what readings say nothing
trustworthy of: those rows are zero (S. F. Schmidt's filter).

Many readings of a small state make no matrix of readings by readings. What they say
of the state is turned into as many readings as it has entries, whose noise is white (G. J. Bierman,
*Factorization Methods for Discrete Sequential Estimation*, 1977, ch. 4).
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

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
    def whole_root(self) -> Array:
        """Root of the covariance, of own and of shared errors, shape ``(d, k + h)``."""
        return np.concatenate([self.root, self.shared], axis=1)

    @property
    def covariance(self) -> Array:
        """Shape ``(d, d)``."""
        return self.root @ self.root.T + self.shared @ self.shared.T


class Reading(NamedTuple):
    """What was read: ``residual = slopes @ (x - mean) + spoilt * shared numbers + noise``.

    Parameters
    ----------
    residual
        Shape ``(n,)``.
    slopes
        By the state, shape ``(n, d)``.
    noise
        Its standard deviations, > 0, shape ``(n,)``.
    spoilt
        By the shared numbers, counts of one standard deviation, shape ``(n,)``, with h = n; or of
        length 0 where there are none.
    """

    residual: Array
    slopes: Array
    noise: Array
    spoilt: Array


def triangular(root: Array) -> Array:
    """Return the upper triangular root of the same covariance, shape ``(d, d)``."""
    size, columns = root.shape
    if columns < size:
        root = np.concatenate([np.zeros((size, size - columns)), root], axis=1)
    # Rows turned round, as LAPACK is faster by columns.
    return (_upper(root[::-1].T) * _above(size)).T[::-1, ::-1]


@cache
def _above(size: int) -> Array:
    return np.triu(np.ones((size, size)))


def weigh(belief: Belief, reading: Reading, learnt: int) -> tuple[Callable[[], Array], float]:
    """Return how readings correct a state, and how far they are from it.

    Parameters
    ----------
    belief
        Before.
    reading
        What was read.
    learnt
        How many entries of the state are corrected.

    Returns
    -------
    gain
        Returns by what residuals correct these, shape ``(learnt, n)``.
    distance
        Mahalanobis distance of the readings from the state, in the directions in which the first
        five entries move them: the likelihood ratio test of a jump in these (A. Willsky and
        H. Jones, 1976, IEEE Trans. Automatic Control 21, 108), chi with five degrees of freedom.
    """
    _, root, shared = belief
    residual, slopes, noise, spoilt = reading
    if len(spoilt):
        # All noise of a reading, w, tells of the shared numbers: they are ``spoilt w / std^2`` and
        # a rest. By that part of them the state moves with w, and the readings with the state.
        std = np.hypot(noise, spoilt)
        by_noise = shared * (spoilt / std**2)
        root = triangular(np.concatenate([root, shared * (noise / std)], axis=1))
        slopes = slopes @ np.linalg.inv(np.eye(len(root)) + by_noise @ slopes)
        residual = residual - slopes @ (by_noise @ residual)
    else:
        std, root = noise, belief.whole_root
    white, off = slopes / std[:, None], residual / std
    basis = None
    if len(white) > white.shape[1]:
        basis, white = np.linalg.qr(white)
        off = basis.T @ off
    seen = white @ root
    spread = _upper(np.concatenate([np.eye(len(seen)), seen.T]))
    found, _ = lapack.dtrtrs(spread, np.concatenate([white[:, :5], off[:, None]], axis=1), trans=1)
    distance = float(np.linalg.norm(_upper(found)[:5, 5]))

    def gain() -> Array:
        cross = seen @ root[:learnt].T
        if len(spoilt):
            moved = by_noise[:learnt] * std
            seen_moved = moved if basis is None else moved @ basis
            cross += seen_moved.T
        half, _ = lapack.dtrtrs(spread, cross, trans=1)
        found = np.asarray(lapack.dtrtrs(spread, half)[0]).T
        if basis is not None:
            found = found @ basis.T
            if len(spoilt):
                found += moved - seen_moved @ basis.T
        found = found / std
        if len(spoilt):
            found -= found @ slopes @ by_noise
        return found

    return gain, distance


def _upper(stack: Array) -> Array:
    """Return the triangular factor of rows by Householder; what is below it has no meaning."""
    turned, *_ = lapack.dgeqrf(stack)
    return np.asarray(turned[: stack.shape[1]])


def correct(belief: Belief, reading: Reading, gain: Array) -> Belief:
    """Correct a state by readings.

    Parameters
    ----------
    belief
        Before; its root is square and has zeros in the first columns of what is not learnt, as
        `triangular` leaves it.
    reading
        What was read.
    gain
        As `weigh` has it; entries behind its rows keep mean and covariance.
    """
    mean, root, shared = (part.copy() for part in belief)
    residual, slopes, noise, spoilt = reading
    learnt = len(gain)
    by_state = gain @ slopes
    mean[:learnt] += gain @ residual
    root[:learnt] -= by_state @ belief.root
    own = np.concatenate([root[:learnt, :learnt], gain * noise], axis=1)
    root[:learnt, :learnt] = triangular(own)
    shared[:learnt] -= by_state @ belief.shared
    if len(spoilt):
        shared[:learnt] -= gain * spoilt
    return Belief(mean, root, shared)
