"""What changed suddenly, found by the last frames together and by how vehicles move.

With a free pose a dimmer lamp looks like a longer range, and the rest like something else. But
vehicles do not jump: over the last frames the pose follows the follower's own motion and a random
walk of the rate, and biases are one draw of their prior. Readings y, linear in both, are Gaussian
with a covariance S. An error of N(0, s^2) that began with one of the frames, with slopes d from
there on, makes them likelier by ``exp(s^2 n^2 / (1 + s^2 i) / 2) / sqrt(1 + s^2 i)``, where
``i = d' S^-1 d`` and ``n = d' S^-1 y``, and is expected to be ``s^2 n / (1 + s^2 i)``. Of all, the
likeliest by the prior probability of its kind is what changed (A. S. Willsky and H. L. Jones, 1976,
IEEE Trans. Automatic Control 21, 108).

All frames are linearised on one smooth path, at the scene's constants: the track itself jumps with
the change, and the light's curvature over that jump is as large as the difference between lamp and
water. The path is straight but for the own motion. Sizes are of the first order.

Absorption and scattering dim the light almost alike while the range hardly changes, as within
seconds, and almost as a dimmer lamp does: the more frequent change is named.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import YAW, Array
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import BiasSpace
from uuv_optical_array.estimation.tracking.measurement import Relinearise
from uuv_optical_array.estimation.tracking.motion import LONG_AGO_NS, RATE_STD

SPAN_NS, EVERY_NS = 3_500_000_000, 90_000_000  # of the frames kept; the least time between two
FEWEST = 3  # for a way
FIRST_POSE_STD = np.repeat([2.0, 1.0], [3, 2])  # of the first pose about a straight way, m and rad
PATH_ROUNDING = 3e-5  # of a pose given those before, m and rad


class Change(NamedTuple):
    """An error that began in the last frames.

    - error: its place among those asked for.
    - size: in standard deviations of the prior.
    - evidence: logarithm of how much likelier it is than that nothing changed.
    """

    error: int
    size: float
    evidence: float


class Changes:
    """Keeps the last frames of a track, to find what changed in them.

    - space: of the biases.
    - walk: standard deviations of the change of the rate in 1 s, m/s and rad/s, shape ``(5,)``.
    - newest_ns: stamp of the last frame, ns.
    """

    def __init__(self, space: BiasSpace, walk: Array) -> None:
        self._space, self._walk = space, walk
        self._way: Array = np.zeros(5)
        self.newest_ns = LONG_AGO_NS
        # Of each its stamp, the way up to it, its pose, and how to linearise it.
        self._frames: deque[tuple[int, Array, Array, Relinearise]] = deque()

    def add(self, stamp_ns: int, way: Array, pose: Array, relinearise: Relinearise) -> None:
        """Take a frame; one that is no newer than the last is the first again.

        - way: of the pose since the last frame by the follower's own motion, shape ``(5,)``.
        - pose: of the track, m and rad, shape ``(5,)``.
        - relinearise: as of `Tracker.take`.
        """
        if stamp_ns <= self.newest_ns:
            self._frames.clear()
        self._way, self.newest_ns = self._way + way, stamp_ns
        if not self._frames or stamp_ns - self._frames[-1][0] >= EVERY_NS:
            self._frames.append((stamp_ns, self._way, pose.copy(), relinearise))
        while stamp_ns - self._frames[0][0] > SPAN_NS:
            self._frames.popleft()

    def likeliest(self, directions: Array, std: float, odds: Array) -> Change | None:
        """Return the likeliest change; None if there are too few frames, or not finite ones.

        - directions: of what may have changed, in biases, constants before gains, shape
          ``(count or more, k)``.
        - std: of such changes, in standard deviations of the prior.
        - odds: that it changed in a frame, to that nothing did, shape ``(k,)``.
        """
        if len(self._frames) < FEWEST:
            return None
        stamps, ways, poses, near = zip(*self._frames, strict=True)
        time_s, found = (np.array(stamps) - stamps[0]) * 1e-9, np.array(poses)
        found[:, YAW] = np.unwrap(found[:, YAW])
        rate, first = np.polyfit(time_s, found - ways, 1)
        expected = first + time_s[:, None] * rate + ways
        early, late = np.minimum.outer(time_s, time_s), np.maximum.outer(time_s, time_s)
        walked = early**2 * (late - early / 3) / 2  # covariance of a rate's integrated random walk
        spread = np.stack([np.full_like(early, 1.0), early * late, walked, np.eye(len(time_s))])
        by = np.square([FIRST_POSE_STD, RATE_STD, self._walk, np.full(5, PATH_ROUNDING)])
        paths = np.tensordot(by.T, spread, 1)  # (5, t, t), one of each axis
        roots = np.linalg.cholesky(paths)
        places = np.pad(expected, ((0, 0), (0, self._space.constants.stop)))
        try:
            readings = [each(place) for each, place in zip(near, places, strict=True)]
        except ValueError:
            return None
        stacked = LinearisedReadings(*map(np.array, zip(*readings, strict=True)))
        whole = self._space.whitened(stacked, stacked.slopes)
        by_pose, by_biases, y = whole[..., :5], whole[..., 5:-1], whole[..., -1]
        of_path = np.einsum("tna,ats->tnas", by_pose, roots).reshape(*y.shape, -1)
        root = np.concatenate([by_biases, of_path], axis=2).reshape(y.size, -1)
        # S = I + root root', and its inverse is I - basis basis'.
        basis = np.linalg.qr(np.vstack([root, np.eye(root.shape[1])]))[0][: y.size]
        basis = basis.reshape(*y.shape, -1)
        white = y - basis @ np.einsum("tnb,tn->b", basis, y)
        changed = by_biases @ directions[: self._space.count]
        parts = (
            np.einsum("tnk,tn->tk", changed, white),
            np.square(changed).sum(axis=1),
            basis.swapaxes(1, 2) @ changed,
        )
        # What began with a frame is in it and all later ones.
        n, alone, shared = (np.cumsum(part[::-1], axis=0)[-2::-1] for part in parts)
        wider = 1 + std**2 * (alone - np.square(shared).sum(axis=1))
        evidence = std**2 * n**2 / wider / 2 - np.log(wider) / 2 + np.log(odds)
        since, error = np.unravel_index(evidence.argmax(), evidence.shape)
        size = float((std**2 * n / wider)[since, error])
        return Change(int(error), size, float(evidence[since, error]))
