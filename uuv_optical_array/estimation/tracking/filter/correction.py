"""A track's state corrected by a frame: by its pose, or by its readings.

Readings are corrected in coordinates in which images stay linear (`joint_coordinates`), and
linearised once more on the way from where the track was to where the frame takes it (`ONWARD`).
Slopes at the end of the way have the noise of the readings that they weigh, those at its beginning
leave out the bend of the light: either pulls what is learnt to one side, the same in each frame.
"""

import math
from collections.abc import Callable
from contextlib import suppress

import numpy as np
from scipy.linalg import solve_triangular

from uuv_optical_array.core.geometry import Array, wrapped
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.filter.frame import Frame, Relinearise, checked_readings
from uuv_optical_array.estimation.tracking.filter.root_filter import (
    Belief,
    Reading,
    correct,
    triangular,
    weigh,
)
from uuv_optical_array.estimation.tracking.filter.state import MOVING, StateSpace
from uuv_optical_array.estimation.tracking.track import POSE
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.estimation.unknowns.joint_coordinates import AsTheyAre, JointCoordinates
from uuv_optical_array.forward.prior import SHADE_DOUBT

# Of a shaded pose's variance the doubt is new in each frame. Most of the rest lasts as the shade
# does, and what is left lets the track follow.
MOST_LASTING = 0.9 / SHADE_DOUBT
# The doubt of frames that follow each other is alike: as much is new as in so many times fewer.
DOUBTS_ALIKE = 4.0
# Most of a pose's variance in any direction that it has of the constants' errors.
MOST_COMMON = 0.9
# Of the way to where a frame takes the track: at this share the pulls of noise and bend are least
# in drives of 20 minutes through seas drawn from the prior.
ONWARD = 0.25


class Corrected:
    """A belief corrected by a frame, which is worked out when it is first asked for.

    Whether a frame is in the track is known before that, and its pose need not wait for the rest.
    """

    def __init__(self, work: Callable[[], Belief]) -> None:
        self._work: Callable[[], Belief] | None = work
        self._belief: Belief | None = None

    def __call__(self) -> Belief:
        """Return the belief."""
        if self._work is not None:
            belief, self._work = self._work(), None
            self._belief = belief._replace(mean=wrapped(belief.mean))
        assert self._belief is not None
        return self._belief


class Correction:
    """Corrects beliefs by frames.

    Parameters
    ----------
    space
        Of the state.
    constants
        What is not known of the scene.
    """

    def __init__(self, space: StateSpace, constants: Constants) -> None:
        c, self._space = constants, space
        self._constants = constants
        self._coordinates = JointCoordinates(c.frame, c.names) if c.frame else AsTheyAre()

    def configure(self, common_share: float, gate: float) -> None:
        """Use other settings from now on.

        Parameters
        ----------
        common_share
            Of a pose's variance, that all frames have in common, in [0, 1).
        gate
            Distance beyond which readings are not linearised once more.
        """
        self._own_share, self._gate = math.sqrt(1 - common_share), gate

    def errors(self, belief: Belief, frame: Frame) -> tuple[Array, Array]:
        """Return what is new in a pose's errors, and how the rest follows from what lasts.

        Parameters
        ----------
        belief
            Before the frame.
        frame
            One that its pose stands for.

        Returns
        -------
        root
            Of the covariance of what is new, shape ``(5, 5)``.
        slopes
            Of the pose as it is measured, by the whole state, shape ``(5, size)``.
        """
        of, shades = self._space.constants, self._space.shades
        slopes, root = np.eye(5, self._space.size), frame.root
        if of.stop > of.start:
            # The fit took the constants as they are believed to be: where they are not, another
            # range is as bright.
            at = np.concatenate([frame.pose, belief.mean[of]])
            _, by_coordinates = self._coordinates.place(self._coordinates.of(at))
            theirs = belief.whole_root[of]
            slopes[:, of], root = _parted(root, -by_coordinates[:5, 5:], theirs)
        if shades.stop > shades.start:
            share = MOST_LASTING * frame.lasting
            new = (1 - share) * (1 + (DOUBTS_ALIKE - 1) * frame.lasting)
            slopes[:, shades], root = math.sqrt(share) * root, math.sqrt(new) * root
        return self._own_share * root, slopes

    def by_frame(self, belief: Belief, frame: Frame, learns: bool) -> tuple[Corrected, float]:
        """Return a belief corrected by a frame, and the distance of the frame from it.

        Constants and gain errors are corrected only where it `learns`, and by readings.
        """
        if frame.readings is None:
            return self._by_pose(belief, frame)
        learnt = self._space.gains.stop if learns else MOVING
        corrected, distance = self._by_readings(belief, frame.readings, frame.relinearise, learnt)
        return corrected, max(distance, _apart(belief, frame))

    def _by_pose(self, belief: Belief, frame: Frame) -> tuple[Corrected, float]:
        own, slopes = self.errors(belief, frame)
        off = wrapped(frame.pose - belief.mean[POSE])
        white = solve_triangular(own, np.column_stack([off, slopes]), lower=True)
        reading = Reading(white[:, 0], white[:, 1:], np.ones(5), np.zeros(0))
        gain, distance = weigh(belief, reading, MOVING)
        return Corrected(lambda: correct(belief, reading, gain())), distance

    def _by_readings(
        self,
        belief: Belief,
        readings: LinearisedReadings,
        relinearise: Relinearise | None,
        learnt: int,
    ) -> tuple[Corrected, float]:
        space, coordinates = self._space, self._coordinates
        here = coordinates.of(belief.mean[space.linear])
        _, slopes = coordinates.place(here)
        before = self._turned(belief, np.asarray(np.linalg.inv(slopes)), here)
        at = coordinates.of(readings.at)
        _, slopes = coordinates.place(at)
        reading = self._reading(before, readings, at, slopes)
        gain, distance = weigh(before, reading, learnt)
        # What is beyond the gate is no frame of this track, wherever it is linearised.
        again = relinearise if distance <= self._gate else None
        return Corrected(lambda: self._finished(before, reading, gain(), again)), distance

    def _finished(
        self, before: Belief, reading: Reading, gain: Array, relinearise: Relinearise | None
    ) -> Belief:
        """Return a belief corrected by readings, which are linearised once more."""
        space, coordinates, learnt = self._space, self._coordinates, len(gain)
        if relinearise:
            step = np.zeros(space.size)
            step[:learnt] = gain @ reading.residual
            there = before.mean[space.linear] + ONWARD * step[space.linear]
            place, slopes = coordinates.place(there)
            with suppress(ValueError):  # not finite there: the first slopes have to do
                again = checked_readings(relinearise(place), self._constants)
                reading = self._reading(before, again, there, slopes)
                gain = weigh(before, reading, learnt)[0]()
        after = correct(before, reading, gain)
        place, slopes = coordinates.place(after.mean[space.linear])
        return self._turned(after, slopes, place)

    def _turned(self, belief: Belief, slopes: Array, place: Array) -> Belief:
        """Return a belief of which pose and constants are given in other coordinates.

        In all of them the constants are the same.
        """
        mean, root, shared = (part.copy() for part in belief)
        mean[self._space.linear] = place
        for part in (root, shared):
            part[POSE] = slopes[:5] @ part[self._space.linear]
        return Belief(mean, root, shared)

    def _reading(
        self, belief: Belief, readings: LinearisedReadings, at: Array, by_coordinates: Array
    ) -> Reading:
        """Return readings as the filter takes them, by the state in its coordinates.

        They were linearised at the coordinates `at`, by which pose and constants have the given
        slopes.
        """
        off = self._coordinates.difference(belief.mean[self._space.linear], at)
        slopes = readings.slopes @ by_coordinates
        # A reading that says nothing is one that nothing moves.
        says = np.isfinite(readings.variances)
        residual = says * (readings.residuals - slopes @ off)
        slopes, light = says[:, None] * slopes, says * readings.light
        by_state = np.zeros((len(says), self._space.size))
        by_state[:, POSE], by_state[:, self._space.constants] = slopes[:, POSE], slopes[:, 5:]
        gains = self._space.gains
        if gains.stop > gains.start:
            by_state[:, gains] = np.diag(light)
            residual -= light * belief.mean[gains]
        noise = np.sqrt(np.where(says, readings.variances, 1.0))
        spoilt = self._constants.gain_std * light if self._space.spoilt else np.zeros(0)
        return Reading(residual, by_state, noise, spoilt)


def _apart(belief: Belief, frame: Frame) -> float:
    """Return the distance of a frame's pose from a belief.

    Readings, which are linear near that pose, say little of a belief far from it. Both poses are
    wrong by the same constants, so that the distance is rather too small.
    """
    root = triangular(np.concatenate([belief.whole_root[POSE], frame.root], axis=1))
    return float(np.linalg.norm(solve_triangular(root, wrapped(frame.pose - belief.mean[POSE]))))


def _parted(root: Array, slopes: Array, theirs: Array) -> tuple[Array, Array]:
    """Return slopes of a pose's errors by others, of the root `theirs`, and the root of the rest.

    The slopes are scaled down where that would be more of a variance than `MOST_COMMON`.
    """
    common = solve_triangular(root, slopes @ theirs, lower=True)
    spread = common @ common.T
    share = min(1.0, MOST_COMMON / max(np.linalg.eigvalsh(spread)[-1], MOST_COMMON))
    left = root @ np.linalg.cholesky(np.eye(5) - share * spread)
    return math.sqrt(share) * slopes, left
