"""The belief of a track: one Gaussian of pose, rate and all that frames have in common, the biases.

The biases are

- the errors of the scene's unknown constants and the gain errors of the detectors;
- the error that ranges from elsewhere have in common.

All are Ornstein-Uhlenbeck processes in standard deviations of their prior, to which they return
while unobserved. So errors of linearisation are forgotten, too.

Readings correct the biases only by what is independent of the pose (the projection on the null
space of A. Mourikis and S. Roumeliotis, *IEEE ICRA* 2007), and then correct the pose for given
uncertain biases (S. F. Schmidt, *Advances in Control Systems* 3, 1966). What depends on both would
teach errors of the motion's model and of linearisation, which are the same in each frame.

Errors of readings that depend on the place, of beam, response and converter, last for a second and
are no biases but noise. In what corrects biases it is so large that the frames of `PLACE_S` count
as one. The pose goes by the noise of single frames, as more of it would make the track late.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, lapack

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.motion import LONG_AGO_NS
from uuv_optical_array.estimation.tracking.track import RangeUse
from uuv_optical_array.estimation.unknowns.constants import Constants, drift

STATE = 10  # pose and rate, before the biases
# Errors of readings that depend on the place: the time in which they count as one, s, twice that in
# which they change, as an Ornstein-Uhlenbeck process has it, and their size relative to gain
# errors. Without them an unforeseen beam makes false tracks; twice as large, they cost a tenth of
# the accuracy of the range in seas of the prior.
PLACE_S, PLACE_SHARE = 2.0, 0.5
VARIANCE_ROUNDING = 1e-14  # of a variance, which a correction may lose
MOST_BLOCKS = 7  # by a side of the array: the detectors of a block have one gain error, their mean


class Belief(NamedTuple):
    """Pose, rate and k biases.

    - mean, covariance: shapes ``(10 + k,)`` and ``(10 + k, 10 + k)``.
    - range, ranged_ns: what was made of the last range; stamp of the last one that was used, ns.
    - unlike: how many frames in a row, up to the last with readings, the biases did not explain.
    """

    mean: Array
    covariance: Array
    range: RangeUse | None = None
    ranged_ns: int = LONG_AGO_NS
    unlike: int = 0


class BiasSpace:
    """Which bias is what, and how biases drift.

    - constants, gains: places of the errors among those that are learnt, `count` in all.
    - stds: what one is of each, in its own unit, shape ``(count,)``.
    - range: place of the bias of ranges, the last of `size` in all.
    - by_state: pose and what is learnt by pose, rate and biases, shape ``(5 + count, 10 + size)``.
    - blocks: gain errors of detectors by those that are learnt, shape ``(detectors, blocks)``.
    """

    def __init__(self, constants: Constants, hold_s: float) -> None:
        c, q = constants, len(constants.names)
        self.blocks = _blocks(round(c.detectors**0.5)) if c.gain_std > 0 else np.zeros((0, 0))
        gains, gain_stds = self.blocks.shape[1], c.gain_std / np.sqrt(self.blocks.sum(axis=0))
        self.constants, self.gains = slice(0, q), slice(q, q + gains)
        self.count = n = q + gains
        self.stds = np.array([*c.stds, *gain_stds])
        self.range, self.size = n, n + 1
        self.by_state = block_diag(np.eye(5, STATE), np.eye(n, self.size))
        self.by_offsets = self.stds[:q, None] * np.eye(q, self.size)
        self._units = np.array([*[1.0] * 5, *c.stds])
        by_block = np.tile(self.blocks * gain_stds, (c.lamps, 1))
        self._by_gains = by_block if gains else np.zeros((1, 0))
        self._shade_rest = c.shade_rest
        self._hold_s, self._place_std = hold_s, PLACE_SHARE * c.gain_std

    def begun(self, mean: Array, covariance: Array) -> Belief:
        """Return a belief of this pose and rate and of biases as the prior has them."""
        whole = np.eye(STATE + self.size)
        whole[:STATE, :STATE] = covariance
        return Belief(np.concatenate([mean, np.zeros(self.size)]), whole)

    def drifted(self, belief: Belief, step_s: float) -> Belief:
        """Let the biases drift for a time, s."""
        kept = np.ones(len(belief.mean))
        kept[STATE:] = drift(self._hold_s, step_s)
        covariance = kept[:, None] * kept * belief.covariance
        covariance.flat[:: len(kept) + 1] += 1 - kept**2
        return belief._replace(mean=kept * belief.mean, covariance=covariance)

    def forgotten(self, belief: Belief) -> Belief:
        """Return a belief of constants and ranges as the prior has them; the rest is kept."""
        mean, covariance = belief.mean.copy(), belief.covariance.copy()
        of = STATE + np.r_[self.constants, self.range]
        mean[of] = covariance[of] = covariance[:, of] = 0.0
        covariance[of, of] = 1.0
        return belief._replace(mean=mean, covariance=covariance)

    def learnt(self, belief: Belief) -> tuple[Array, Array]:
        """Return means and standard deviations of constants and gains, in their own units."""
        stds = np.sqrt(belief.covariance.diagonal()[STATE:-1])
        return self.stds * belief.mean[STATE:-1], self.stds * stds

    def offsets(self, belief: Belief) -> Array:
        """Return the constants' offsets in their own units, shape ``(q,)``.

        Their slopes by the biases are `by_offsets`, shape ``(q, size)``.
        """
        return self.by_offsets @ belief.mean[STATE:]

    def whitened(
        self,
        readings: LinearisedReadings,
        slopes: Array,
        modes: Array | None = None,
        alike: float = 0.0,
    ) -> Array:
        """Return slopes and residuals in units of their noise, of one frame or of many.

        What shades of the scene leave in frames that count as clear is noise.

        - slopes: by pose and constants, in any coordinates, shape ``(..., n, 5 + q)``.
        - modes: root of the covariance of more noise, counts, shape ``(..., n, k)``.
        - alike: how many frames share the errors of their place; 0: there are none.
        - returned: slopes by the pose and by what is learnt, residuals last, shape
          ``(..., n, 5 + count + 1)``.
        """
        of_place = alike * np.square(self._place_std * readings.light)
        white = 1 / np.sqrt(readings.variances + of_place)  # of infinite variance: says nothing
        whole, own = np.empty((*white.shape, 5 + self.count + 1)), len(self._units)
        light = (white * readings.light)[..., None]
        whole[..., :own] = white[..., None] * (slopes * self._units)
        whole[..., own:-1] = light * self._by_gains
        whole[..., -1] = white * readings.residuals
        rest = [light * self._shade_rest] if self._shade_rest.size else []
        if modes is not None:
            rest.append(white[..., None] * modes)
        if rest:
            basis, sizes, _ = np.linalg.svd(np.concatenate(rest, axis=-1), full_matrices=False)
            less = 1 / np.sqrt(1 + sizes**2)[..., None] - 1
            whole += basis @ (less * (basis.swapaxes(-1, -2) @ whole))
        return whole


def _blocks(side: int) -> Array:
    """Return which detectors are in which block, shape ``(side^2, blocks)``."""
    per_side = min(side, MOST_BLOCKS)
    of = np.eye(per_side)[np.arange(side) * per_side // side]
    return np.kron(of, of)


class Observation(NamedTuple):
    """What is observed, ``y = H x + noise`` of variance 1.

    - innovation: ``y - H x`` at the mean, shape ``(n,)``.
    - slopes: ``H``, by pose, rate and biases, shape ``(n, 10 + k)``.
    """

    innovation: Array
    slopes: Array


def _expected(covariance: Array, slopes: Array) -> tuple[Array, Array]:
    """Return ``P H'`` and the lower root of the innovation's covariance ``H P H' + I``."""
    cross = covariance @ slopes.T
    spread = slopes @ cross
    spread.flat[:: len(spread) + 1] += 1.0
    return cross, lapack.dpotrf(spread, lower=1)[0]


def weigh(covariance: Array, observation: Observation) -> tuple[float, Array]:
    """Return an innovation's Mahalanobis distance by a belief, and Kalman's shift of the mean."""
    cross, root = _expected(covariance, observation.slopes)
    white, _ = lapack.dtrtrs(root, observation.innovation, lower=1)
    return math.sqrt(white @ white), cross @ lapack.dtrtrs(root, white, lower=1, trans=1)[0]


def cost(covariance: Array, observation: Observation) -> float:
    """Return twice the negative log-likelihood of an innovation, up to a constant."""
    _, root = _expected(covariance, observation.slopes)
    white, _ = lapack.dtrtrs(root, observation.innovation, lower=1)
    return float(white @ white + 2 * np.log(root.diagonal()).sum())


def correct(belief: Belief, observation: Observation, teach: bool = True) -> Belief:
    """Return a belief after Kalman's update by an observation, or Schmidt's, which keeps biases.

    Kalman's is ``x + K (y - H x)``, ``P - K H P`` with the gain ``K = P H' (H P H' + I)^-1``. In
    Schmidt's the gain of the biases is 0.
    """
    mean, covariance = belief.mean, belief.covariance
    innovation, slopes = observation
    cross, root = _expected(covariance, slopes)
    white = lapack.dtrtrs(root, np.column_stack([innovation, cross.T]), lower=1)[0]
    shift, less = white[:, 0] @ white[:, 1:], white[:, 1:].T @ white[:, 1:]
    if not teach:
        shift[STATE:] = less[STATE:, STATE:] = 0.0
    corrected = covariance - less
    corrected.flat[:: len(mean) + 1] += VARIANCE_ROUNDING * covariance.diagonal()
    return belief._replace(mean=mean + shift, covariance=(corrected + corrected.T) / 2)
