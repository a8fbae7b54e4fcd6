"""One track through the poses of many frames: a Kalman filter of the pose and its rate.

Where the tracker is told the follower's commands, the pose moves by them and by what is left, the
motion of the leader; without commands that rest is the whole relative motion (`motion`).
Covariances are kept as triangular roots (T. Kailath, A. H. Sayed and B. Hassibi, *Linear
Estimation*, 2000, ch. 12), which stay positive definite whatever the rounding.

Only errors that are new in every frame average out. The part that is not, such as the bias of a
grid, is ``common_share``; errors that last for some frames lie between and are not modelled.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, solve_triangular
from scipy.special import chdtri

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, YAW, Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.motion import OwnMotion, RandomMotion, in_beacon

# What is beyond any sea but not beyond double precision, m and rad.
MAX_POSE, MIN_VARIANCE, MAX_VARIANCE, MAX_CONDITION = 1e6, 1e-24, 1e8, 1e13
RATE_STD = [0.5, 0.5, 0.5, 0.1, 0.1]  # m/s and rad/s, at the start of a track
# The state: the pose, and its rate less what the commands say of it.
POSE, RATE = slice(0, 5), slice(5, 10)


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
    """

    stamp_ns: int
    pose: Array
    rate: Array
    joint_covariance: Array
    frames: int
    distance: float

    @property
    def covariance(self) -> Array:
        """Covariance of `pose`, shape ``(5, 5)``, positive definite."""
        return self.joint_covariance[POSE, POSE]


class _Frame(NamedTuple):
    stamp_ns: int
    pose: Array
    root: Array  # of the covariance, lower triangular


@dataclass(frozen=True)
class _State:
    frame: _Frame  # the newest in the track
    mean: Array
    root: Array  # of the covariance without the common share
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
    """

    def __init__(
        self, settings: TrackerSettings, random_motion: RandomMotion | None = None
    ) -> None:
        # The buffer by stamp and the last frame before it, each with the state it led to.
        self._history: list[tuple[_Frame, _State]] = []
        self._own_motion = OwnMotion()
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

    def reset(self) -> None:
        """Forget the track; the commands stay."""
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

    def update(self, stamp_ns: int, pose: ArrayLike, covariance: ArrayLike) -> Track:
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
            For a pose or covariance of wrong shape or out of bounds.
        """
        s, history = self._settings, self._history
        frame = _Frame(stamp_ns, *_checked(pose, covariance))
        newest_ns = _stamp(history[-1]) if history else stamp_ns
        age_ns = newest_ns - stamp_ns
        if age_ns > self._buffer_ns + self._reset_ns:
            history = []
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
            state = self._next(state, later)
            history.append((later, state))
        oldest = bisect_left(history, _stamp(history[-1]) - self._buffer_ns, key=_stamp)
        self._history = history[max(oldest - 1, 0) :]
        if distance := history[place][1].outlier:
            raise Outlier(
                f"outlier: {distance:.3g} standard deviations off, more than {self._gate:.3g}"
            )
        newest = history[-1][1]
        return self._track(newest.frame.stamp_ns, newest.mean, newest.root, newest)

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
        return self._track(stamp_ns, *self._ahead(newest, stamp_ns), newest)

    def _track(self, stamp_ns: int, mean: Array, root: Array, newest: _State) -> Track:
        own = in_beacon(mean[POSE], self._own_motion.twist(stamp_ns))
        common = np.zeros((10, 5))
        common[POSE] = math.sqrt(self._settings.common_share) * newest.frame.root
        root = np.hstack([root, common])
        return Track(
            stamp_ns,
            mean[POSE].copy(),
            mean[RATE] + own,
            root @ root.T,
            newest.frames,
            newest.distance,
        )

    def _next(self, state: _State | None, frame: _Frame) -> _State:
        if state is None or frame.stamp_ns - state.frame.stamp_ns > self._reset_ns:
            return self._start(frame)
        fused = self._fuse(state, frame)
        if fused.distance <= self._gate:
            return fused
        rival = self._fuse(state.rival, frame) if state.rival else None
        if rival is None or rival.distance > self._gate:
            rival = self._start(frame)
        if rival.frames >= self._settings.reacquire_frames:
            return rival
        return replace(state, rival=rival, outlier=fused.distance)

    def _start(self, frame: _Frame) -> _State:
        root = block_diag(self._own_share * frame.root, self._random_motion.start)
        return _State(frame, np.concatenate([frame.pose, np.zeros(5)]), root)

    def _ahead(self, state: _State, stamp_ns: int) -> tuple[Array, Array]:
        """Return mean and root of a state at a later stamp."""
        start_ns = state.frame.stamp_ns
        step_s = (stamp_ns - start_ns) * 1e-9
        ahead = np.eye(10) + step_s * np.eye(10, k=5)
        mean = ahead @ state.mean
        # The attitude's error turns the own motion by so little that the random motion covers it.
        mean[POSE] += in_beacon(state.mean[POSE], self._own_motion.way(start_ns, stamp_ns))
        root = np.hstack([ahead @ state.root, self._random_motion.noise(step_s)])
        return _wrapped(mean), root

    def _fuse(self, state: _State, frame: _Frame) -> _State:
        mean, prior = self._ahead(state, frame.stamp_ns)
        joint: Array = np.block(
            [[self._own_share * frame.root, prior[POSE]], [np.zeros((10, 5)), prior]]
        )
        # Made triangular, it holds the root of the innovation, the gain and the new root.
        joint = np.asarray(np.linalg.qr(joint.T, mode="r")).T
        innovation = _wrapped(frame.pose - mean[POSE])
        innovation = solve_triangular(joint[:5, :5], innovation, lower=True)
        mean = _wrapped(mean + joint[5:, :5] @ innovation)
        distance = float(np.linalg.norm(innovation))
        return _State(frame, mean, joint[5:, 5:], state.frames + 1, distance)


def _stamp(entry: tuple[_Frame, _State]) -> int:
    return entry[0].stamp_ns


def _wrapped(state: Array) -> Array:
    state[YAW] = math.remainder(state[YAW], 2 * math.pi)
    return state


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
    return _wrapped(pose), np.linalg.cholesky(covariance)
