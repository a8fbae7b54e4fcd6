"""What a track believes of pose and rate given the biases, and of the biases.

Biases are what frames have in common: offsets of the scene's unknown constants, gain errors of the
detectors, and the errors by which shades move a pose. All are in standard deviations of their
prior. Given the biases the errors of frames are white, and a Kalman filter of pose and rate needs
beside its mean only how that follows each bias (B. Friedland, 1969, IEEE Trans. Automatic Control
14, 359): whatever is learnt of the biases then moves the pose, and no frame is filtered again.

The covariance given the biases is kept as a root: with any gain K a correction leaves the error
``(I - K H) e - K v`` (P. Joseph's form; Y. Bar-Shalom, X.-R. Li and T. Kirubarajan, *Estimation
with Applications to Tracking and Navigation*, 2001, ch. 5.2.5), and no variance rounds below 0.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.linear_algebra import upper
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.track import POSE
from uuv_optical_array.estimation.unknowns.constants import Constants, drift


class Biases(NamedTuple):
    """Mean and covariance of the k biases, shapes ``(k,)`` and ``(k, k)``."""

    mean: Array
    covariance: Array


class Motion(NamedTuple):
    """Pose and rate, given the biases.

    - mean: at the biases' mean, shape ``(10,)``.
    - root: upper triangular root of the covariance given the biases, shape ``(10, 10)``.
    - slopes: of the mean by the biases, shape ``(10, k)``.
    """

    mean: Array
    root: Array
    slopes: Array

    def covariance(self, biases: Biases) -> Array:
        """Return the covariance, with what the biases add, shape ``(10, 10)``."""
        by_biases = self.slopes @ biases.covariance @ self.slopes.T
        return self.root @ self.root.T + (by_biases + by_biases.T) / 2


class Observation(NamedTuple):
    """What a frame says of its pose: five numbers with white noise of variance 1.

    - innovation: the numbers less what was expected, shape ``(5,)``.
    - by_pose, by_biases: their slopes, shapes ``(5, 5)`` and ``(5, k)``.
    """

    innovation: Array
    by_pose: Array
    by_biases: Array


class BiasSpace:
    """Which bias is what, and how biases drift.

    - hold_s: time in which constants and gains drift to new values, s.
    - constants, gains, shades: places of the biases.
    - learnt: how many of the first there are that readings teach: constants and gains.
    - stds: what one is of each, in its own unit, shape ``(k,)``.
    """

    def __init__(self, constants: Constants, hold_s: float) -> None:
        c, gains = constants, constants.detectors if constants.gain_std > 0 else 0
        shades = 5 if c.unclear_lasts_s > 0 else 0
        self.constants = slice(0, len(c.names))
        self.gains = slice(self.constants.stop, self.constants.stop + gains)
        self.learnt = self.gains.stop
        self.shades = slice(self.learnt, self.learnt + shades)
        self.stds = np.array([*c.stds, *[c.gain_std] * gains, *[1.0] * shades])
        self._by_gains = c.gain_std * c.by_detector if gains else np.zeros((1, 0))
        self._shade_rest = c.shade_rest
        self._hold_s = np.array([hold_s] * self.learnt + [c.unclear_lasts_s] * shades)

    def prior(self) -> Biases:
        """Return the biases before any frame."""
        return Biases(np.zeros(len(self.stds)), np.eye(len(self.stds)))

    def drifted(self, biases: Biases, step_s: float) -> Biases:
        """Let the biases, or the first of them, drift for a time, s."""
        kept = drift(self._hold_s[: len(biases.mean)], step_s)
        covariance = kept[:, None] * kept * biases.covariance
        covariance.flat[:: len(kept) + 1] += 1 - kept**2
        return Biases(kept * biases.mean, covariance)

    def shades_drifted(self, motion: Motion, step_s: float) -> Motion:
        """Return a copy in which what old shades did is an error of its own, as others come."""
        kept = drift(self._hold_s[self.shades], step_s)
        slopes, old = motion.slopes.copy(), motion.slopes[:, self.shades]
        slopes[:, self.shades] = old * kept
        root = np.hstack([motion.root, old * np.sqrt(1 - kept**2)])
        return Motion(motion.mean.copy(), root, slopes)

    def replaced(self, biases: Biases, learnt: Biases) -> Biases:
        """Return biases with what was learnt of them; shades are not learnt."""
        mean, covariance, of = biases.mean.copy(), biases.covariance.copy(), slice(self.learnt)
        mean[of], covariance[of, of] = learnt
        return Biases(mean, covariance)

    def offsets(self, biases: Array) -> Array:
        """Return the constants' offsets in their own units, shape ``(q,)``."""
        return biases[self.constants] * self.stds[self.constants]

    def whitened(self, readings: LinearisedReadings, slopes: Array) -> tuple[Array, Array, Array]:
        """Return readings in units of their noise, of one frame or of many.

        What shades of the scene leave in frames that pass for clear counts as noise.

        - slopes: by pose and constants, in any coordinates, shape ``(..., n, 5 + q)``.
        - returned: residuals, slopes by the pose, and by what is learnt, shapes ``(..., n)``,
          ``(..., n, 5)`` and ``(..., n, learnt)``.
        """
        white = 1 / np.sqrt(readings.variances)  # a reading of infinite variance says nothing
        slopes = white[..., None] * slopes
        by_constants = slopes[..., 5:] * self.stds[self.constants]
        by_gains = (white * readings.light)[..., None] * self._by_gains
        by_learnt = np.concatenate([by_constants, by_gains], axis=-1)
        parts = [(white * readings.residuals)[..., None], slopes[..., :5], by_learnt]
        if self._shade_rest.size:
            shades = (white * readings.light)[..., None] * self._shade_rest
            basis, sizes, _ = np.linalg.svd(shades, full_matrices=False)
            less = 1 / np.sqrt(1 + sizes**2)[..., None] - 1
            parts = [part + basis @ (less * (basis.swapaxes(-1, -2) @ part)) for part in parts]
        residuals, by_pose, by_learnt = parts
        return residuals[..., 0], by_pose, by_learnt


def triangular(root: Array) -> Array:
    """Return the upper triangular root of the same covariance, shape ``(d, d)``."""
    size, columns = root.shape
    if columns < size:
        root = np.concatenate([np.zeros((size, size - columns)), root], axis=1)
    # Rows in reverse order, as LAPACK is faster by columns.
    factor, *_ = lapack.dgeqrf(root[::-1].T)
    return np.asarray(upper(factor[:size]).T[::-1, ::-1])


def weigh(motion: Motion, biases: Biases, observation: Observation) -> tuple[float, float]:
    """Return how far an observation is from what was expected, and how improbable it is.

    - returned distance: Mahalanobis distance of the innovation, chi with five degrees of freedom.
    - returned cost: twice the negative log-likelihood of the innovation, but for a constant.
    """
    innovation, by_pose, by_biases = observation
    by_root, by_biases = by_pose @ motion.root[POSE], by_pose @ motion.slopes[POSE] + by_biases
    spread = np.eye(5) + by_root @ by_root.T + by_biases @ biases.covariance @ by_biases.T
    root = lapack.dpotrf(spread, lower=1)[0]
    white, _ = lapack.dtrtrs(root, innovation, lower=1)
    distance = math.sqrt(white @ white)
    return distance, distance**2 + 2 * float(np.log(root.diagonal()).sum())


def correct(motion: Motion, observation: Observation, considered: Array | None = None) -> Motion:
    """Return pose and rate corrected by an observation.

    - considered: covariance of the biases, shape ``(k, k)``, where the observation does not teach
      them, so that what they add to its errors lowers the gain (S. F. Schmidt, *Advances in Control
      Systems* 3, 1966, 293); ``None``: the gain is that of biases that are given.
    """
    mean, root, slopes = motion
    innovation, by_pose, by_biases = observation
    by_root, by_biases = by_pose @ root[POSE], by_pose @ slopes[POSE] + by_biases
    cross, spread = root @ by_root.T, np.eye(5) + by_root @ by_root.T
    if considered is not None:
        both = considered @ by_biases.T
        cross, spread = cross + slopes @ both, spread + by_biases @ both
    gain = np.asarray(lapack.dposv(spread, cross.T)[1]).T
    root = triangular(np.hstack([root - gain @ by_root, gain]))
    return Motion(mean + gain @ innovation, root, slopes - gain @ by_biases)
