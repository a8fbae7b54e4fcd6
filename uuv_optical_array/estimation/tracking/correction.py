"""A track's state corrected by a frame: by its pose, or by its readings.

Readings are applied in coordinates in which images stay linear (`joint_coordinates`), and are
linearised once more on the way from the predicted state to the corrected one (`RELINEARISE_AT`).
Slopes at the end of that way have the noise of the readings that they weigh, those at its beginning
leave out the curvature of the light: either biases what is learnt, the same in each frame.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from uuv_optical_array.core.geometry import Array, wrapped
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.measurement import (
    Measurement,
    Relinearise,
    checked_readings,
)
from uuv_optical_array.estimation.tracking.root_filter import (
    Gaussian,
    Observation,
    correct,
    triangular,
    weigh,
)
from uuv_optical_array.estimation.tracking.state import SLOW, StateSpace
from uuv_optical_array.estimation.tracking.track import POSE
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.estimation.unknowns.joint_coordinates import AsTheyAre, JointCoordinates
from uuv_optical_array.forward.prior import SHADE_DOUBT

# A shaded pose has SHADE_DOUBT times the variance of a clear one. This share of it is one error for
# as long as the shade lasts; the rest is white, so that the track follows the motion.
SHADE_SHARE = 0.9 / SHADE_DOUBT
# The white rest is alike in consecutive frames: this many count as one.
CORRELATED_FRAMES = 4.0
# Largest share of a pose's variance, in any direction, that is ascribed to the constants' errors.
MOST_COMMON = 0.9
# Place of the second linearisation, as a share of the correction: there the biases by noise and by
# curvature are least in drives of 20 minutes through seas drawn from the prior.
RELINEARISE_AT = 0.25


class Deferred:
    """A corrected state that is computed when it is first asked for.

    Whether a frame passes the gate is known before, and its pose need not wait for the rest.
    """

    def __init__(self, compute: Callable[[], Gaussian]) -> None:
        self._compute: Callable[[], Gaussian] | None = compute
        self._state: Gaussian | None = None

    def __call__(self) -> Gaussian:
        """Return the state."""
        if self._compute is not None:
            state, self._compute = self._compute(), None
            self._state = state._replace(mean=wrapped(state.mean))
        assert self._state is not None
        return self._state


class Corrected(NamedTuple):
    """A state corrected by a frame, and distance and cost of the frame as `weigh` returns them."""

    state: Deferred
    distance: float
    cost: float = 0.0


class Correction:
    """Corrects states by frames.

    - space: of the state.
    - constants: what is not known of the scene.
    - common_share: of a pose's variance, that all frames have in common, in [0, 1).
    - gate: distance beyond which readings are not linearised once more.
    """

    def __init__(
        self, space: StateSpace, constants: Constants, common_share: float, gate: float
    ) -> None:
        c, self._space = constants, space
        self._constants = constants
        self._coordinates = JointCoordinates(c.frame, c.names) if c.frame else AsTheyAre()
        self._white_share, self._gate = math.sqrt(1 - common_share), gate

    def pose_errors(self, state: Gaussian, frame: Measurement) -> tuple[Array, Array]:
        """Return how the pose of a frame depends on the state, and its white errors.

        - state: before the frame.
        - frame: of which the pose is used.
        - returned root: of the covariance of the white errors, shape ``(5, 5)``.
        - returned slopes: of the measured pose by the whole state, shape ``(5, size)``.
        """
        of, shades = self._space.constants, self._space.shades
        slopes, root = np.eye(5, self._space.size), frame.root
        if of.stop > of.start:
            # The fit assumed the expected constants: with others, another range is as bright.
            at = np.concatenate([frame.pose, state.mean[of]])
            _, by_coordinates = self._coordinates.place(self._coordinates.of(at))
            slopes[:, of], root = _split(root, -by_coordinates[:5, 5:], state.full_root[of])
        if shades.stop > shades.start:
            share = SHADE_SHARE * frame.shaded
            white = (1 - share) * (1 + (CORRELATED_FRAMES - 1) * frame.shaded)
            slopes[:, shades], root = math.sqrt(share) * root, math.sqrt(white) * root
        return self._white_share * root, slopes

    def correct(self, state: Gaussian, frame: Measurement, learns: bool) -> Corrected:
        """Return a state corrected by a frame.

        Constants and gain errors are corrected only where it `learns`, and by readings.
        """
        if frame.readings is None:
            return self._by_pose(state, frame)
        corrected = self._space.gains.stop if learns else SLOW
        result = self._by_readings(state, frame.readings, frame.relinearise, corrected)
        return result._replace(distance=max(result.distance, pose_distance(state, frame)))

    def _by_pose(self, state: Gaussian, frame: Measurement) -> Corrected:
        root, slopes = self.pose_errors(state, frame)
        innovation = wrapped(frame.pose - state.mean[POSE])
        white = solve_triangular(root, np.column_stack([innovation, slopes]), lower=True)
        observation = Observation(white[:, 0], white[:, 1:], np.ones(5), np.zeros(0))
        gain, *fit = weigh(state, observation, SLOW)
        return Corrected(Deferred(lambda: correct(state, observation, gain())), *fit)

    def _by_readings(
        self,
        state: Gaussian,
        readings: LinearisedReadings,
        relinearise: Relinearise | None,
        corrected: int,
    ) -> Corrected:
        coordinates, linear = self._coordinates, self._space.linear
        here = coordinates.of(state.mean[linear])
        _, slopes = coordinates.place(here)
        before = self._transformed(state, np.asarray(np.linalg.inv(slopes)), here)
        at = coordinates.of(readings.at)
        _, slopes = coordinates.place(at)
        observation = self._observation(before, readings, at, slopes)
        gain_of, distance, cost = weigh(before, observation, corrected)

        def finished() -> Gaussian:
            used, gain = observation, gain_of()
            # A frame beyond the gate is not of this track, wherever it is linearised.
            if relinearise and distance <= self._gate:
                step = np.zeros(self._space.size)
                step[:corrected] = gain @ used.innovation
                there = before.mean[linear] + RELINEARISE_AT * step[linear]
                place, slopes = coordinates.place(there)
                with suppress(ValueError):  # not finite there: the first slopes are used
                    again = checked_readings(relinearise(place), self._constants)
                    used = self._observation(before, again, there, slopes)
                    gain = weigh(before, used, corrected)[0]()
            after = correct(before, used, gain)
            place, slopes = coordinates.place(after.mean[linear])
            return self._transformed(after, slopes, place)

        return Corrected(Deferred(finished), distance, cost)

    def _transformed(self, state: Gaussian, slopes: Array, place: Array) -> Gaussian:
        """Return a state whose pose is in other coordinates; the constants are the same in all."""
        mean, root, consider = (part.copy() for part in state)
        mean[self._space.linear] = place
        for part in (root, consider):
            part[POSE] = slopes[:5] @ part[self._space.linear]
        return Gaussian(mean, root, consider)

    def _observation(
        self, state: Gaussian, readings: LinearisedReadings, at: Array, by_coordinates: Array
    ) -> Observation:
        """Return readings that were linearised at some coordinates as an observation of a state."""
        space = self._space
        off = self._coordinates.difference(state.mean[space.linear], at)
        slopes = readings.slopes @ by_coordinates
        # A reading of infinite variance becomes one that depends on nothing.
        valid = np.isfinite(readings.variances)
        innovation = valid * (readings.residuals - slopes @ off)
        slopes, light = valid[:, None] * slopes, valid * readings.light
        by_state = np.zeros((len(valid), space.size))
        by_state[:, POSE], by_state[:, space.constants] = slopes[:, POSE], slopes[:, 5:]
        if space.gains.stop > space.gains.start:
            by_gains = light[:, None] * self._constants.by_detector
            by_state[:, space.gains] = by_gains
            innovation -= by_gains @ state.mean[space.gains]
        noise = np.sqrt(np.where(valid, readings.variances, 1.0))
        consider = self._constants.gain_std * light if space.consider else np.zeros(0)
        return Observation(innovation, by_state, noise, consider)


def pose_distance(state: Gaussian, frame: Measurement) -> float:
    """Return the distance of a frame's pose from a state.

    Readings, which are linear near that pose, say little of a state far from it. Both poses err by
    the same constants, so that the distance is rather too small.
    """
    root = triangular(np.concatenate([state.full_root[POSE], frame.root], axis=1))
    return float(np.linalg.norm(solve_triangular(root, wrapped(frame.pose - state.mean[POSE]))))


def _split(root: Array, slopes: Array, others: Array) -> tuple[Array, Array]:
    """Return slopes of a pose's errors by others, of the root `others`, and the root of the rest.

    The slopes are scaled down where that would be more of a variance than `MOST_COMMON`.
    """
    common = solve_triangular(root, slopes @ others, lower=True)
    spread = common @ common.T
    share = min(1.0, MOST_COMMON / max(np.linalg.eigvalsh(spread)[-1], MOST_COMMON))
    rest = root @ np.linalg.cholesky(np.eye(5) - share * spread)
    return math.sqrt(share) * slopes, rest
