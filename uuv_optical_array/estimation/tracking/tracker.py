"""One track through many frames: a Kalman filter of pose, rate and constants of the day.

Where the tracker is told the follower's commands, the pose moves by them and by what is left, the
motion of the leader; without commands that rest is the whole relative motion (`motion`).
Covariances are kept as triangular roots (`root_filter`), which stay positive definite whatever the
rounding.

A frame comes as a pose with its covariance, or with its readings, linearised. Of a bare pose only
errors that are new in every frame average out. The part that is not, such as the bias of a grid, is
``common_share``. The errors of a frame that something may shade last as long as the shade: they are
states of the filter that are never corrected, only considered (S. F. Schmidt, *Advances in Control
Systems* 3, 1966, 293), so that the track follows the motion and does not grow sharp. Readings say
what all frames have in common, the scene's unknown constants and the detectors' gain errors, which
are learnt while the vehicles move. They are corrected in coordinates in which images stay linear
(`joint_coordinates`), and linearised once more midway between where the track was and where the
frame takes it: of a light that bends evenly that is the secant, while slopes at either end pull
what is learnt to one side. Constants are learnt from one frame in a while only (`LEARN_EVERY_S`),
and no more once one that bends the light is known well (`LEAST_SHARE`): linear readings say more
than the images do, and what they say too much adds up.

A frame beyond the gate is an outlier, unless a manoeuvre explains it: random motion several times
stronger than usual for a moment (Y. Bar-Shalom, X.-R. Li and T. Kirubarajan, *Estimation with
Applications to Tracking and Navigation*, 2001, ch. 11).
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag
from scipy.special import chdtri

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, Array, wrapped
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.constants import Constants, Learnt, drift
from uuv_optical_array.estimation.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.joint_coordinates import AsTheyAre, JointCoordinates
from uuv_optical_array.estimation.tracking.motion import OwnMotion, RandomMotion, in_beacon
from uuv_optical_array.estimation.tracking.root_filter import Belief, Reading, correct, triangular
from uuv_optical_array.forward.scene import AMBIENT, GRADIENTS

# What is beyond any sea but not beyond double precision, m and rad.
MAX_POSE, MIN_VARIANCE, MAX_VARIANCE, MAX_CONDITION = 1e6, 1e-24, 1e8, 1e13
RATE_STD = [0.5, 0.5, 0.5, 0.1, 0.1]  # m/s and rad/s, at the start of a track
# The state: the pose, its rate less what the commands say of it, constants, learnt gain errors, and
# what shades do to a pose, in standard deviations.
POSE, RATE, MOVING = slice(0, 5), slice(5, 10), 10
UNKNOWN_POSE = np.array([100.0, 100.0, 100.0, 10.0, 10.0])  # m and rad, of which nothing is known
# A manoeuvre is random motion so many times stronger for so long, s.
MANOEUVRE, MANOEUVRE_S = 5.0, 0.2
# Constants are learnt from one frame in so long, s. Slopes are those of noisy poses, and what they
# differ by from frame to frame looks like motion, from which more would be learnt than is there.
LEARN_EVERY_S = 2.0
# Most of a shaded pose's variance that lasts: the rest lets the track follow.
MOST_LASTING = 0.9
# Of a constant's standard deviation before any frame: below it nothing is learnt until it drifts.
LEAST_SHARE = 0.5
# Gain errors of more detectors are not learnt, but spoil their readings for ever.
MOST_LEARNT = 49

Relinearise = Callable[[Array], LinearisedReadings]


GateProbability = Annotated[
    float, Quantity("probability that a valid frame passes the gate", "", 0.5, 1)
]


class Outlier(NoPose):
    """The pose is too far from the track."""


class StampRefused(NoPose):
    """The frame is older than the buffer, or in it already.

    Parameters
    ----------
    message
        Why, its kind before the colon.
    newest_ns
        Stamp of the newest frame, ns.
    """

    def __init__(self, message: str, newest_ns: int) -> None:
        super().__init__(message)
        self.newest_ns = newest_ns


@dataclass(frozen=True)
class TrackerSettings:
    """The motion and the errors to expect, and when to forget."""

    velocity_walk_m_per_s: Annotated[
        float, Quantity("random change of the relative velocity in 1 s", "m/s", 1e-4, 10)
    ] = 0.1
    turn_walk_deg_per_s: Annotated[
        float, Quantity("random change of the relative turn rate in 1 s", "deg/s", 1e-3, 500)
    ] = 2.0
    common_share: Annotated[
        float, Quantity("share of a pose's variance that all frames have in common", "", 0, 0.99)
    ] = 0.1
    gate_probability: GateProbability = 0.9999
    reacquire_frames: Annotated[
        int, Quantity("outliers in a row that are the track when they agree", "", 2, 100)
    ] = 5
    reset_after_s: Annotated[
        float, Quantity("without a pose for longer, the track starts anew", "s", 0.1, 60)
    ] = 2.0
    buffer_s: Annotated[float, Quantity("how late a frame may come", "s", 0, 10)] = 0.5
    constants_hold_s: Annotated[
        float, Quantity("time in which the sea's constants drift to new values", "s", 60, 1e7)
    ] = 43_200.0


@dataclass(frozen=True)
class Track:
    """The filtered pose and its rate at one instant.

    Parameters
    ----------
    stamp_ns
        The instant, ns: that of the newest frame in the track, or the one of a prediction.
    pose
        ``(x, y, z, pitch, yaw)``, m and rad, shape ``(5,)``; yaw in [-pi, pi].
    rate
        Of `pose`, the commanded motion included, m/s and rad/s, shape ``(5,)``.
    joint_covariance
        Of `pose` and `rate`, shape ``(10, 10)``, positive definite.
    frames
        How many are in the track; 1 where it starts anew, with the pose as measured.
    distance
        Mahalanobis distance of the newest frame from its prediction, >= 0.
    constants
        What is known of the scene's constants by now, by dotted name.
    gains
        Relative gain errors of the detectors, as learnt, shape ``(n,)``; shape ``(0,)`` where they
        are not.
    """

    stamp_ns: int
    pose: Array
    rate: Array
    joint_covariance: Array
    frames: int
    distance: float
    constants: Mapping[str, Learnt] = field(default_factory=dict)
    gains: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def covariance(self) -> Array:
        """Covariance of `pose`, shape ``(5, 5)``, positive definite."""
        return self.joint_covariance[POSE, POSE]


class _Frame(NamedTuple):
    stamp_ns: int
    pose: Array
    root: Array  # of the covariance, lower triangular
    readings: LinearisedReadings | None
    relinearise: Relinearise | None
    lasting: float


@dataclass(frozen=True)
class _State:
    frame: _Frame  # the newest in the track
    belief: Belief  # without the common share
    learnt_ns: int  # stamp of the newest frame that constants were learnt from
    frames: int = 1
    distance: float = 0.0
    rival: "_State | None" = None  # the track of the outliers since
    outlier: float = 0.0  # distance of the newest frame of all, where that is one


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
        self._history: list[tuple[_Frame, _State]] = []
        self._forgotten: _State | None = None  # the last state of the track before
        self._own_motion = OwnMotion()
        self._constants = c = constants or Constants()
        learnt = c.detectors if c.gain_std > 0 and c.detectors <= MOST_LEARNT else 0
        self._spoilt = c.detectors if c.gain_std > 0 and not learnt else 0
        self._of_constants = slice(MOVING, MOVING + len(c.names))
        self._of_gains = slice(MOVING + len(c.names), MOVING + len(c.names) + learnt)
        shades = 5 if c.shade_lasts_s > 0 else 0
        self._of_shades = slice(self._of_gains.stop, self._of_gains.stop + shades)
        self._size = self._of_shades.stop
        # Standard deviations of all that lasts, before any frame.
        self._lasting = np.concatenate([c.stds, np.full(learnt, c.gain_std), np.ones(shades)])
        self._coordinates = JointCoordinates(c.frame, c.names) if c.frame else AsTheyAre()
        # Of the constants in which the light is not linear, the least standard deviations.
        bends = [name not in (AMBIENT, *GRADIENTS) for name in c.names]
        self._least = np.where(bends, LEAST_SHARE * np.array(c.stds), 0.0)
        self._linear = [*range(5), *range(MOVING, MOVING + len(c.names))]
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
        self._own_share = math.sqrt(1 - s.common_share)
        self._gate = math.sqrt(chdtri(5, 1 - s.gate_probability))
        self._buffer_ns, self._reset_ns = round(s.buffer_s * 1e9), round(s.reset_after_s * 1e9)
        self._hold_s = np.full(self._size, s.constants_hold_s)
        self._hold_s[self._of_shades] = self._constants.shade_lasts_s

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
            track asks for it midway between where it was and where `readings` take it. ``None``:
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
        Outlier
            For a pose beyond the gate.
        StampRefused
            For a frame older than the buffer, or a stamp that is in it.
        ValueError
            For a pose, covariance or readings of wrong shape or out of bounds.
        """
        s, history = self._settings, self._history
        if readings is not None:
            readings = _checked_readings(readings, self._constants)
        frame = _Frame(stamp_ns, *_checked(pose, covariance), readings, relinearise, lasting)
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
        newest = history[-1][1]
        return self._track(newest.frame.stamp_ns, newest.belief, newest)

    def constants(self, stamp_ns: int) -> tuple[Array, Array]:
        """Return what is known of the constants: the prior of the next frame's fit.

        Parameters
        ----------
        stamp_ns
            Of that frame, ns; they have drifted since the newest one in the track.

        Returns
        -------
        mean
            Of the offsets, in the order of their names, shape ``(q,)``.
        covariance
            Shape ``(q, q)``, positive definite.
        """
        state = self._history[-1][1] if self._history else self._forgotten
        belief, held = self._held(state, stamp_ns), self._of_constants
        covariance = belief.covariance
        return belief.mean[held].copy(), covariance[held, held]

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
        if not self._history:
            raise NoPose("no track: there is no frame yet")
        newest = self._history[-1][1]
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
        return self._track(stamp_ns, self._ahead(newest, stamp_ns), newest)

    def _track(self, stamp_ns: int, belief: Belief, newest: _State) -> Track:
        mean, covariance = belief.mean, belief.covariance
        stds = np.sqrt(covariance.diagonal()[self._of_constants]).tolist()
        offsets = mean[self._of_constants].tolist()
        joint = covariance[:MOVING, :MOVING].copy()
        if newest.frame.readings is None:
            root = newest.frame.root
            joint[POSE, POSE] += self._settings.common_share * (root @ root.T)
        return Track(
            stamp_ns,
            mean[POSE].copy(),
            mean[RATE] + in_beacon(mean[POSE], self._own_motion.twist(stamp_ns)),
            joint,
            newest.frames,
            newest.distance,
            dict(zip(self._constants.names, map(Learnt, offsets, stds), strict=True)),
            mean[self._of_gains].copy(),
        )

    def _next(self, state: _State, frame: _Frame) -> _State:
        if frame.stamp_ns - state.frame.stamp_ns > self._reset_ns:
            return self._start(frame, state)
        fused = self._fuse(state, frame)
        if fused.distance <= self._gate:
            return fused
        bold = self._fuse(state, frame, manoeuvring=True)
        if bold.distance <= self._gate:
            return bold
        rival = self._fuse(state.rival, frame) if state.rival else None
        if rival is None or rival.distance > self._gate:
            rival = self._start(frame, state)
        if rival.frames >= self._settings.reacquire_frames:
            return rival
        return replace(state, rival=rival, outlier=fused.distance)

    def _start(self, frame: _Frame, before: _State | None) -> _State:
        """Return a new track, which keeps what was learnt of the constants."""
        mean, root, shared = self._held(before, frame.stamp_ns)
        mean[POSE] = frame.pose
        own, lasts = self._errors(frame)
        if frame.readings is not None:
            mean[POSE], own = frame.readings.at[:5], np.diag(UNKNOWN_POSE)
        anew = block_diag(own, self._random_motion.start, root[MOVING:])
        belief = Belief(mean, anew, shared)
        if frame.readings is None:
            anew[POSE, MOVING:] = lasts @ root[self._of_shades]
        else:
            belief, _ = self._corrected(belief, frame, True)
        return _State(frame, belief, frame.stamp_ns)

    def _held(self, state: _State | None, stamp_ns: int) -> Belief:
        """Return a belief in nothing but what lasts, at a stamp."""
        if state is None:
            nothing = np.zeros((self._size, self._spoilt))
            root = np.vstack([np.zeros((MOVING, len(self._lasting))), np.diag(self._lasting)])
            return Belief(np.zeros(self._size), root, nothing)
        step_s = (stamp_ns - state.frame.stamp_ns) * 1e-9
        mean, root, shared = self._drifted(state.belief, step_s)
        root = np.vstack([np.zeros((MOVING, len(self._lasting))), triangular(root[MOVING:])])
        mean[:MOVING], shared[:MOVING] = 0.0, 0.0
        return Belief(mean, root, shared)

    def _drifted(self, belief: Belief, step_s: float) -> Belief:
        """Let what lasts drift."""
        held = drift(self._settings.constants_hold_s, step_s)
        kept = drift(self._hold_s[MOVING:], step_s)
        mean, root = belief.mean.copy(), belief.root.copy()
        mean[MOVING:] *= kept
        root[MOVING:] *= kept[:, None]
        fresh = np.zeros((self._size, len(self._lasting)))
        fresh[MOVING:] = np.diag(np.sqrt(1 - kept**2) * self._lasting)
        shared = belief.shared.copy()
        shared[MOVING:] *= kept[:, None]
        # The numbers that spoil the readings drift, too: what came of the old ones is left behind.
        lost = np.sqrt(1 - held**2)
        return Belief(mean, np.hstack([root, fresh, lost * shared]), held * shared)

    def _ahead(self, state: _State, stamp_ns: int, manoeuvring: bool = False) -> Belief:
        """Return the belief of a state at a later stamp."""
        start_ns = state.frame.stamp_ns
        step_s = (stamp_ns - start_ns) * 1e-9
        mean, root, shared = self._drifted(state.belief, step_s)
        for part in (mean, root, shared):
            part[POSE] += step_s * part[RATE]
        # The attitude's error turns the own motion by so little that the random motion covers it.
        at = state.belief.mean[POSE]
        mean[POSE] += in_beacon(at, self._own_motion.way(start_ns, stamp_ns))
        noises = [self._random_motion.noise(step_s)]
        if manoeuvring:
            noises.append(MANOEUVRE * self._random_motion.noise(MANOEUVRE_S))
        noise = np.hstack(noises)
        random = np.zeros((self._size, noise.shape[1]))
        random[:MOVING] = noise
        return Belief(wrapped(mean), np.hstack([root, random]), shared)

    def _fuse(self, state: _State, frame: _Frame, manoeuvring: bool = False) -> _State:
        ahead = self._ahead(state, frame.stamp_ns, manoeuvring)
        due = frame.stamp_ns - state.learnt_ns >= LEARN_EVERY_S * 1e9
        learns = due and frame.readings is not None and self._worth_learning(ahead)
        belief, distance = self._corrected(ahead, frame, learns)
        learnt_ns = frame.stamp_ns if learns else state.learnt_ns
        return _State(frame, belief, learnt_ns, state.frames + 1, distance)

    def _worth_learning(self, belief: Belief) -> bool:
        """Say whether no constant that bends the light is known well."""
        stds = np.linalg.norm(np.hstack(belief[1:])[self._of_constants], axis=1)
        return bool((stds >= self._least).all())

    def _errors(self, frame: _Frame) -> tuple[Array, Array]:
        """Return roots of what is new in a pose's errors, and of what shades leave there.

        The first has the shape ``(5, 5)``; the second, by the states of the shades, ``(5, 0)`` or
        ``(5, 5)``.
        """
        shades = self._of_shades.stop - self._of_shades.start
        share = MOST_LASTING * frame.lasting if shades else 0.0
        root = self._own_share * frame.root
        return math.sqrt(1 - share) * root, math.sqrt(share) * root[:, :shades]

    def _corrected(self, belief: Belief, frame: _Frame, learns: bool) -> tuple[Belief, float]:
        """Return a belief corrected by a frame, and the distance of the frame from it."""
        learnt = self._of_gains.stop if learns else MOVING
        if frame.readings is not None:
            belief, distance = self._corrected_by_readings(
                belief, frame.readings, frame.relinearise, learnt
            )
            return belief._replace(mean=wrapped(belief.mean)), distance
        own, lasts = self._errors(frame)
        slopes = np.eye(5, self._size)
        slopes[:, self._of_shades] = lasts
        off = wrapped(frame.pose - belief.mean[POSE])
        reading = Reading(off, slopes, own, np.zeros(0))
        belief, distance = correct(belief, reading, learnt)
        return belief._replace(mean=wrapped(belief.mean)), distance

    def _corrected_by_readings(
        self,
        belief: Belief,
        readings: LinearisedReadings,
        relinearise: Relinearise | None,
        learnt: int,
    ) -> tuple[Belief, float]:
        entries, coordinates = self._linear, self._coordinates
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
            again = _checked_readings(relinearise(place), self._constants)
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
        off = self._coordinates.difference(belief.mean[self._linear], at)
        slopes = readings.slopes @ by_coordinates
        # A reading that says nothing is one that nothing moves.
        says = np.isfinite(readings.variances)
        light = np.where(says, readings.light, 0.0)
        by_state = np.zeros((len(says), self._size))
        by_state[:, self._linear] = np.where(says[:, None], slopes, 0.0)
        residual = np.where(says, readings.residuals, 0.0) - by_state[:, self._linear] @ off
        gains = self._of_gains
        if gains.stop > gains.start:
            by_state[:, gains] = np.diag(light)
            residual -= light * belief.mean[gains]
        noise = np.diag(np.sqrt(np.where(says, readings.variances, 1.0)))
        spoilt = self._constants.gain_std * light if self._spoilt else np.zeros(0)
        return Reading(residual, by_state, noise, spoilt)


def _turned(belief: Belief, entries: list[int], slopes: Array, place: Array) -> Belief:
    """Return a belief of which some entries are given in other coordinates, by their slopes."""
    mean, root, shared = (part.copy() for part in belief)
    mean[entries] = place
    root[entries] = slopes @ root[entries]
    shared[entries] = slopes @ shared[entries]
    return Belief(mean, root, shared)


def _stamp(entry: tuple[_Frame, _State]) -> int:
    return entry[0].stamp_ns


def _checked(pose: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    pose, covariance = np.array(pose, dtype=float), np.asarray(covariance, dtype=float)
    cure = f"give ({', '.join(DOF_NAMES)}), five numbers within +-{MAX_POSE:g}"
    if pose.shape != (5,):
        raise ValueError(f"pose: {pose.tolist()}; {cure}")
    for name, value in zip(DOF_NAMES, pose.tolist(), strict=True):
        if not abs(value) <= MAX_POSE:
            raise ValueError(f"pose: {name} is {value}; {cure}")
    if covariance.shape != (5, 5) or not np.isfinite(covariance).all():
        raise ValueError(f"covariance: {covariance.tolist()}; give 5 x 5 finite numbers")
    if np.abs(covariance - covariance.T).max() > 1e-9 * np.abs(covariance).max():
        raise ValueError(f"covariance: {covariance.tolist()} is not symmetric; give (C + C^T) / 2")
    low, *_, high = np.linalg.eigvalsh(covariance)
    if not max(MIN_VARIANCE, high / MAX_CONDITION) <= low <= high <= MAX_VARIANCE:
        raise ValueError(
            f"covariance: its eigenvalues are {low:.3g} to {high:.3g}; give a positive definite "
            f"one, from {MIN_VARIANCE:g} to {MAX_VARIANCE:g} and in a ratio of {MAX_CONDITION:g}"
        )
    return wrapped(pose), np.linalg.cholesky(covariance)


def _checked_readings(readings: LinearisedReadings, constants: Constants) -> LinearisedReadings:
    """Return readings as arrays of the tracker's own."""
    readings = LinearisedReadings(*(np.array(part, dtype=float) for part in readings))
    width = 5 + len(constants.names)
    count = constants.detectors if constants.gain_std > 0 else readings.residuals.size
    shapes = ((width,), (count,), (count, width), (count,), (count,))
    for name, part, shape in zip(readings._fields, readings, shapes, strict=True):
        if part.shape != shape:
            raise ValueError(f"readings: {name} has the shape {part.shape}; give {shape}")
        if not (np.isfinite(part) | ((part > 0) & (name == "variances"))).all():
            raise ValueError(f"readings: {name} holds numbers that are not finite")
    if not (readings.variances > 0).all():
        low = readings.variances.min()
        raise ValueError(f"readings: a variance is {low:g}; give variances > 0, inf for no reading")
    return readings
