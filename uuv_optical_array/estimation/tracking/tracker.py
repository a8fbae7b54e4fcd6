"""One track through many images: frames in, in whatever order, and the newest state of it out.

The way of a frame:

1. `Tracker.take` checks it (`measurement`) and puts it in its place by its stamp.
2. From there on each frame is filtered in turn (`filter`): the belief of the frame before, one
   Gaussian of pose, rate, and what all frames have in common (`belief`), is predicted by the motion
   (`motion`), corrected by the readings (`correction`), and by ranges from elsewhere (`ranges`).
3. `Tracker.track` reads the newest state off: pose, rate, what is known of the constants. It also
   tests whether the scene explains the frames (`mismatch`, `change`), which changes no state.

With the follower's commands the pose moves by them and by the rate, which is then the leader's;
without, the rate is that of the whole relative motion. Where commands begin or end, it starts from
its prior.
"""

from bisect import bisect_left
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import STATE, Belief, BiasSpace
from uuv_optical_array.estimation.tracking.change import SPAN_NS, Changes
from uuv_optical_array.estimation.tracking.correction import Deferred
from uuv_optical_array.estimation.tracking.filter import FrameFilter, State
from uuv_optical_array.estimation.tracking.measurement import (
    Measurement,
    Relinearise,
    checked_pose,
    checked_readings,
)
from uuv_optical_array.estimation.tracking.mismatch import Alarm
from uuv_optical_array.estimation.tracking.motion import LONG_AGO_NS, OwnMotion, in_beacon
from uuv_optical_array.estimation.tracking.ranges import Ranges, checked_range
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import (
    POSE,
    RATE,
    Learnt,
    Outlier,
    StampRefused,
    Track,
)
from uuv_optical_array.estimation.unknowns.constants import Constants, drift
from uuv_optical_array.forward.prior import ROLL

STAMP = attrgetter("newest.stamp_ns")  # of a state


class Tracker:
    """Filter frames in the order of their stamps, in whatever order they come.

    - constants: what is not known of the scene, to be learnt from frames with readings.
    """

    def __init__(self, settings: TrackerSettings, constants: Constants | None = None) -> None:
        # By stamp the states after each frame of the buffer and after the last one before it.
        self._history: list[State] = []
        self._previous: State | None = None  # the last state of the track before this one
        self._own_motion = OwnMotion()
        self._tested_ns = LONG_AGO_NS  # stamp of the newest frame that was tested for a mismatch
        self._settings, s = settings, settings
        self._constants = c = constants or Constants()
        self._buffer_ns, self._reset_ns = (round(t * 1e9) for t in (s.buffer_s, s.reset_after_s))
        self._space = BiasSpace(c, s.constants_hold_s)
        self._filter = FrameFilter(s, c, self._space, self._own_motion)
        self._ranges = Ranges(s, self._space)
        self._changes = Changes(self._space, self._filter.walk)
        self._alarm = Alarm(c, self._changes)

    def command(self, stamp_ns: int, twist: ArrayLike) -> None:
        """Take the follower's own motion, which carries the pose on until the next command.

        - stamp_ns: from when on it moves so, ns; commands of later stamps are forgotten.
        - twist: surge, sway, heave (m/s), pitch and yaw rate (rad/s) in its frame, shape ``(5,)``.
        - ValueError: for a twist of wrong shape or out of bounds.
        """
        self._own_motion.command(stamp_ns, twist)
        # Late frames need those of buffer and reset; twice, as frames are older than commands.
        self._own_motion.forget(stamp_ns - 2 * (self._buffer_ns + self._reset_ns))

    def update(self, *frame: Any, **more: Any) -> Track:
        """Take a frame as `take` does, and return the track at the newest frame in it."""
        self.take(*frame, **more)
        return self.track()

    def take(
        self,
        stamp_ns: int,
        pose: ArrayLike,
        covariance: ArrayLike,
        readings: LinearisedReadings | None = None,
        relinearise: Relinearise | None = None,
        shaded: float = 0.0,
    ) -> int:
        """Take a frame; one that comes late is put in its place and those after it are replayed.

        This is half of the work of a frame; the rest is left to `track`.

        - stamp_ns: of the image, ns. One farther behind than ``buffer_s + reset_after_s`` starts
          anew: the clock was set back.
        - pose, covariance: m and rad, shapes ``(5,)`` and ``(5, 5)``, the latter positive definite.
        - readings: likelihood of the image near its best fit; ``None``: it is not linear there.
        - relinearise: returns the same likelihood near another place, as `LinearisedReadings.at`
          has it; ``None``: `readings` are used as they are, and constants stay without.
        - shaded: probability that something shades the frame, in [0, 1], where both are ``None``.
        - returned: stamp of the newest frame in the track, ns: a later one where this came late.
        - Outlier: for a pose beyond the gate.
        - StampRefused: for a frame older than the buffer, or a stamp that is in it.
        - ValueError: for a pose, covariance or readings of wrong shape or out of bounds.
        """
        s, history, previous = self._settings, self._history, self._previous
        if readings is not None:
            readings = checked_readings(readings, self._constants)
        frame = Measurement(
            stamp_ns, *checked_pose(pose, covariance), readings, relinearise, shaded
        )
        newest_ns = history[-1].newest.stamp_ns if history else stamp_ns
        age_ns = newest_ns - stamp_ns
        if age_ns > self._buffer_ns + self._reset_ns:
            history, previous = [], history[-1]
        elif age_ns > self._buffer_ns:
            raise StampRefused(
                f"late frame: {age_ns * 1e-9:.3f} s older than the newest, more than "
                f"buffer_s {s.buffer_s:g}",
                newest_ns,
            )
        place = bisect_left(history, stamp_ns, key=STAMP)
        if history[place:] and history[place].newest.stamp_ns == stamp_ns:
            raise StampRefused(f"repeated stamp: {stamp_ns} ns is in the track already", newest_ns)
        history = self._replay(history, place, previous, frame)
        if distance := history[place].outlier:
            gate = self._filter.gate
            raise Outlier(f"outlier: {distance:.3g} standard deviations off, more than {gate:.3g}")
        return history[-1].newest.stamp_ns

    def range(self, stamp_ns: int, range_m: float, std_m: float) -> None:
        """Take a range from elsewhere; it enters with the first frame that is not older.

        One that comes after that frame is put in its place, and frames are replayed. Alone it
        neither starts a track nor keeps one; `Track.range` says what was made of it.

        - stamp_ns: when it was that, ns.
        - range_m: from the lamp to the follower's ``base_link``, m, > 0.
        - std_m: its standard deviation, m, > 0.
        - StampRefused: for one older than the buffer, of the stamp of another, or more than
          ``reset_after_s`` newer than the newest frame.
        - ValueError: for numbers out of bounds.
        """
        newest_ns = self._history[-1].newest.stamp_ns if self._history else None
        self._ranges.add(checked_range(stamp_ns, range_m, std_m), newest_ns)
        place = bisect_left(self._history, stamp_ns, key=STAMP)
        if place < len(self._history):
            self._replay(self._history, place, self._previous)

    def track(self) -> Track:
        """Return the track at the newest frame in it; NoPose where there is none yet."""
        if not self._history:
            raise NoPose("no track: there is no frame yet")
        newest = self._history[-1]
        stamp_ns, belief = newest.frame.stamp_ns, newest.corrected()
        mean, joint = belief.mean[:STATE], belief.covariance[:STATE, :STATE].copy()
        means, stds = self._space.learnt(belief)
        learnt = map(Learnt, means.tolist(), stds.tolist())
        obeys = newest.own_motion != "contradicted"
        own_motion = self._filter.own_motion_at(stamp_ns, obeys)
        own = self._own_motion.twist(stamp_ns) if own_motion == "told" else np.zeros(5)
        joint[POSE, POSE] += self._filter.common_covariance(newest)
        joint[POSE, POSE] += self._filter.bent_covariance(newest, belief)
        if stamp_ns != self._tested_ns:
            at = np.concatenate([mean[POSE], means[self._space.constants]])
            self._test(stamp_ns, at, newest.frame)
        return Track(
            stamp_ns,
            mean[POSE].copy(),
            mean[RATE] + in_beacon(mean[POSE], own),
            joint,
            newest.frames,
            newest.distance,
            dict(zip(self._constants.names, learnt, strict=False)),
            self._space.blocks @ means[self._space.gains],
            own_motion,
            self._alarm.said,
            self._turn(belief),
            belief.range,
        )

    def uneven(self, stamp_ns: int) -> float:
        """Return how likely the image of a stamp, ns, is lit unevenly, by the newest of the track.

        A track says nothing else of an image: constants that it learnt may no longer hold, and
        poses of single images must not share the track's errors.
        """
        c, state = self._constants, self._history[-1] if self._history else self._previous
        if state is None or not c.unclear_lasts_s:
            return c.uneven
        decay = drift(c.unclear_lasts_s, (stamp_ns - state.frame.stamp_ns) * 1e-9)
        return c.uneven + decay * (state.frame.shaded - c.uneven)

    def _test(self, stamp_ns: int, at: Array, frame: Measurement) -> None:
        """Test whether the scene explains the newest frame and those before."""
        self._tested_ns, near = stamp_ns, None
        if frame.relinearise:
            way: Array = np.zeros(5)
            if self._filter.commanded(stamp_ns):
                since_ns = min(max(self._changes.newest_ns, stamp_ns - SPAN_NS), stamp_ns)
                way = in_beacon(at[POSE], self._own_motion.displacement(since_ns, stamp_ns))
            self._changes.add(stamp_ns, way, at[POSE], frame.relinearise)
            if not frame.bent:  # what lasts in those may be the error of the place
                near = frame.near(at, self._constants)
        self._alarm.add(stamp_ns, frame.uneven, near)

    def _turn(self, belief: Belief) -> Array | None:
        """Return the roll's covariance with the pose, and its variance, ``(6,)``, if it is one."""
        if ROLL not in self._constants.names:
            return None
        by_roll = self._space.by_offsets[self._constants.names.index(ROLL)]
        column = belief.covariance[:, STATE:] @ by_roll
        return np.array([*column[POSE], by_roll @ column[STATE:]])

    def _replay(
        self, history: list[State], place: int, previous: State | None, *frames: Measurement
    ) -> list[State]:
        """Return a history in which frames enter at a place, and keep what of it is not too old."""
        history, late = history[:place], history[place:]
        for frame in (*frames, *(state.newest for state in late)):
            before = history[-1] if history else None
            if before:
                state = self._filter.next(before, frame)
            else:
                state = self._filter.begun(frame, previous)
            history.append(self._ranged(state, before))
        newest_ns = history[-1].newest.stamp_ns
        oldest = bisect_left(history, newest_ns - self._buffer_ns, key=STAMP)
        self._history, self._previous = history[max(oldest - 1, 0) :], previous
        self._ranges.forget(newest_ns)
        return history

    def _ranged(self, state: State, before: State | None) -> State:
        """Return the state after a frame with the ranges since the one before."""
        frame, before_ns = state.frame, None if before is None else before.frame.stamp_ns
        ranges = self._ranges.between(before_ns, frame.stamp_ns)
        if not ranges or state.outliers:
            return state
        common = self._filter.common_covariance(state)[:3, :3]

        def ranged() -> Belief:
            belief = state.corrected()
            for each in ranges:
                own: Array = np.zeros(5)
                if state.own_motion == "told":
                    own = self._own_motion.displacement(each.stamp_ns, frame.stamp_ns)
                way = in_beacon(belief.mean[POSE], own)[:3]
                belief = self._ranges.correct(belief, each, frame.stamp_ns, way, common)
            return belief

        return replace(state, corrected=Deferred(ranged))
