"""One track through many frames: a Kalman filter of pose, rate and constants of the day.

With the follower's commands the pose moves by them and by the rate, which is then the leader's;
without, the rate is that of the whole relative motion (`motion`). Where commands begin or end, it
starts from its prior. What all frames have in common is a part of the state (`belief`).

A frame comes as a pose with its covariance, or with its readings, linearised (`correction`).

- Of a pose alone, only the white part of the errors averages out. All frames share the error
  ``common_share``, such as the bias of a grid, or more where images are not linear or constants are
  unknown. The errors of a shaded frame vary as slowly as the shade.
- Bare poses say only roughly what they share of the constants' errors: a track that began with
  readings takes them only of shaded frames, and otherwise goes on for a while without; one of poses
  begins anew with the first readings.
- Readings also teach the constants and the detectors' gains, while the vehicles move.
- A range from elsewhere corrects what a frame says (`ranges`).

The rate changes at random, and rate or constants now and then at once: a frame that the usual
motion hardly explains is weighed as the first after a manoeuvre, or after a jump that makes the
constants the prior's again, by its likelihood and the prior probability of either
(Y. Bar-Shalom, X.-R. Li and T. Kirubarajan, *Estimation with Applications to Tracking and
Navigation*, 2001, ch. 11). Where commands explain it in neither way, the follower does not obey
them. A frame beyond the gate is an outlier; after so many in a row the newest begins another track,
which knows nothing of the constants.
"""

import math
from bisect import bisect_left
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array, wrapped
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import STATE, Belief, BiasSpace
from uuv_optical_array.estimation.tracking.change import SPAN_NS, Changes
from uuv_optical_array.estimation.tracking.correction import (
    Corrected,
    Correction,
    Deferred,
    pose_distance,
)
from uuv_optical_array.estimation.tracking.measurement import (
    Measurement,
    Relinearise,
    checked_pose,
    checked_readings,
)
from uuv_optical_array.estimation.tracking.mismatch import Alarm
from uuv_optical_array.estimation.tracking.motion import (
    LONG_AGO_NS,
    RATE_STD,
    OwnMotion,
    in_beacon,
    walk_noise,
)
from uuv_optical_array.estimation.tracking.ranges import Ranges, Ranging, checked_range
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import (
    POSE,
    RATE,
    Learnt,
    Outlier,
    OwnMotionIs,
    StampRefused,
    Track,
)
from uuv_optical_array.estimation.unknowns.constants import Constants, drift
from uuv_optical_array.forward.prior import ROLL

POSE_STD = np.array([100.0, 100.0, 100.0, 10.0, 10.0])  # m and rad, of an unknown pose
# A manoeuvre changes the rate by so much from one frame to the next, m/s and rad/s.
MANOEUVRE_STD = np.array([0.2, 0.2, 0.2, 0.3, 0.3])
# What happens from a frame to the next, and in which share of frames; constants jump as where a
# lamp is switched down.
Event = Literal["usual", "manoeuvre", "jump"]
SHARES: dict[Event, float] = {"usual": 1.0, "manoeuvre": 1e-2, "jump": 1e-4}


@dataclass(frozen=True)
class _State:
    frame: Measurement  # the newest in the track
    corrected: Deferred  # by that frame; without the common share
    own_motion: OwnMotionIs  # where it is "told", the rate is that of the leader
    taken_ns: int  # stamp of the newest frame that corrected anything
    by_readings: bool  # whether any frame came with readings
    frames: int = 1
    distance: float = 0.0
    outliers: int = 0  # in a row, since the newest frame in the track
    outlier: float = 0.0  # distance of the newest of them


_Entry = tuple[Measurement, _State]


class Tracker:
    """Filter frames in the order of their stamps, in whatever order they come.

    - constants: what is not known of the scene, to be learnt from frames with readings.
    """

    def __init__(self, settings: TrackerSettings, constants: Constants | None = None) -> None:
        # Frames of the buffer and the last one before it, by stamp, each with the state after it.
        self._history: list[_Entry] = []
        self._previous: _State | None = None  # the last state of the track before this one
        self._own_motion = OwnMotion()
        self._tested_ns = LONG_AGO_NS  # stamp of the newest frame that was tested for a mismatch
        self._settings, s = settings, settings
        self._constants = c = constants or Constants()
        self._rate_walk = np.array(
            [s.velocity_walk_m_per_s] * 3 + [math.radians(s.turn_walk_deg_per_s)] * 2
        )
        self._gate = math.sqrt(chdtri(5, 1 - s.gate_probability))
        self._buffer_ns, self._reset_ns, self._command_ns = (
            round(time_s * 1e9) for time_s in (s.buffer_s, s.reset_after_s, s.command_timeout_s)
        )
        self._ranges = Ranges(s)
        self._space = BiasSpace(c, s.constants_hold_s)
        self._changes = Changes(self._space, self._rate_walk)
        self._alarm = Alarm(c, self._changes)
        self._correction = Correction(self._space, c, s, self._gate)
        range_gate = math.sqrt(chdtri(1, 1 - s.gate_probability))
        self._ranging = Ranging(self._space, range_gate, s.reacquire_frames)

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
        - readings: likelihood of the image near its best fit; ``None``: constants stay as they are.
        - relinearise: returns the same likelihood near another place, as `LinearisedReadings.at`
          has it; ``None``: `readings` are used as they are.
        - shaded: probability that something shades the frame, in [0, 1]; not used with `readings`.
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
        newest_ns = _stamp(history[-1]) if history else stamp_ns
        age_ns = newest_ns - stamp_ns
        if age_ns > self._buffer_ns + self._reset_ns:
            history, previous = [], history[-1][1]
        elif age_ns > self._buffer_ns:
            raise StampRefused(
                f"late frame: {age_ns * 1e-9:.3f} s older than the newest, more than "
                f"buffer_s {s.buffer_s:g}",
                newest_ns,
            )
        place = bisect_left(history, stamp_ns, key=_stamp)
        if history[place:] and _stamp(history[place]) == stamp_ns:
            raise StampRefused(f"repeated stamp: {stamp_ns} ns is in the track already", newest_ns)
        history = self._replay(history, place, previous, frame)
        if distance := history[place][1].outlier:
            raise Outlier(
                f"outlier: {distance:.3g} standard deviations off, more than {self._gate:.3g}"
            )
        return _stamp(history[-1])

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
        newest_ns = _stamp(self._history[-1]) if self._history else None
        self._ranges.add(checked_range(stamp_ns, range_m, std_m), newest_ns)
        place = bisect_left(self._history, stamp_ns, key=_stamp)
        if place < len(self._history):
            self._replay(self._history, place, self._previous)

    def track(self) -> Track:
        """Return the track at the newest frame in it; NoPose where there is none yet."""
        if not self._history:
            raise NoPose("no track: there is no frame yet")
        newest = self._history[-1][1]
        stamp_ns, belief = newest.frame.stamp_ns, newest.corrected()
        mean, joint = belief.mean[:STATE], belief.covariance[:STATE, :STATE].copy()
        errors, stds = self._space.errors(belief), self._space.stds
        offsets = self._space.offsets(belief)
        known = stds * np.sqrt(errors.covariance.diagonal())
        learnt = map(Learnt, offsets.tolist(), known.tolist())
        own_motion = self._own_motion_at(stamp_ns, newest)
        own = self._own_motion.twist(stamp_ns) if own_motion == "told" else np.zeros(5)
        if newest.frame.readings is None:
            root, share = newest.frame.root, self._correction.common_share(newest.frame)
            joint[POSE, POSE] += share * (root @ root.T)
        if stamp_ns != self._tested_ns:
            self._test(stamp_ns, np.concatenate([mean[POSE], offsets]), newest.frame)
        return Track(
            stamp_ns,
            mean[POSE].copy(),
            mean[RATE] + in_beacon(mean[POSE], own),
            joint,
            newest.frames,
            newest.distance,
            dict(zip(self._constants.names, learnt, strict=False)),
            self._space.blocks @ (stds * errors.mean)[self._space.gains],
            own_motion,
            self._alarm.said,
            self._turn(belief),
            belief.range,
        )

    def uneven(self, stamp_ns: int) -> float:
        """Return how likely the image of a stamp, ns, is lit unevenly, by the newest of the track.

        That is all that a track tells of an image: constants that it learnt may no longer hold, and
        poses of single images are not to err as the track does.
        """
        c, state = self._constants, self._history[-1][1] if self._history else self._previous
        if state is None or not c.unclear_lasts_s:
            return c.uneven
        decay = float(drift(c.unclear_lasts_s, (stamp_ns - state.frame.stamp_ns) * 1e-9))
        return c.uneven + decay * (state.frame.shaded - c.uneven)

    def _test(self, stamp_ns: int, at: Array, frame: Measurement) -> None:
        """Test whether the scene explains the newest frame and those before."""
        self._tested_ns, near = stamp_ns, None
        if frame.relinearise:
            way: Array = np.zeros(5)
            if self._commanded(stamp_ns):
                since_ns = min(max(self._changes.newest_ns, stamp_ns - SPAN_NS), stamp_ns)
                way = in_beacon(at[POSE], self._own_motion.displacement(since_ns, stamp_ns))
            self._changes.add(stamp_ns, way, at[POSE], frame.relinearise)
            with suppress(ValueError):  # not finite there
                near = checked_readings(frame.relinearise(at), self._constants)
        self._alarm.add(stamp_ns, frame.shaded > 0.5, near)

    def _turn(self, belief: Belief) -> Array | None:
        """Return the roll's covariance with the pose, and its variance, ``(6,)``, if it is one."""
        if ROLL not in self._constants.names:
            return None
        by_roll = self._space.by_offsets[self._constants.names.index(ROLL)]
        column = belief.covariance[:, STATE:] @ by_roll
        return np.array([*column[POSE], by_roll @ column[STATE:]])

    def _replay(
        self, history: list[_Entry], place: int, previous: _State | None, *frames: Measurement
    ) -> list[_Entry]:
        """Return a history in which frames enter at a place, and keep what of it is not too old."""
        history, late = history[:place], history[place:]
        for frame in (*frames, *(entry[0] for entry in late)):
            before = history[-1][1] if history else None
            state = self._next(before, frame) if before else self._start(frame, previous)
            history.append((frame, self._ranged(state, frame, before)))
        newest_ns = _stamp(history[-1])
        oldest = bisect_left(history, newest_ns - self._buffer_ns, key=_stamp)
        self._history, self._previous = history[max(oldest - 1, 0) :], previous
        self._ranges.forget(newest_ns)
        return history

    def _ranged(self, state: _State, frame: Measurement, before: _State | None) -> _State:
        """Return the state after a frame with the ranges since the one before."""
        before_ns = None if before is None else before.frame.stamp_ns
        ranges = self._ranges.between(before_ns, frame.stamp_ns)
        if not ranges or state.frame is not frame:  # which is an outlier
            return state
        common: Array = np.zeros((3, 3))
        if frame.readings is None:
            root, share = frame.root[:3], self._correction.common_share(frame)
            common += share * (root @ root.T)

        def ranged() -> Belief:
            belief = state.corrected()
            for each in ranges:
                own: Array = np.zeros(5)
                if state.own_motion == "told":
                    own = self._own_motion.displacement(each.stamp_ns, frame.stamp_ns)
                way = in_beacon(belief.mean[POSE], own)[:3]
                belief = self._ranging.correct(belief, each, frame.stamp_ns, way, common)
            return belief

        return replace(state, corrected=Deferred(ranged))

    def _next(self, state: _State, frame: Measurement) -> _State:
        """Return the state after a frame: in the track, without it, or in a new one."""
        if frame.stamp_ns - state.taken_ns > self._reset_ns:
            return self._start(frame, state)
        fused = self._fused(state, frame)
        if fused.distance <= self._gate:
            # Poses say only roughly what they share of the constants' errors: readings begin anew.
            return fused if fused.by_readings == state.by_readings else self._start(frame, state)
        outliers = state.outliers + 1
        if outliers >= self._settings.reacquire_frames:
            # What was learnt of the constants may be what is wrong, as where the lamp dims.
            return self._start(frame, None)
        return replace(state, outliers=outliers, outlier=fused.distance)

    def _fused(self, state: _State, frame: Measurement) -> _State:
        """Return the state with a frame by the likeliest motion that explains it, or the usual one.

        Commands are contradicted only where no motion that obeys them explains it.
        """
        usual = None
        for obeys in (True, False) if self._commanded(frame.stamp_ns) else (False,):
            best, least = None, math.inf
            for event in SHARES:
                # One that is wider and rarer is no likelier than a usual motion that fits.
                if best and best.distance**2 <= -2 * math.log(SHARES[event]):
                    continue
                fused, cost = self._fused_by(state, frame, obeys, event)
                usual = usual or fused
                if fused.distance <= self._gate and cost < least:
                    best, least = fused, cost
            if best:
                return best
        assert usual is not None
        return usual

    def _fused_by(
        self, state: _State, frame: Measurement, obeys: bool, event: Event
    ) -> tuple[_State, float]:
        """Return the state with a frame by one motion, and twice its negative log-probability."""
        predicted = self._predicted(state, frame.stamp_ns, obeys, event)
        taken = frame.readings is not None or frame.shaded > 0.5 or not state.by_readings
        if taken:
            step_s = (frame.stamp_ns - state.frame.stamp_ns) * 1e-9
            corrected = self._correction.correct(predicted, frame, step_s)
        else:
            still = Deferred(lambda: predicted)
            corrected = Corrected(still, pose_distance(predicted, frame))
        fused = _State(
            frame,
            corrected.belief,
            self._own_motion_at(frame.stamp_ns, obeys=obeys),
            frame.stamp_ns if taken else state.taken_ns,
            state.by_readings or frame.readings is not None,
            state.frames + taken,
            corrected.distance,
        )
        return fused, corrected.cost - 2 * math.log(SHARES[event])

    def _start(self, frame: Measurement, before: _State | None) -> _State:
        """Return a new track, which keeps what the one before, if any, learnt of the constants."""
        stamp_ns = frame.stamp_ns
        begun = self._space.begun(np.zeros(STATE), np.diag(np.square([*POSE_STD, *RATE_STD])))
        if before is not None:
            belief = before.corrected()
            belief = self._space.drifted(belief, (stamp_ns - before.frame.stamp_ns) * 1e-9)
            begun.mean[STATE:] = belief.mean[STATE:]
            begun.covariance[STATE:, STATE:] = belief.covariance[STATE:, STATE:]
        own_motion = self._own_motion_at(stamp_ns, before)
        corrected = Deferred(lambda: self._correction.begun(begun, frame))
        return _State(frame, corrected, own_motion, stamp_ns, frame.readings is not None)

    def _predicted(self, state: _State, stamp_ns: int, obeys: bool, event: Event) -> Belief:
        """Return a belief at a later stamp, where the follower obeys its commands or does not."""
        start_ns, before = state.frame.stamp_ns, state.corrected()
        step_s = (stamp_ns - start_ns) * 1e-9
        changes = [MANOEUVRE_STD] if event == "manoeuvre" else []
        if obeys != (state.own_motion == "told"):  # it is another rate
            changes.append(RATE_STD)
        noise = [walk_noise(self._rate_walk, step_s)]
        noise += [step_s * np.eye(10, 5) * std + np.eye(10, 5, -5) * std for std in changes]
        belief = self._space.drifted(before, step_s)
        if event == "jump":
            belief = self._space.forgotten(belief)
        mean, covariance = belief.mean, belief.covariance
        mean[POSE] += step_s * mean[RATE]
        covariance[POSE] += step_s * covariance[RATE]
        covariance[:, POSE] += step_s * covariance[:, RATE]
        root = np.hstack(noise)
        covariance[:STATE, :STATE] += root @ root.T
        # The attitude's error turns the own motion by so little that the random motion covers it.
        if obeys:
            own = self._own_motion.displacement(start_ns, stamp_ns)
            mean[POSE] += in_beacon(before.mean[POSE], own)
        wrapped(mean[POSE])
        return belief

    def _commanded(self, stamp_ns: int) -> bool:
        """Say whether there is a command of a stamp that is not too old."""
        return self._own_motion.age_ns(stamp_ns) <= self._command_ns

    def _own_motion_at(
        self, stamp_ns: int, before: _State | None = None, obeys: bool | None = None
    ) -> OwnMotionIs:
        """Say what is known of the own motion at a stamp.

        Whether it obeys is what the frame of that stamp says, or the state before.
        """
        if not self._commanded(stamp_ns):
            return "not told"
        if obeys is None:
            obeys = before is None or before.own_motion != "contradicted"
        return "told" if obeys else "contradicted"


def _stamp(entry: _Entry) -> int:
    return entry[0].stamp_ns
