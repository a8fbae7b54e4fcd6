"""One step of the track's filter: predict by the motion, correct by a frame, tell what happened.

- **Predict** (R. E. Kalman, *J. Basic Engineering* 82, 1960, 35): pose += step * rate, plus the
  commanded way; the rate walks at random, and the biases drift (`motion`, `belief`).
- **Correct** by the readings of the frame, or without any by its pose (`correction`).
- **Tell what happened.** Now and then the rate or the constants change suddenly. A frame that the
  usual motion hardly explains is also tried as the first after a manoeuvre, and after a jump that
  makes the constants the prior's again. The likeliest by the density of the innovation times the
  prior probability of the event is taken (Y. Bar-Shalom, X.-R. Li and T. Kirubarajan, *Estimation
  with Applications to Tracking and Navigation*, 2001, ch. 11). If no event explains it while the
  commands are obeyed, they count as not obeyed.
- A frame whose Mahalanobis distance is beyond the gate in any case is an **outlier**. The last of
  so many in a row restarts the track, which then knows nothing of the constants. So does the frame
  after as many whose readings agree with the pose but not with the biases.

Poses without readings do not say which part of their errors the constants make. So a track that
began with readings leaves them out, unless uneven light is the cause; a track of poses restarts
with the first readings.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.core.geometry import Array, wrapped
from uuv_optical_array.estimation.tracking.belief import STATE, Belief, BiasSpace
from uuv_optical_array.estimation.tracking.correction import (
    Corrected,
    Correction,
    Deferred,
    pose_distance,
)
from uuv_optical_array.estimation.tracking.measurement import Measurement
from uuv_optical_array.estimation.tracking.motion import (
    RATE_STD,
    OwnMotion,
    in_beacon,
    swing,
    walk_noise,
)
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import POSE, RATE, OwnMotionIs
from uuv_optical_array.estimation.unknowns.constants import Constants

POSE_STD = np.array([100.0, 100.0, 100.0, 10.0, 10.0])  # m and rad, of an unknown pose
# A manoeuvre changes the rate by so much from one frame to the next, m/s and rad/s.
MANOEUVRE_STD = np.array([0.2, 0.2, 0.2, 0.3, 0.3])
# Events from a frame to the next, and their share of frames; constants jump, for example, when a
# lamp is dimmed.
Event = Literal["usual", "manoeuvre", "jump"]
SHARES: dict[Event, float] = {"usual": 1.0, "manoeuvre": 1e-2, "jump": 1e-4}


@dataclass(frozen=True)
class State:
    """The track after a frame.

    - newest: the newest frame of all, which may be an outlier.
    - frame: the newest in the track.
    - corrected: the belief corrected by that frame.
    - own_motion: whether the commands are obeyed; if "told", the rate is that of the leader.
    - taken_ns: stamp of the newest frame that corrected anything, ns.
    - by_readings: whether any frame came with readings.
    - frames: how many corrected it since it began.
    - distance: Mahalanobis distance of `frame` from its prediction.
    - outliers, outlier: how many in a row came since `frame`; distance of `newest`, if it is one.
    """

    newest: Measurement
    frame: Measurement
    corrected: Deferred
    own_motion: OwnMotionIs
    taken_ns: int
    by_readings: bool
    frames: int = 1
    distance: float = 0.0
    outliers: int = 0
    outlier: float = 0.0


class FrameFilter:
    """Takes a track from frame to frame.

    - own_motion: the commands of the follower, which others may add to.
    - walk: standard deviations of the change of the rate in 1 s, m/s and rad/s, shape ``(5,)``.
    - gate: Mahalanobis distance beyond which a frame is an outlier.
    """

    def __init__(
        self,
        settings: TrackerSettings,
        constants: Constants,
        space: BiasSpace,
        own_motion: OwnMotion,
    ) -> None:
        s = settings
        self._settings, self._space, self._own_motion = s, space, own_motion
        self._reset_ns = round(s.reset_after_s * 1e9)
        self._command_ns = round(s.command_timeout_s * 1e9)
        turn_walk = math.radians(s.turn_walk_deg_per_s)
        self.walk = np.repeat([s.velocity_walk_m_per_s, turn_walk], [3, 2])
        self.gate = math.sqrt(chdtri(5, 1 - s.gate_probability))
        self._correction = Correction(space, constants, s, self.gate)

    def begun(self, frame: Measurement, before: State | None) -> State:
        """Return a new track, which keeps what the one before, if any, learnt of the constants."""
        stamp_ns = frame.stamp_ns
        begun = self._space.begun(np.zeros(STATE), np.diag(np.square([*POSE_STD, *RATE_STD])))
        if before is not None:
            belief = before.corrected()
            belief = self._space.drifted(belief, (stamp_ns - before.frame.stamp_ns) * 1e-9)
            begun.mean[STATE:] = belief.mean[STATE:]
            begun.covariance[STATE:, STATE:] = belief.covariance[STATE:, STATE:]
        obeys = before is None or before.own_motion != "contradicted"
        corrected = Deferred(lambda: self._correction.begun(begun, frame))
        own_motion = self.own_motion_at(stamp_ns, obeys)
        return State(frame, frame, corrected, own_motion, stamp_ns, frame.readings is not None)

    def next(self, state: State, frame: Measurement) -> State:
        """Return the state after a later frame: in the track, without it, or in a new one."""
        if frame.stamp_ns - state.taken_ns > self._reset_ns:
            return self.begun(frame, state)
        if state.corrected().unlike >= self._settings.reacquire_frames:
            return self.begun(frame, None)
        fused = self._fused(state, frame)
        if fused.distance <= self.gate:
            return fused if fused.by_readings == state.by_readings else self.begun(frame, state)
        outliers = state.outliers + 1
        if outliers >= self._settings.reacquire_frames:
            # What was learnt of the constants may be what is wrong, as where the lamp dims.
            return self.begun(frame, None)
        return replace(state, newest=frame, outliers=outliers, outlier=fused.distance)

    def common_covariance(self, state: State) -> Array:
        """Return the covariance of a pose's error that all frames have in common, ``(5, 5)``.

        That is not in the belief, as no number of frames averages it out; 0 for a frame with
        readings, or one that a track of readings leaves out.
        """
        frame = state.frame
        if state.by_readings and not frame.uneven:
            return np.zeros((5, 5))
        return self._correction.common_share(frame) * (frame.root @ frame.root.T)

    def bent_covariance(self, state: State, belief: Belief) -> Array:
        """Return what the bend of the light adds to a pose's covariance, ``(5, 5)``.

        - belief: the one after the frame of the state, and after ranges.
        """
        if not (state.by_readings and state.frame.bent):
            return np.zeros((5, 5))
        return self._correction.bent_covariance(belief, state.frame.stamp_ns)

    def commanded(self, stamp_ns: int) -> bool:
        """Say whether there is a command of a stamp that is not too old."""
        return self._own_motion.age_ns(stamp_ns) <= self._command_ns

    def own_motion_at(self, stamp_ns: int, obeys: bool) -> OwnMotionIs:
        """Say what is known of the own motion at a stamp, if the follower obeys, or does not."""
        if not self.commanded(stamp_ns):
            return "not told"
        return "told" if obeys else "contradicted"

    def _fused(self, state: State, frame: Measurement) -> State:
        """Return the state with a frame by the likeliest event that explains it, or the usual one.

        Commands are contradicted only where no event explains the frame while they are obeyed.
        """
        usual = None
        for obeys in (True, False) if self.commanded(frame.stamp_ns) else (False,):
            best, least = None, None
            for event in SHARES:
                # A wider and rarer event is no likelier than a usual motion that fits.
                if best and best.distance**2 <= -2 * math.log(SHARES[event]):
                    continue
                fused, cost = self._fused_by(state, frame, obeys, event)
                usual = usual or fused
                # Costs are worked out where events compete alone.
                if fused.distance <= self.gate and (least is None or cost() < least()):
                    best, least = fused, cost
            if best:
                return best
        assert usual is not None
        return usual

    def _fused_by(
        self, state: State, frame: Measurement, obeys: bool, event: Event
    ) -> tuple[State, Callable[[], float]]:
        """Return the state with a frame by one event, and twice its negative log-probability."""
        predicted = self._predicted(state, frame.stamp_ns, obeys, event)
        readings = frame.readings
        if state.by_readings:
            readings = self._correction.readings(predicted, frame)
        taken = readings is not None or frame.uneven or not state.by_readings
        if taken:
            step_s = (frame.stamp_ns - state.taken_ns) * 1e-9
            corrected = self._correction.correct(predicted, frame, readings, step_s)
        else:
            still = Deferred(lambda: predicted)
            corrected = Corrected(still, pose_distance(predicted, frame), lambda: 0.0)
        fused = State(
            frame,
            frame,
            corrected.belief,
            self.own_motion_at(frame.stamp_ns, obeys),
            frame.stamp_ns if taken else state.taken_ns,
            state.by_readings or frame.readings is not None,
            state.frames + taken,
            corrected.distance,
        )
        return fused, lambda: corrected.cost() - 2 * math.log(SHARES[event])

    def _predicted(self, state: State, stamp_ns: int, obeys: bool, event: Event) -> Belief:
        """Return the belief at a later stamp, where the follower obeys its commands or does not."""
        start_ns, before = state.frame.stamp_ns, state.corrected()
        step_s = (stamp_ns - start_ns) * 1e-9
        belief = self._space.drifted(before, step_s)
        if event == "jump":
            belief = self._space.forgotten(belief)
        mean, covariance = belief.mean, belief.covariance
        if event == "manoeuvre":
            covariance[RATE, RATE] += np.diag(np.square(MANOEUVRE_STD))
        if obeys != (state.own_motion == "told"):
            # The rate of a leader whose follower obeys is not that of the relative motion.
            covariance[RATE, RATE] += np.diag(np.square(RATE_STD))
        # F x and F P F', where F adds step * rate to the pose.
        mean[POSE] += step_s * mean[RATE]
        covariance[POSE] += step_s * covariance[RATE]
        covariance[:, POSE] += step_s * covariance[:, RATE]
        leader = swing(before.mean[POSE]) if obeys else np.eye(5)
        walk = (leader * np.square(self.walk)) @ leader.T
        covariance[:STATE, :STATE] += walk_noise(walk, step_s)
        # The attitude's error turns the own motion by so little that the random motion covers it.
        if obeys:
            own = self._own_motion.displacement(start_ns, stamp_ns)
            mean[POSE] += in_beacon(before.mean[POSE], own)
        wrapped(mean[POSE])
        return belief
