"""A track's state corrected by a frame: by its pose, or by its readings.

Readings are corrected in coordinates in which images stay linear (`joint_coordinates`), and
linearised once more midway between where the track was and where the frame takes it: of a light
that bends evenly that is the secant, while slopes at either end pull what is learnt to one side.
"""

import math

import numpy as np

from uuv_optical_array.core.geometry import Array, wrapped
from uuv_optical_array.estimation.constants import Constants
from uuv_optical_array.estimation.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.frame import Frame, Relinearise, checked_readings
from uuv_optical_array.estimation.tracking.joint_coordinates import AsTheyAre, JointCoordinates
from uuv_optical_array.estimation.tracking.root_filter import Belief, Reading, correct
from uuv_optical_array.estimation.tracking.state import MOVING, StateSpace
from uuv_optical_array.estimation.tracking.track import POSE

# Most of a shaded pose's variance that lasts: the rest lets the track follow.
MOST_LASTING = 0.9


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

    def errors(self, frame: Frame) -> tuple[Array, Array]:
        """Return roots of what is new in a pose's errors, and of what shades leave there.

        The first has the shape ``(5, 5)``; the second, by the states of the shades, ``(5, 0)`` or
        ``(5, 5)``.
        """
        shades = self._space.shades.stop - self._space.shades.start
        share = MOST_LASTING * frame.lasting if shades else 0.0
        root = self._own_share * frame.root
        return math.sqrt(1 - share) * root, math.sqrt(share) * root[:, :shades]

    def by_frame(self, belief: Belief, frame: Frame, learns: bool) -> tuple[Belief, float]:
        """Return a belief corrected by a frame, and the distance of the frame from it.

        Constants and gain errors are corrected only where it `learns`.
        """
        learnt = self._space.gains.stop if learns else MOVING
        if frame.readings is None:
            belief, distance = self._by_pose(belief, frame, learnt)
        else:
            belief, distance = self._by_readings(belief, frame.readings, frame.relinearise, learnt)
        return belief._replace(mean=wrapped(belief.mean)), distance

    def _by_pose(self, belief: Belief, frame: Frame, learnt: int) -> tuple[Belief, float]:
        own, lasts = self.errors(frame)
        slopes = np.eye(5, self._space.size)
        slopes[:, self._space.shades] = lasts
        off = wrapped(frame.pose - belief.mean[POSE])
        return correct(belief, Reading(off, slopes, own, np.zeros(0)), learnt)

    def _by_readings(
        self,
        belief: Belief,
        readings: LinearisedReadings,
        relinearise: Relinearise | None,
        learnt: int,
    ) -> tuple[Belief, float]:
        entries, coordinates = self._space.linear, self._coordinates
        here = coordinates.of(belief.mean[entries])
        _, slopes = coordinates.place(here)
        before = _turned(belief, entries, np.asarray(np.linalg.inv(slopes)), here)
        at = coordinates.of(readings.at)
        _, slopes = coordinates.place(at)
        reading = self._reading(before, readings, at, slopes)
        after, distance = correct(before, reading, learnt)
        # What is beyond the gate is no frame of this track, wherever it is linearised.
        if relinearise and distance <= self._gate:
            step = coordinates.difference(after.mean[entries], before.mean[entries])
            midway = before.mean[entries] + 0.5 * step
            place, slopes = coordinates.place(midway)
            again = checked_readings(relinearise(place), self._constants)
            after, _ = correct(before, self._reading(before, again, midway, slopes), learnt)
        place, slopes = coordinates.place(after.mean[entries])
        return _turned(after, entries, slopes, place), distance

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
        light = np.where(says, readings.light, 0.0)
        by_state = np.zeros((len(says), self._space.size))
        by_state[:, self._space.linear] = np.where(says[:, None], slopes, 0.0)
        residual = np.where(says, readings.residuals, 0.0) - by_state[:, self._space.linear] @ off
        gains = self._space.gains
        if gains.stop > gains.start:
            by_state[:, gains] = np.diag(light)
            residual -= light * belief.mean[gains]
        noise = np.diag(np.sqrt(np.where(says, readings.variances, 1.0)))
        spoilt = self._constants.gain_std * light if self._space.spoilt else np.zeros(0)
        return Reading(residual, by_state, noise, spoilt)


def _turned(belief: Belief, entries: list[int], slopes: Array, place: Array) -> Belief:
    """Return a belief of which some entries are given in other coordinates, by their slopes."""
    mean, root, shared = (part.copy() for part in belief)
    mean[entries] = place
    root[entries] = slopes @ root[entries]
    shared[entries] = slopes @ shared[entries]
    return Belief(mean, root, shared)
