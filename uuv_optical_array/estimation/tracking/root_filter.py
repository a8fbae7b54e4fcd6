"""One correction of a Gaussian state by a linear observation, on roots of covariances.

With any gain K the error after it is ``(I - K H) e - K v`` (P. Joseph's form; Y. Bar-Shalom,
X.-R. Li and T. Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, ch.
5.2.5). Of a root of the covariance that is one more root, made triangular by orthogonal turns
(T. Kailath, A. H. Sayed and B. Hassibi, *Linear Estimation*, 2000, ch. 12), so no rounding and no
choice of K makes a variance negative. K may therefore have rows of zeros: these states are
considered and not corrected (S. F. Schmidt's filter).

A long observation of a small state makes no matrix of its own length squared: it is reduced to as
many numbers as the state has entries, whose noise is white (G. J. Bierman, *Factorization Methods
for Discrete Sequential Estimation*, 1977, ch. 4).
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from uuv_optical_array.core.geometry import Array


class Gaussian(NamedTuple):
    """A Gaussian state; its covariance is ``root root' + consider consider'``.

    - mean: shape ``(d,)``.
    - root: root of the covariance of errors of its own, shape ``(d, k)``.
    - consider: errors by h standard normal consider parameters, which are in every observation and
      never estimated, shape ``(d, h)``.
    """

    mean: Array
    root: Array
    consider: Array

    @property
    def full_root(self) -> Array:
        """Root of the covariance, consider parameters included, shape ``(d, k + h)``."""
        return np.concatenate([self.root, self.consider], axis=1)

    @property
    def covariance(self) -> Array:
        """Shape ``(d, d)``."""
        return self.root @ self.root.T + self.consider @ self.consider.T


class Observation(NamedTuple):
    """``innovation = slopes @ (x - mean) + consider * consider parameters + noise``.

    - innovation: shape ``(n,)``.
    - slopes: by the state, shape ``(n, d)``.
    - noise: its standard deviations, > 0, shape ``(n,)``.
    - consider: by the consider parameters, of which each entry has one of its own (h = n), shape
      ``(n,)``; of length 0 where there are none.
    """

    innovation: Array
    slopes: Array
    noise: Array
    consider: Array


def triangular(root: Array) -> Array:
    """Return the upper triangular root of the same covariance, shape ``(d, d)``."""
    size, columns = root.shape
    if columns < size:
        root = np.concatenate([np.zeros((size, size - columns)), root], axis=1)
    # Rows in reverse order, as LAPACK is faster by columns.
    return (_qr_factor(root[::-1].T) * _upper_mask(size)).T[::-1, ::-1]


@cache
def _upper_mask(size: int) -> Array:
    return np.triu(np.ones((size, size)))


def weigh(
    state: Gaussian, observation: Observation, corrected: int
) -> tuple[Callable[[], Array], float, float]:
    """Return the gain of an observation, its distance from a state, and how improbable it is.

    - state: before.
    - observation: of the state.
    - corrected: how many of the first entries of the state are corrected.
    - returned gain: returns the gain of these entries, shape ``(corrected, n)``.
    - returned distance: mahalanobis distance of the innovation from 0 in the directions in which
      the first five entries move it: the likelihood ratio test of a jump in these (A. Willsky and
      H. Jones, 1976, IEEE Trans. Automatic Control 21, 108), chi with five degrees of freedom.
    - returned cost: twice the negative log-likelihood of the observation, but for what is the same
      for all states.
    """
    _, root, consider = state
    innovation, slopes, noise, by_consider = observation
    if len(by_consider):
        # The sum w of noise and consider parameters predicts the latter: they are
        # ``by_consider w / std^2`` and a rest. By that part the state moves with w.
        std = np.hypot(noise, by_consider)
        by_noise = consider * (by_consider / std**2)
        root = triangular(np.concatenate([root, consider * (noise / std)], axis=1))
        slopes = slopes @ np.linalg.inv(np.eye(len(root)) + by_noise @ slopes)
        innovation = innovation - slopes @ (by_noise @ innovation)
    else:
        std, root = noise, state.full_root
    white_slopes, white = slopes / std[:, None], innovation / std
    basis = None
    if len(white_slopes) > white_slopes.shape[1]:
        basis, white_slopes = np.linalg.qr(white_slopes)
        white = basis.T @ white
    spread_root = white_slopes @ root
    spread = _qr_factor(np.concatenate([np.eye(len(spread_root)), spread_root.T]))
    jump = np.concatenate([white_slopes[:, :5], white[:, None]], axis=1)
    whitened, _ = lapack.dtrtrs(spread, jump, trans=1)
    distance = float(np.linalg.norm(_qr_factor(whitened)[:5, 5]))
    volume = np.log(np.abs(spread.diagonal())).sum()
    cost = float(whitened[:, 5] @ whitened[:, 5] + 2 * volume)

    def gain() -> Array:
        cross = spread_root @ root[:corrected].T
        if len(by_consider):
            moved = by_noise[:corrected] * std
            moved_in_basis = moved if basis is None else moved @ basis
            cross += moved_in_basis.T
        half, _ = lapack.dtrtrs(spread, cross, trans=1)
        result = np.asarray(lapack.dtrtrs(spread, half)[0]).T
        if basis is not None:
            result = result @ basis.T
            if len(by_consider):
                result += moved - moved_in_basis @ basis.T
        result = result / std
        if len(by_consider):
            result -= result @ slopes @ by_noise
        return result

    return gain, distance, cost


def _qr_factor(stack: Array) -> Array:
    """Return the triangular factor of rows by Householder; what is below it has no meaning."""
    factor, *_ = lapack.dgeqrf(stack)
    return np.asarray(factor[: stack.shape[1]])


def correct(state: Gaussian, observation: Observation, gain: Array) -> Gaussian:
    """Return a state corrected by an observation.

    - state: before; its root is square and has zeros in the first columns of what is not corrected,
      as `triangular` returns it.
    - observation: of the state.
    - gain: as `weigh` returns it; entries behind its rows keep mean and covariance.
    """
    mean, root, consider = (part.copy() for part in state)
    innovation, slopes, noise, by_consider = observation
    corrected = len(gain)
    by_state = gain @ slopes
    mean[:corrected] += gain @ innovation
    root[:corrected] -= by_state @ state.root
    own = np.concatenate([root[:corrected, :corrected], gain * noise], axis=1)
    root[:corrected, :corrected] = triangular(own)
    consider[:corrected] -= by_state @ state.consider
    if len(by_consider):
        consider[:corrected] -= gain * by_consider
    return Gaussian(mean, root, consider)
