"""A track's belief corrected by a frame: by its pose, or by its readings.

Readings are applied in coordinates in which images stay linear (`joint_coordinates`), and are
linearised once more on the way from the predicted pose to the corrected one (`RELINEARISE_AT`).
Slopes at its end have the noise of the readings that they weigh, those at its beginning leave out
the curvature of the light: either biases what is learnt, the same in each frame.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack, solve_triangular

from uuv_optical_array.core.geometry import Array, wrapped
from uuv_optical_array.core.numerics.linear_algebra import qr, solve
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import (
    Biases,
    BiasSpace,
    Motion,
    Observation,
    correct,
    triangular,
    weigh,
)
from uuv_optical_array.estimation.tracking.keyframes import BiasFit, Keyframe, Keyframes
from uuv_optical_array.estimation.tracking.measurement import Measurement, checked_readings
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import POSE, RangeUse
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.estimation.unknowns.joint_coordinates import JointCoordinates
from uuv_optical_array.forward.prior import shade_doubt

# A shaded pose has more variance than a clear one, by `shade_doubt`. This share of that by one lamp
# is one error for as long as the shade lasts; the rest is white, so that the track follows.
SHADE_SHARE = 0.9 / shade_doubt(1)
# The white rest is alike in consecutive frames: this many count as one.
CORRELATED_FRAMES = 7.0
# Where constants are not known, poses without readings are of images that are not linear, as from
# afar. What makes them broad is mostly their shape, not noise, and that is the same in all frames.
BROAD_SHARE = 0.75
# Largest share of a pose's variance, in any direction, that is ascribed to the constants' errors.
MOST_COMMON = 0.9
# Place of the second linearisation, as a share of the correction: there the biases by noise and by
# curvature are least in drives of 20 minutes through seas drawn from the prior.
RELINEARISE_AT = 0.25
# A keyframe is linearised where it was found, if that is farther from where it was expected, in
# standard deviations of the pose of one frame.
MOST_SURPRISING = 2.0


class Belief(NamedTuple):
    """Pose and rate given the biases, these, the keyframes that teach them, and the last range."""

    motion: Motion
    biases: Biases
    keyframes: Keyframes
    range: RangeUse | None = None


class Deferred:
    """A belief that is computed when it is first asked for.

    Whether a frame passes the gate is known before, and its pose need not wait for the rest.
    """

    def __init__(self, compute: Callable[[], Belief]) -> None:
        self._compute: Callable[[], Belief] | None = compute
        self._belief: Belief | None = None

    def __call__(self) -> Belief:
        """Return the belief."""
        if self._compute is not None:
            belief, self._compute = self._compute(), None
            motion = belief.motion._replace(mean=wrapped(belief.motion.mean))
            self._belief = belief._replace(motion=motion)
        assert self._belief is not None
        return self._belief


class Corrected(NamedTuple):
    """A belief corrected by a frame, and distance and cost of the frame as `weigh` returns them."""

    belief: Deferred
    distance: float
    cost: float = 0.0


class Correction:
    """Corrects beliefs by frames; beyond the distance `gate` readings are linearised only once."""

    def __init__(
        self, space: BiasSpace, constants: Constants, settings: TrackerSettings, gate: float
    ) -> None:
        c, self._space = constants, space
        self._constants = constants
        self._coordinates = JointCoordinates(c.frame, c.names)
        self._settings, self._gate = settings, gate
        self.fit = BiasFit(space, settings.constants_hold_s, self._coordinates)

    def pose_errors(self, biases: Biases, frame: Measurement) -> tuple[Array, Array]:
        """Return how the pose of a frame depends on the biases, and its white errors.

        - returned root: of the covariance of the white errors, lower triangular, shape ``(5, 5)``.
        - returned slopes: of the measured pose by the biases, shape ``(5, k)``.
        """
        of, shades = self._space.constants, self._space.shades
        slopes, root = np.zeros((5, len(biases.mean))), frame.root
        if of.stop > of.start:
            # The fit assumed the expected constants: with others, another range is as bright.
            at = np.concatenate([frame.pose, self._space.offsets(biases.mean)])
            _, by_coordinates = self._coordinates.place(self._coordinates.of(at))
            by_constants = -by_coordinates[:5, 5:] * self._space.stds[of]
            slopes[:, of], root = _split(root, by_constants, biases.covariance[of, of])
        if shades.stop > shades.start:
            share = SHADE_SHARE * frame.shaded
            white = (1 - share) * (1 + (CORRELATED_FRAMES - 1) * frame.shaded)
            slopes[:, shades], root = math.sqrt(share) * root, math.sqrt(white) * root
        return math.sqrt(1 - self.common_share(frame)) * root, slopes

    def common_share(self, frame: Measurement) -> float:
        """Return the share of the variance of a frame's pose that all frames have in common."""
        broad = self._constants.names and frame.shaded < 0.5
        return max(self._settings.common_share, BROAD_SHARE if broad else 0.0)

    def correct(self, belief: Belief, frame: Measurement) -> Corrected:
        """Return a belief corrected by a frame; only readings correct the biases."""
        if frame.readings is None:
            return self._by_pose(belief, frame)
        result = self._by_readings(belief, frame, frame.readings)
        distance = max(result.distance, pose_distance(belief, frame))
        return result._replace(distance=distance)

    def _by_pose(self, belief: Belief, frame: Measurement) -> Corrected:
        motion, biases = belief[:2]
        root, slopes = self.pose_errors(biases, frame)
        innovation = wrapped(frame.pose - motion.mean[POSE])
        white = solve_triangular(root, np.column_stack([innovation, np.eye(5), slopes]), lower=True)
        observation = Observation(white[:, 0], white[:, 1:6], white[:, 6:])

        def finished() -> Belief:
            return belief._replace(motion=correct(motion, observation, biases.covariance))

        return Corrected(Deferred(finished), *weigh(motion, biases, observation))

    def _by_readings(
        self, belief: Belief, frame: Measurement, readings: LinearisedReadings
    ) -> Corrected:
        biases, before = belief.biases, self._straight(belief.motion, belief.biases)
        coordinates, expected = self._coordinates, before.mean[POSE]
        constants = self._space.offsets(biases.mean)

        def observation_of(readings: LinearisedReadings) -> Observation:
            at = coordinates.of(readings.at)
            slopes = readings.slopes @ coordinates.place(at)[1]
            off = coordinates.difference(np.concatenate([expected, constants]), at)
            return self._five_numbers(readings, slopes, off, biases.mean)

        observation = observation_of(readings)
        distance, cost = weigh(before, biases, observation)

        def finished() -> Belief:
            used, learnt, keyframes = observation, biases, belief.keyframes
            # A frame beyond the gate is not of this track, wherever it is linearised.
            if frame.relinearise and distance <= self._gate:
                step = correct(before, used).mean[POSE] - expected
                at = np.concatenate([expected + RELINEARISE_AT * step, constants])
                used = observation_of(self._readings_at(frame, coordinates.place(at)[0]))
            after = correct(before, used)
            if keyframes.want(frame, belief.motion.mean[POSE]):
                steady = after if keyframes.frames else before  # a first one is expected anywhere
                keyframe = self._keyframe(frame, biases, before, steady)
                keyframes, found = self.fit.fitted(keyframes, keyframe)
                learnt = self._space.replaced(biases, found)
            mean = after.mean + after.slopes @ (learnt.mean - biases.mean)
            curved = self._curved(after._replace(mean=mean), learnt)
            return Belief(curved, learnt, keyframes, belief.range)

        return Corrected(Deferred(finished), distance, cost)

    def _five_numbers(
        self, readings: LinearisedReadings, slopes: Array, off: Array, biases: Array
    ) -> Observation:
        """Return all that readings say of the pose given the biases.

        - slopes, off: by coordinates of pose and constants, and how far these are off.
        """
        of, learnt = self._space.constants, self._space.learnt
        residuals, by_pose, by_learnt = self._space.whitened(readings, slopes)
        biased = biases[:learnt].copy()
        biased[of] = off[5:] / self._space.stds[of]
        residuals = residuals - by_pose @ off[:5] - by_learnt @ biased
        # Of as many numbers, whose noise is white, the rest does not depend on the pose
        # (G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation*, 1977, ch. 4).
        basis, by_pose = qr(by_pose)
        by_biases = np.zeros((5, len(biases)))
        by_biases[:, :learnt] = basis.T @ by_learnt
        return Observation(basis.T @ residuals, by_pose, by_biases)

    def _keyframe(
        self, frame: Measurement, biases: Biases, before: Motion, after: Motion
    ) -> Keyframe:
        """Return a frame as a keyframe, by the motion in straight coordinates before and after."""
        of, constants = slice(self._space.learnt), self._space.offsets(biases.mean)
        expected, found = (
            self._coordinates.place(np.concatenate([motion.mean[POSE], constants]))[0][:5]
            for motion in (before, after)
        )
        surprise, _ = lapack.dtrtrs(frame.root, wrapped(found - expected), lower=1)
        far = surprise @ surprise > MOST_SURPRISING**2
        pose, motion = (found, after) if far else (expected, before)

        def readings_at(at: Array) -> LinearisedReadings:
            return self._readings_at(frame, at)

        place, slopes = motion.mean[POSE], motion.slopes[POSE, of]
        return Keyframe(frame.stamp_ns, pose, place, slopes, biases.mean[of], readings_at)

    def _readings_at(self, frame: Measurement, at: Array) -> LinearisedReadings:
        """Return readings linearised at pose and constants, or where that is not finite, as is."""
        assert frame.readings is not None
        if frame.relinearise:
            with suppress(ValueError):
                return checked_readings(frame.relinearise(at), self._constants)
        return frame.readings

    def _straight(self, motion: Motion, biases: Biases) -> Motion:
        """Return pose and rate with the pose in straight coordinates."""
        mean, root, slopes = (part.copy() for part in motion)
        offsets, of = self._space.offsets(biases.mean), self._space.constants
        here = self._coordinates.of(np.concatenate([mean[POSE], offsets]))
        _, by = self._coordinates.place(here)
        back = solve(by[:5, :5], np.eye(5))
        slopes[POSE, of] -= by[:5, 5:] * self._space.stds[of]
        mean[POSE], root[POSE], slopes[POSE] = here[:5], back @ root[POSE], back @ slopes[POSE]
        return Motion(mean, root, slopes)

    def _curved(self, motion: Motion, biases: Biases) -> Motion:
        """Return pose and rate with the pose in m and rad again."""
        mean, root, slopes = (part.copy() for part in motion)
        offsets, of = self._space.offsets(biases.mean), self._space.constants
        place, by = self._coordinates.place(np.concatenate([mean[POSE], offsets]))
        mean[POSE] = place[:5]
        root[POSE], slopes[POSE] = by[:5, :5] @ root[POSE], by[:5, :5] @ slopes[POSE]
        slopes[POSE, of] += by[:5, 5:] * self._space.stds[of]
        return Motion(mean, triangular(root), slopes)


def pose_distance(belief: Belief, frame: Measurement) -> float:
    """Return the distance of a frame's pose from a belief.

    Readings, which are linear near that pose, say little of a pose far from it. Both poses err by
    the same constants, so that the distance is rather too small.
    """
    spread = belief.motion.covariance(belief.biases)[POSE, POSE] + frame.root @ frame.root.T
    off = wrapped(frame.pose - belief.motion.mean[POSE])
    white, _ = lapack.dtrtrs(lapack.dpotrf(spread, lower=1)[0], off, lower=1)
    return float(np.linalg.norm(white))


def _split(root: Array, slopes: Array, others: Array) -> tuple[Array, Array]:
    """Return slopes of a pose's errors by others of that covariance, and the root of the rest.

    The slopes are scaled down where that would be more of a variance than `MOST_COMMON`.
    """
    common = solve_triangular(root, slopes @ np.linalg.cholesky(others), lower=True)
    spread = common @ common.T
    share = min(1.0, MOST_COMMON / max(np.linalg.eigvalsh(spread)[-1], MOST_COMMON))
    rest = root @ np.linalg.cholesky(np.eye(5) - share * spread)
    return math.sqrt(share) * slopes, rest
