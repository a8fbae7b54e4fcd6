"""A track's belief corrected by a frame: by its readings, or where there are none by its pose.

Readings are applied in coordinates in which images stay linear (`joint_coordinates`), and are
linearised once more on the way from the predicted pose to the corrected one (`RELINEARISE_AT`).
Slopes at its end contain the noise of the readings that they weight, those at its beginning lack
the curvature of the light: either biases what is learnt, the same in each frame. This is the way of
the five numbers that depend on the pose. It begins at the image's own fit, or, for an image that is
not linear about its fit, where the track expects them. Such an image bends over what the track
leaves of the pose, and counts to the second order (`second_order`).

What readings say of the biases alone must agree with the biases. An image that is not of the scene,
such as one of two lamps, may agree with the pose, and would teach errors that last for hours: it
changes nothing.

A pose without readings is an observation of the pose itself. Its errors are noise, but for a share
that all frames have in common, which stays out of the belief; poses in uneven light weigh less.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack, solve_triangular
from scipy.special import chdtri

from uuv_optical_array.core.geometry import Array, wrapped
from uuv_optical_array.core.numerics.linear_algebra import orthonormal, solve, triangular_factor
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import (
    PLACE_S,
    STATE,
    Belief,
    BiasSpace,
    Observation,
    correct,
    cost,
    weigh,
)
from uuv_optical_array.estimation.tracking.measurement import Measurement
from uuv_optical_array.estimation.tracking.ranges import ALIKE_S
from uuv_optical_array.estimation.tracking.second_order import SecondOrder, second_order
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import POSE
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.estimation.unknowns.joint_coordinates import JointCoordinates

# Where constants are not known, what makes poses without readings broad is mostly the constants and
# the shape of their posterior, not noise, and that is the same in all frames.
BROAD_SHARE = 0.75
# Errors of poses in uneven light are correlated: these count as one in this time, s. Where the
# scene does not name what shades them, their variance is multiplied by this factor.
UNEVEN_S, UNNAMED_DOUBT = 0.7, 7.0
# Significance level of what readings say of the biases. Light that is not linear and differences
# within a block of detectors make distances a tenth longer than those of the level 1e-4.
UNLIKE = 1e-9
# Place of the second linearisation, as a share of the correction: there the biases by noise and by
# curvature are least in drives of 20 minutes through seas drawn from the prior.
RELINEARISE_AT = 0.25


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
            belief.mean[POSE] = wrapped(belief.mean[POSE])
            self._belief = belief
        assert self._belief is not None
        return self._belief


class Corrected(NamedTuple):
    """A belief corrected by a frame, and the frame's distance, and its `cost`.

    The cost is computed for few frames only, as it needs all of their readings.
    """

    belief: Deferred
    distance: float
    cost: Callable[[], float]


class Correction:
    """Corrects beliefs by frames; beyond the distance `gate` readings are linearised only once."""

    def __init__(
        self, space: BiasSpace, constants: Constants, settings: TrackerSettings, gate: float
    ) -> None:
        self._space, self._constants = space, constants
        self._coordinates = JointCoordinates(constants.frame, constants.names)
        self._settings, self._gate = settings, gate

    def common_share(self, frame: Measurement) -> float:
        """Return the share of the variance of a frame's pose that all frames have in common."""
        broad = self._constants.names and not frame.uneven
        return max(self._settings.common_share, BROAD_SHARE if broad else 0.0)

    def readings(self, belief: Belief, frame: Measurement) -> LinearisedReadings | None:
        """Return a frame's readings, linear about its fit, or else where the belief expects it."""
        if not frame.bent:
            return frame.readings
        at = np.concatenate([belief.mean[POSE], self._space.offsets(belief)])
        return frame.near(at, self._constants)

    def correct(
        self,
        belief: Belief,
        frame: Measurement,
        readings: LinearisedReadings | None,
        step_s: float,
    ) -> Corrected:
        """Return a belief corrected by a frame, by its readings or its pose.

        - step_s: time since the last frame that corrected anything, s.
        """
        if readings is None:
            observation = self._of_pose(belief, frame, step_s)
            corrected = Deferred(lambda: correct(belief, observation))
            distance, _ = weigh(belief.covariance, observation)
            return Corrected(corrected, distance, lambda: cost(belief.covariance, observation))
        result = self._by_readings(belief, frame, readings, step_s)
        distance = max(result.distance, pose_distance(belief, frame))
        return result._replace(distance=distance)

    def bent_covariance(self, belief: Belief, stamp_ns: int) -> Array:
        """Return what the bend of the straight coordinates adds to the pose's covariance, (5, 5).

        It is not in the belief, which is Gaussian in those coordinates. Where ranges were used
        shortly before a stamp, ns, it adds nothing along the line of sight.
        """
        straight, at = self._straight(belief)

        def slopes_at(pose: Array) -> Array:
            return self._coordinates.place(np.concatenate([pose, at[5:]]))[1][POSE, POSE]

        modes = second_order(slopes_at, straight.mean[POSE], straight.covariance[POSE, POSE]).modes
        if stamp_ns - belief.ranged_ns < ALIKE_S * 1e9:
            place = belief.mean[:3]
            modes[:3] -= np.outer(place, place @ modes[:3]) / (place @ place)
        return modes @ modes.T

    def begun(self, belief: Belief, frame: Measurement) -> Belief:
        """Return a belief of biases, and a rate, that begins with a frame's pose or readings."""
        mean, covariance = belief.mean.copy(), belief.covariance.copy()
        if frame.readings is not None:
            mean[POSE] = frame.readings.at[:5]
            begun = belief._replace(mean=mean)
            return self._by_readings(begun, frame, frame.readings, math.inf).belief()
        root = self._white_root(frame, math.inf)
        mean[POSE], covariance[POSE, POSE] = frame.pose, root @ root.T
        return belief._replace(mean=mean, covariance=covariance)

    def _of_pose(self, belief: Belief, frame: Measurement, step_s: float) -> Observation:
        """Return what a frame's pose says."""
        root = self._white_root(frame, step_s)
        off, slopes = wrapped(frame.pose - belief.mean[POSE]), np.eye(5, len(belief.mean))
        white = solve_triangular(root, np.column_stack([off, slopes]), lower=True)
        return Observation(white[:, 0], white[:, 1:])

    def _white_root(self, frame: Measurement, step_s: float) -> Array:
        """Return the lower root of the covariance of the new errors of a frame's pose."""
        variance = 1 - self.common_share(frame)
        if frame.uneven:
            doubt = 1.0 if self._constants.names_shades else UNNAMED_DOUBT
            variance *= doubt * max(1.0, UNEVEN_S / step_s)
        return math.sqrt(variance) * frame.root

    def _by_readings(
        self,
        belief: Belief,
        frame: Measurement,
        readings: LinearisedReadings,
        step_s: float,
    ) -> Corrected:
        """Weigh a frame by its readings; the belief that they correct is left for later.

        The first of a track, to which the step is infinite, is accepted, as its fit was, and stays
        linear at that: far from it, as at the prior's constants, readings mislead.
        """
        begins, alike = step_s == math.inf, max(1.0, PLACE_S / step_s)
        before, expected = self._straight(belief)
        bend = self._bend(before, expected, frame) if frame.bent else None
        rows = self._rows(before, expected, bend, readings)
        distance, shift = weigh(before.covariance, self._of_pose_alone(rows))

        def cost_of_all() -> float:
            return cost(before.covariance, self._observation(triangular_factor(rows)))

        def finished() -> Belief:
            near = None
            # A frame beyond the gate is not of this track, wherever it is linearised.
            if frame.relinearise and not begins and distance <= self._gate:
                further = expected.copy()
                further[POSE] += RELINEARISE_AT * shift[POSE]
                near = frame.near(self._coordinates.place(further)[0], self._constants)
            used = readings if near is None else near
            # Turned so that each number depends on one error fewer than the one before it.
            turned = triangular_factor(self._rows(before, expected, bend, used))
            of_biases = slice(5, 5 + self._space.count)
            # By the noise of this frame: with that of a lesson the light of two lamps agrees.
            if not (begins or self._explained(before, self._observation(turned[of_biases]))):
                return belief._replace(unlike=belief.unlike + 1)
            lesson = triangular_factor(self._rows(before, expected, bend, used, alike))
            taught = correct(before, self._observation(lesson[of_biases]))
            of_pose = self._observation(turned[:5])
            left = of_pose.innovation - of_pose.slopes @ (taught.mean - before.mean)
            of_pose = of_pose._replace(innovation=left)
            return self._curved(correct(taught, of_pose, teach=False))._replace(unlike=0)

        return Corrected(Deferred(finished), distance, cost_of_all)

    def _bend(self, straight: Belief, expected: Array, frame: Measurement) -> SecondOrder | None:
        """Return how the light of a frame bends over a belief; None where that is not finite."""
        relinearise = frame.relinearise
        assert relinearise is not None

        def slopes_at(pose: Array) -> Array:
            place, by = self._coordinates.place(np.concatenate([pose, expected[5:]]))
            return relinearise(place).slopes @ by[:, POSE]

        with np.errstate(over="ignore", invalid="ignore"):
            bend = second_order(slopes_at, straight.mean[POSE], straight.covariance[POSE, POSE])
        return bend if np.isfinite(bend.modes).all() else None

    def _rows(
        self,
        straight: Belief,
        expected: Array,
        bend: SecondOrder | None,
        readings: LinearisedReadings,
        alike: float = 1.0,
    ) -> Array:
        """Return slopes and innovations of readings, as `BiasSpace.whitened` has the residuals.

        - straight, expected: the belief, and its pose and constants, in straight coordinates.
        - bend: of the light; ``None``: it is linear.
        - alike: how many frames share the errors of their place.
        """
        space, of, modes = self._space, self._space.constants, None
        if bend is not None:
            readings = readings._replace(residuals=readings.residuals - bend.shift)
            modes = bend.modes
        at, by = self._coordinates.of(readings.at)
        whole = space.whitened(readings, readings.slopes @ by, modes, alike)
        off = self._coordinates.difference(expected, at)
        errors = straight.mean[STATE:-1].copy()
        errors[of] = off[5:] / space.stds[of]
        whole[:, -1] -= whole[:, :-1] @ np.concatenate([off[:5], errors])
        return whole

    def _observation(self, turned: Array) -> Observation:
        """Return what readings say, by combinations of their `_rows`."""
        return Observation(turned[:, -1], turned[:, :-1] @ self._space.by_state)

    def _of_pose_alone(self, rows: Array) -> Observation:
        """Return what of readings depends on the pose, and on biases, five numbers."""
        return self._observation(orthonormal(rows[:, :5]).T @ rows)

    def _explained(self, belief: Belief, of_biases: Observation) -> bool:
        """Say whether readings agree with the biases, whatever the pose."""
        count = len(of_biases.innovation)
        if not count:
            return True
        distance, _ = weigh(belief.covariance, of_biases)
        return distance**2 <= chdtri(count, UNLIKE)

    def _straight(self, belief: Belief) -> tuple[Belief, Array]:
        """Return a belief with the pose in straight coordinates, and pose and constants in them."""
        at = np.concatenate([belief.mean[POSE], self._space.offsets(belief)])
        here, by = self._coordinates.of(at)
        back = solve(by[:5, :5], np.eye(5))
        return self._turned(belief, here[:5], back, -back @ by[:5, 5:]), here

    def _curved(self, belief: Belief) -> Belief:
        """Return a belief with the pose in m and rad again."""
        at = np.concatenate([belief.mean[POSE], self._space.offsets(belief)])
        place, by = self._coordinates.place(at)
        return self._turned(belief, place[:5], by[:5, :5], by[:5, 5:])

    def _turned(self, belief: Belief, pose: Array, by_pose: Array, by_constants: Array) -> Belief:
        """Return a belief in other coordinates of the pose, by their slopes."""
        mean, covariance = belief.mean.copy(), belief.covariance.copy()
        slopes = np.zeros((5, len(mean)))
        slopes[:, POSE], slopes[:, STATE:] = by_pose, by_constants @ self._space.by_offsets
        rows = slopes @ belief.covariance
        covariance[POSE], covariance[:, POSE] = rows, rows.T
        covariance[POSE, POSE] = rows @ slopes.T
        mean[POSE] = pose
        return belief._replace(mean=mean, covariance=covariance)


def pose_distance(belief: Belief, frame: Measurement) -> float:
    """Return the distance of a frame's pose from a belief.

    Readings, which are linear near that pose, say little of a pose far from it. Both poses err by
    the same constants, so that the distance is rather too small.
    """
    spread = belief.covariance[POSE, POSE] + frame.root @ frame.root.T
    off = wrapped(frame.pose - belief.mean[POSE])
    white, _ = lapack.dtrtrs(lapack.dpotrf(spread, lower=1)[0], off, lower=1)
    return math.sqrt(white @ white)
