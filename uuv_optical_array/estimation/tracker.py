"""One track through the poses of many frames: a Kalman filter at constant velocity.

The motion is white-noise acceleration (Y. Bar-Shalom, X.-R. Li and T. Kirubarajan, *Estimation
with Applications to Tracking and Navigation*, 2001, ch. 6). Covariances are kept as triangular
roots (T. Kailath, A. H. Sayed and B. Hassibi, *Linear Estimation*, 2000, ch. 12), which stay
positive definite whatever the rounding.

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
from uuv_optical_array.core.geometry import YAW, Array
from uuv_optical_array.core.settings import Quantity

# What is beyond any sea but not beyond double precision, m and rad.
MAX_POSE, MIN_VARIANCE, MAX_VARIANCE, MAX_CONDITION = 1e6, 1e-24, 1e8, 1e13
RATE_STD = [0.5, 0.5, 0.5, 0.1, 0.1]  # m/s and rad/s, at the start of a track


class Outlier(NoPose):
    """The pose is too far from the track."""


class StampRefused(NoPose):
    """The frame is older than the buffer, or in it already."""


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
    gate_probability: Annotated[
        float, Quantity("share of honest frames that are no outliers", "", 0.5, 1)
    ] = 0.9999
    reacquire_frames: Annotated[
        int, Quantity("outliers in a row that are the track when they agree", "", 2, 100)
    ] = 5
    reset_after_s: Annotated[
        float, Quantity("without a pose for longer, the track starts anew", "s", 0.1, 60)
    ] = 2.0
    buffer_s: Annotated[float, Quantity("how late a frame may come", "s", 0, 10)] = 0.5


@dataclass(frozen=True)
class Track:
    """The filtered pose.

    Parameters
    ----------
    stamp_ns
        Of the newest frame in the track, ns; all else is at that instant.
    pose
        ``(x, y, z, pitch, yaw)``, m and rad, shape ``(5,)``; yaw in [-pi, pi].
    covariance
        Of `pose`, shape ``(5, 5)``, positive definite.
    rate
        Of `pose`, m/s and rad/s, shape ``(5,)``.
    frames
        How many are in the track; 1 where it starts anew, with the pose as measured.
    distance
        Mahalanobis distance of the newest frame from its prediction, >= 0.
    """

    stamp_ns: int
    pose: Array
    covariance: Array
    rate: Array
    frames: int
    distance: float


class _Frame(NamedTuple):
    stamp_ns: int
    pose: Array
    root: Array  # of the covariance, lower triangular


@dataclass(frozen=True)
class _State:
    frame: _Frame  # the newest in the track
    mean: Array  # pose and rate
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
    """

    def __init__(self, settings: TrackerSettings) -> None:
        self._settings = s = settings
        walk = [s.velocity_walk_m_per_s, math.radians(s.turn_walk_deg_per_s)]
        self._walk = np.diag(np.repeat(walk, [3, 2]))
        self._own_share = math.sqrt(1 - s.common_share)
        self._gate = math.sqrt(chdtri(5, 1 - s.gate_probability))
        self._buffer_ns, self._reset_ns = round(s.buffer_s * 1e9), round(s.reset_after_s * 1e9)
        # The buffer by stamp and the last frame before it, each with the state it led to.
        self._history: list[tuple[_Frame, _State]] = []

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
            Of a later stamp where this frame came late.

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
        age_ns = _stamp(history[-1]) - stamp_ns if history else 0
        if age_ns > self._buffer_ns + self._reset_ns:
            history = []
        elif age_ns > self._buffer_ns:
            raise StampRefused(
                f"late frame: {age_ns * 1e-9:.3f} s older than the newest, more than "
                f"buffer_s {s.buffer_s:g}"
            )
        place = bisect_left(history, stamp_ns, key=_stamp)
        history, late = history[:place], history[place:]
        if late and _stamp(late[0]) == stamp_ns:
            raise StampRefused(f"repeated stamp: {stamp_ns} ns is in the track already")
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
        common = math.sqrt(s.common_share) * newest.frame.root
        root = np.hstack([newest.root[:5], common])
        return Track(
            newest.frame.stamp_ns,
            newest.mean[:5].copy(),
            root @ root.T,
            newest.mean[5:].copy(),
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
        root = block_diag(self._own_share * frame.root, np.diag(RATE_STD))
        return _State(frame, np.concatenate([frame.pose, np.zeros(5)]), root)

    def _fuse(self, state: _State, frame: _Frame) -> _State:
        step_s = (frame.stamp_ns - state.frame.stamp_ns) * 1e-9
        ahead = np.eye(10) + step_s * np.eye(10, k=5)
        # A root of the walk^2 [step^3 / 3, step^2 / 2; step^2 / 2, step] of white noise.
        shape = np.array([[step_s / math.sqrt(3), 0.0], [math.sqrt(3) / 2, 0.5]])
        noise = math.sqrt(step_s) * np.kron(shape, self._walk)
        prior = np.hstack([ahead @ state.root, noise])
        joint: Array = np.block(
            [[self._own_share * frame.root, prior[:5]], [np.zeros((10, 5)), prior]]
        )
        # Made triangular, it holds the root of the innovation, the gain and the new root.
        joint = np.asarray(np.linalg.qr(joint.T, mode="r")).T
        mean = ahead @ state.mean
        innovation = _wrapped(frame.pose - mean[:5])
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
    if pose.shape != (5,) or not (np.abs(pose) <= MAX_POSE).all():
        raise ValueError(f"pose: {pose.tolist()}; give five numbers within +-{MAX_POSE:g}")
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
