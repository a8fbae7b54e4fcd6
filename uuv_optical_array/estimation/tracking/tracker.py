"""One track through many frames: a Kalman filter of pose, rate and constants of the day.

While the tracker is told the follower's commands, the pose moves by them and by what is left, the
motion of the leader; without commands that rest is the whole relative motion (`motion`). Where
commands begin or end, the rate is another one.
Covariances are kept as triangular roots (`root_filter`), which stay positive definite whatever the
rounding.

A frame comes as a pose with its covariance, or with its readings, linearised (`correction`). Of a
bare pose only errors that are new in every frame average out. The part that is not, such as the
bias of a grid, is ``common_share``. What unknown constants do to its range, where the image is as
bright as it is, is one error for all frames. The errors of a frame that something may shade last as
long as the shade: they are states of the filter that are never corrected, only considered (S. F.
Schmidt, *Advances in Control Systems* 3, 1966, 293), so that the track follows the motion and does
not grow sharp. Readings say what all frames have in common, the scene's unknown constants and the
detectors' gain errors, which are learnt while the vehicles move. Constants are learnt from one
frame in a while only (`LEARN_EVERY_S`), and no more once one that bends the light is known well
(`LEAST_SHARE`): linear readings say more than the images do, and what they say too much adds up.

A frame beyond the gate is an outlier, unless a manoeuvre explains it: random motion several times
stronger than usual for a moment (Y. Bar-Shalom, X.-R. Li and T. Kirubarajan, *Estimation with
Applications to Tracking and Navigation*, 2001, ch. 11); or unless the follower does not do what
the commands say, and its motion is random.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass, replace
from itertools import chain, product

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag
from scipy.special import chdtri

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import wrapped
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.filter.correction import Corrected, Correction
from uuv_optical_array.estimation.tracking.filter.frame import (
    Frame,
    Relinearise,
    checked_pose,
    checked_readings,
)
from uuv_optical_array.estimation.tracking.filter.root_filter import Belief, triangular
from uuv_optical_array.estimation.tracking.filter.state import MOVING, StateSpace
from uuv_optical_array.estimation.tracking.motion import OwnMotion, RandomMotion, in_beacon
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
from uuv_optical_array.estimation.unknowns.constants import Constants, Expected, drift
from uuv_optical_array.forward.prior import AMBIENT, GRADIENTS

RATE_STD = [0.5, 0.5, 0.5, 0.1, 0.1]  # m/s and rad/s, at the start of a track
UNKNOWN_POSE = np.array([100.0, 100.0, 100.0, 10.0, 10.0])  # m and rad, of which nothing is known
# A manoeuvre is random motion so many times stronger for so long, s.
MANOEUVRE, MANOEUVRE_S = 5.0, 0.2
# Constants are learnt from one frame in so long, s. Slopes are those of noisy poses, and what they
# differ by from frame to frame looks like motion, from which more would be learnt than is there.
LEARN_EVERY_S = 4.0
# Of a constant's standard deviation before any frame: below it nothing is learnt until it drifts.
LEAST_SHARE = 0.6


@dataclass(frozen=True)
class _State:
    frame: Frame  # the newest in the track
    corrected: Corrected  # without the common share
    learnt_ns: int  # stamp of the newest frame that constants were learnt from
    own_motion: OwnMotionIs  # where it is told, the commands are beside its rate
    frames: int = 1
    distance: float = 0.0
    rival: "_State | None" = None  # the track of the outliers since
    outlier: float = 0.0  # distance of the newest frame of all, where that is one

    @property
    def belief(self) -> Belief:
        return self.corrected()


class Tracker:
    """Filter poses in the order of their stamps, in whatever order they come.

    Parameters
    ----------
    settings
        Checked settings.
    random_motion
        What the commands do not explain; ``None`` is that of `settings`, the same for all axes.
    constants
        What is not known of the scene, to be learnt from frames with readings.
    """

    def __init__(
        self,
        settings: TrackerSettings,
        random_motion: RandomMotion | None = None,
        constants: Constants | None = None,
    ) -> None:
        # The buffer by stamp and the last frame before it, each with the state it led to.
        self._history: list[tuple[Frame, _State]] = []
        self._forgotten: _State | None = None  # the last state of the track before
        self._own_motion = OwnMotion()
        self._constants = c = constants or Constants()
        self._space = StateSpace(c)
        self._correction = Correction(self._space, c)
        # Of the constants in which the light is not linear, the least standard deviations.
        bends = [name not in (AMBIENT, *GRADIENTS) for name in c.names]
        self._least = np.where(bends, LEAST_SHARE * np.array(c.stds), 0.0)
        self.configure(settings, random_motion)

    def configure(
        self, settings: TrackerSettings, random_motion: RandomMotion | None = None
    ) -> None:
        """Use other settings from now on; the track stays."""
        self._settings = s = settings
        walk = [s.velocity_walk_m_per_s, math.radians(s.turn_walk_deg_per_s)]
        self._random_motion = random_motion or RandomMotion(
            np.diag(RATE_STD), np.diag(np.repeat(walk, [3, 2]))
        )
        self._gate = math.sqrt(chdtri(5, 1 - s.gate_probability))
        self._buffer_ns, self._reset_ns, self._command_ns = (
            round(time_s * 1e9) for time_s in (s.buffer_s, s.reset_after_s, s.command_timeout_s)
        )
        self._space.hold(s.constants_hold_s)
        self._correction.configure(s.common_share, self._gate)

    def reset(self) -> None:
        """Forget the track; the commands and what was learnt of the constants stay."""
        if self._history:
            self._forgotten = self._history[-1][1]
        self._history = []

    def command(self, stamp_ns: int, twist: ArrayLike) -> None:
        """Take the follower's own motion, which carries the pose on until the next command.

        Parameters
        ----------
        stamp_ns
            From when on it moves so, ns; commands of later stamps are forgotten.
        twist
            Surge, sway, heave (m/s), pitch and yaw rate (rad/s) in the follower's frame, shape
            ``(5,)``.

        Raises
        ------
        ValueError
            For a twist of wrong shape or out of bounds.
        """
        self._own_motion.command(stamp_ns, twist)
        # A frame may be as late as the buffer, and the one before it as old as the reset; twice
        # that, as the newest frame is older than the newest command.
        self._own_motion.forget(stamp_ns - 2 * (self._buffer_ns + self._reset_ns))

    def update(
        self,
        stamp_ns: int,
        pose: ArrayLike,
        covariance: ArrayLike,
        readings: LinearisedReadings | None = None,
        relinearise: Relinearise | None = None,
        lasting: float = 0.0,
    ) -> Track:
        """Take a frame; one that comes late is put in its place and those after it are replayed.

        Parameters
        ----------
        stamp_ns
            Of the image, ns. One farther behind than ``buffer_s + reset_after_s`` starts anew:
            the clock was set back.
        pose
            ``(x, y, z, pitch, yaw)``, m and rad, shape ``(5,)``.
        covariance
            Of `pose`, shape ``(5, 5)``, positive definite.
        readings
            The likelihood of the image near its own best fit; ``None``: only `pose` and
            `covariance` are used, and the constants stay as they are.
        relinearise
            Returns the same likelihood near another place, as `LinearisedReadings.at` has it; the
            track asks for it on the way from where it was to where `readings` take it. ``None``:
            `readings` have to do.
        lasting
            Probability that something shades the frame, in [0, 1], where `constants` name shades;
            not asked of a frame with `readings`.

        Returns
        -------
        Track
            At the newest frame in it: of a later stamp where this frame came late.

        Raises
        ------
        NoPose, ValueError
            As `take`.
        """
        self.take(stamp_ns, pose, covariance, readings, relinearise, lasting)
        return self.track()

    def take(
        self,
        stamp_ns: int,
        pose: ArrayLike,
        covariance: ArrayLike,
        readings: LinearisedReadings | None = None,
        relinearise: Relinearise | None = None,
        lasting: float = 0.0,
    ) -> int:
        """Take a frame as `update` does, which costs half of it: the rest is done by `track`.

        Parameters
        ----------
        stamp_ns, pose, covariance, readings, relinearise, lasting
            As of `update`.

        Returns
        -------
        int
            Stamp of the newest frame in the track, ns.

        Raises
        ------
        Outlier
            For a pose beyond the gate.
        StampRefused
            For a frame older than the buffer, or a stamp that is in it.
        ValueError
            For a pose, covariance or readings of wrong shape or out of bounds.
        """
        s, history = self._settings, self._history
        if readings is not None:
            readings = checked_readings(readings, self._constants)
        frame = Frame(stamp_ns, *checked_pose(pose, covariance), readings, relinearise, lasting)
        newest_ns = _stamp(history[-1]) if history else stamp_ns
        age_ns = newest_ns - stamp_ns
        forgotten = self._forgotten
        if age_ns > self._buffer_ns + self._reset_ns:
            history, forgotten = [], history[-1][1]
        elif age_ns > self._buffer_ns:
            raise StampRefused(
                f"late frame: {age_ns * 1e-9:.3f} s older than the newest, more than "
                f"buffer_s {s.buffer_s:g}",
                newest_ns,
            )
        place = bisect_left(history, stamp_ns, key=_stamp)
        history, late = history[:place], history[place:]
        if late and _stamp(late[0]) == stamp_ns:
            raise StampRefused(f"repeated stamp: {stamp_ns} ns is in the track already", newest_ns)
        state = history[-1][1] if history else None
        for later in (frame, *(entry[0] for entry in late)):
            state = self._next(state, later) if state else self._start(later, forgotten)
            history.append((later, state))
        oldest = bisect_left(history, _stamp(history[-1]) - self._buffer_ns, key=_stamp)
        self._history, self._forgotten = history[max(oldest - 1, 0) :], forgotten
        if distance := history[place][1].outlier:
            raise Outlier(
                f"outlier: {distance:.3g} standard deviations off, more than {self._gate:.3g}"
            )
        return _stamp(history[-1])

    def track(self) -> Track:
        """Return the track at the newest frame in it.

        Raises
        ------
        NoPose
            Where there is no frame yet.
        """
        newest = self._newest()
        return self._track(newest.frame.stamp_ns, newest.belief, newest)

    def _newest(self) -> _State:
        if not self._history:
            raise NoPose("no track: there is no frame yet")
        return self._history[-1][1]

    def expected(self, stamp_ns: int) -> Expected:
        """Return what is known of a frame before its image: the prior of its fit.

        Parameters
        ----------
        stamp_ns
            Of that frame, ns; the constants have drifted since the newest one in the track, and
            its light may have become other light.

        Returns
        -------
        Expected
            Offsets in the order of the constants' names; the covariance is positive definite.
        """
        state = self._history[-1][1] if self._history else self._forgotten
        usual, lasts_s = self._constants.uneven, self._constants.unclear_lasts_s
        if state is None:
            return Expected(*self._space.known(self._space.unknown(), 0.0), usual)
        step_s = (stamp_ns - state.frame.stamp_ns) * 1e-9
        kept = float(drift(lasts_s, step_s)) if usual else 0.0
        uneven = usual + kept * (state.frame.lasting - usual)
        return Expected(*self._space.known(state.belief, step_s), uneven)

    def predict(self, stamp_ns: int) -> Track:
        """Carry the track on to an instant by its rate and the commands.

        Parameters
        ----------
        stamp_ns
            The instant, ns, from that of the newest frame in the track on.

        Returns
        -------
        Track
            As of the instant, its covariance grown by what may have happened since.

        Raises
        ------
        NoPose
            Where there is no track, or none any more after ``reset_after_s`` without a frame.
        ValueError
            For an instant before the newest frame.
        """
        newest = self._newest()
        age_ns = stamp_ns - newest.frame.stamp_ns
        if age_ns < 0:
            raise ValueError(
                f"stamp_ns: {stamp_ns} is before the newest frame of the track; give "
                f"{newest.frame.stamp_ns} or later"
            )
        if age_ns > self._reset_ns:
            raise NoPose(
                f"no track: no frame for {age_ns * 1e-9:.3f} s, more than reset_after_s "
                f"{self._settings.reset_after_s:g}"
            )
        told = self._own_motion_after(newest, stamp_ns) == "told"
        return self._track(stamp_ns, self._ahead(newest, stamp_ns, told), newest)

    def _track(self, stamp_ns: int, belief: Belief, newest: _State) -> Track:
        mean, covariance = belief.mean, belief.covariance
        stds = np.sqrt(covariance.diagonal()[self._space.constants]).tolist()
        offsets = mean[self._space.constants].tolist()
        joint = covariance[:MOVING, :MOVING].copy()
        own_motion = self._own_motion_after(newest, stamp_ns)
        own = self._own_motion.twist(stamp_ns) if own_motion == "told" else np.zeros(5)
        if newest.frame.readings is None:
            root = newest.frame.root
            joint[POSE, POSE] += self._settings.common_share * (root @ root.T)
        return Track(
            stamp_ns,
            mean[POSE].copy(),
            mean[RATE] + in_beacon(mean[POSE], own),
            joint,
            newest.frames,
            newest.distance,
            dict(zip(self._constants.names, map(Learnt, offsets, stds), strict=True)),
            mean[self._space.gains].copy(),
            own_motion,
        )

    def _next(self, state: _State, frame: Frame) -> _State:
        if frame.stamp_ns - state.frame.stamp_ns > self._reset_ns:
            return self._start(frame, state)
        fused = self._fits(state, frame, manoeuvres=(False, True))
        if fused.distance <= self._gate:
            return fused
        rival = self._fits(state.rival, frame) if state.rival else None
        if rival is None or rival.distance > self._gate:
            rival = self._start(frame, state)
        if rival.frames >= self._settings.reacquire_frames:
            return rival
        return replace(state, rival=rival, outlier=fused.distance)

    def _fits(self, state: _State, frame: Frame, manoeuvres: tuple[bool, ...] = (False,)) -> _State:
        """Return the state with a frame by the first motion that explains it, or the usual one."""
        heard = self._heard(frame.stamp_ns)
        motions = product((True, False) if heard else (False,), manoeuvres)
        tried = (self._fuse(state, frame, *motion) for motion in motions)
        usual = next(tried)
        return next((one for one in chain([usual], tried) if one.distance <= self._gate), usual)

    def _start(self, frame: Frame, before: _State | None) -> _State:
        """Return a new track, which keeps what was learnt of the constants."""
        stamp_ns = frame.stamp_ns
        held, own_motion = self._held(before, stamp_ns), self._own_motion_after(before, stamp_ns)
        mean, root, shared = held
        start, lasts = triangular(self._random_motion.start), root[MOVING:, MOVING:]
        if frame.readings is None:
            own, slopes = self._correction.errors(held, frame)
            follows = -slopes[:, MOVING:]
            anew = block_diag(own, start, lasts)
            mean[POSE], anew[POSE, MOVING:] = frame.pose, follows @ lasts
            shared[POSE] = follows @ shared[MOVING:]
            belief = Belief(mean, anew, shared)
            return _State(frame, Corrected(lambda: belief), stamp_ns, own_motion)
        mean[POSE] = frame.readings.at[:5]
        anew = block_diag(np.diag(UNKNOWN_POSE), start, lasts)
        corrected, _ = self._correction.by_frame(Belief(mean, anew, shared), frame, True)
        return _State(frame, corrected, stamp_ns, own_motion)

    def _held(self, state: _State | None, stamp_ns: int) -> Belief:
        """Return a belief in nothing but what lasts, at a stamp."""
        if state is None:
            return self._space.unknown()
        return self._space.held(state.belief, (stamp_ns - state.frame.stamp_ns) * 1e-9)

    def _ahead(self, state: _State, stamp_ns: int, told: bool, manoeuvring: bool = False) -> Belief:
        """Return the belief of a state at a later stamp, moved by the commands where it is told."""
        start_ns = state.frame.stamp_ns
        step_s = (stamp_ns - start_ns) * 1e-9
        mean, root, shared = self._space.drifted(state.belief, step_s)
        if told != (state.own_motion == "told"):
            unknown = np.zeros((self._space.size, 5))
            unknown[RATE] = self._random_motion.start
            root = np.hstack([root, unknown])
        for part in (mean, root, shared):
            part[POSE] += step_s * part[RATE]
        # The attitude's error turns the own motion by so little that the random motion covers it.
        at = state.belief.mean[POSE]
        way = self._own_motion.way(start_ns, stamp_ns)
        if told and way.any():
            mean[POSE] += in_beacon(at, way)
        noises = [self._random_motion.noise(step_s)]
        if manoeuvring:
            noises.append(MANOEUVRE * self._random_motion.noise(MANOEUVRE_S))
        noise = np.hstack(noises)
        random = np.zeros((self._space.size, noise.shape[1]))
        random[:MOVING] = noise
        return Belief(wrapped(mean), np.hstack([root, random]), shared)

    def _heard(self, stamp_ns: int) -> bool:
        """Say whether there are commands of a stamp."""
        return self._own_motion.age_ns(stamp_ns) <= self._command_ns

    def _own_motion_is(self, stamp_ns: int, obeyed: bool) -> OwnMotionIs:
        """Say what the own motion is at a stamp, where commands of it would be obeyed or not."""
        if not self._heard(stamp_ns):
            return "not told"
        return "told" if obeyed else "contradicted"

    def _own_motion_after(self, state: _State | None, stamp_ns: int) -> OwnMotionIs:
        """Say what the own motion is at a stamp for which there is no frame."""
        contradicted = state is not None and state.own_motion == "contradicted"
        return self._own_motion_is(stamp_ns, not contradicted)

    def _fuse(self, state: _State, frame: Frame, told: bool, manoeuvring: bool) -> _State:
        ahead = self._ahead(state, frame.stamp_ns, told, manoeuvring)
        due = frame.stamp_ns - state.learnt_ns >= LEARN_EVERY_S * 1e9
        learns = due and frame.readings is not None and self._worth_learning(ahead)
        corrected, distance = self._correction.by_frame(
            ahead._replace(root=triangular(ahead.root)), frame, learns
        )
        learnt_ns = frame.stamp_ns if learns else state.learnt_ns
        own_motion = self._own_motion_is(frame.stamp_ns, told)
        return _State(frame, corrected, learnt_ns, own_motion, state.frames + 1, distance)

    def _worth_learning(self, belief: Belief) -> bool:
        """Say whether no constant that bends the light is known well."""
        stds = np.linalg.norm(belief.whole_root[self._space.constants], axis=1)
        return bool((stds >= self._least).all())


def _stamp(entry: tuple[Frame, _State]) -> int:
    return entry[0].stamp_ns
