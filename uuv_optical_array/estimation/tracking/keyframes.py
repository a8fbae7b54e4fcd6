"""What is known of the biases by keyframes: frames that are linearised again as more is learnt.

A filter that learns constants keeps each frame as it was linear at the constants of its time, and
that error stays. So frames from places that are new become keyframes, which keep their images. They
are linearised anew when the biases have become known better, each where the track expected it
before its image came, moved with the biases: at a place that its own noise chose, slopes and noise
would be correlated, which biases what is learnt, the same in each frame. Their poses are free; what
these leave of the frames fits the biases by Gauss and Newton, in steps that are halved until the
likelihood does not fall.

When there are too many, every second one is left out, and from then on twice the time is between
them; a sum of frames as they were linear once would go wrong where slopes change, as they do with
the logarithm of the scattering. The oldest are left out before the biases have drifted far. What
the rest say is as old as they are on average.
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import Biases, BiasSpace
from uuv_optical_array.estimation.unknowns.joint_coordinates import AsTheyAre

EVERY_S = 0.5  # between keyframes, at first
NEW_PLACE = np.array([0.1, 0.1, 0.1, 0.05, 0.05])  # m and rad from the last keyframe
MOST_READINGS = 6000
# Older ones than this share of the time in which biases drift are left out, but of so few.
MEMORY, FEWEST = 0.02, 30
MOST_HALVINGS = 6
CLOSE = 0.1  # posterior standard deviations within which frames are linear enough


class Keyframe(NamedTuple):
    """A frame of a track.

    - stamp_ns: of its image, ns.
    - pose: where the track expected it before its image came, m and rad, shape ``(5,)``.
    - place, slopes: the same in straight coordinates, and its slopes by the biases, shapes ``(5,)``
      and ``(5, k)``.
    - biases: as they were expected then, shape ``(k,)``.
    - readings_at: returns its readings linearised at pose and constants, shape ``(5 + q,)``.
    """

    stamp_ns: int
    pose: Array
    place: Array
    slopes: Array
    biases: Array
    readings_at: Callable[[Array], LinearisedReadings]


class Keyframes(NamedTuple):
    """Keyframes as they are linear near some biases.

    - biases: at these, shape ``(k,)``.
    - every_s: least time between them, s.
    - frames: from the oldest to the newest.
    - squares: of each the squares and products of its residuals and of the slopes of these by the
      biases, shape ``(1 + k, 1 + k)``. First is twice the negative log-likelihood.
    """

    biases: Array
    every_s: float
    frames: tuple[Keyframe, ...]
    squares: tuple[Array, ...]

    def want(self, stamp_ns: int, pose: Array) -> bool:
        """Say whether a frame of that stamp, ns, and pose, m and rad, is to be a keyframe."""
        if not self.frames:
            return len(self.biases) > 0
        last = self.frames[-1]
        moved, step_s = (pose - last.pose) / NEW_PLACE, (stamp_ns - last.stamp_ns) * 1e-9
        return bool(abs(step_s) >= self.every_s and moved @ moved >= 1)  # clocks are set back, too


class BiasFit:
    """Fits biases to keyframes.

    - space: of the biases.
    - hold_s: time in which biases drift to new values, s.
    - coordinates: straight ones of pose and constants.
    """

    def __init__(self, space: BiasSpace, hold_s: float, coordinates: AsTheyAre) -> None:
        self._space, self._coordinates = space, coordinates
        self._memory_ns = MEMORY * hold_s * 1e9

    def prior(self) -> Keyframes:
        """Return that there is no keyframe yet."""
        return Keyframes(np.zeros(self._space.learnt), EVERY_S, (), ())

    def fitted(self, keyframes: Keyframes, frame: Keyframe) -> tuple[Keyframes, Biases]:
        """Return keyframes with one more, and the biases that fit them, at its stamp."""
        biases, every_s, frames, squares = keyframes
        (newest,), count = self._squares((frame,), biases)
        oldest_ns = frame.stamp_ns - self._memory_ns
        first = bisect_left(frames, oldest_ns, key=lambda each: each.stamp_ns)
        first = min(first, max(len(frames) - FEWEST, 0))
        frames, squares = (*frames[first:], frame), (*squares[first:], newest)
        if len(frames) > max(MOST_READINGS // count, 1):
            every_s, frames, squares = 2 * every_s, frames[::-2][::-1], squares[::-2][::-1]
        fit = Keyframes(biases, every_s, frames, squares)
        cost, step, root = _step(fit)
        if np.linalg.norm(root.T @ step) > CLOSE:
            for _ in range(1 + MOST_HALVINGS):
                biases = fit.biases + step
                again, _ = self._squares(fit.frames, biases)
                nearer = fit._replace(biases=biases, squares=tuple(again))
                following = _step(nearer)
                if following[0] <= cost:
                    fit, (_, step, root) = nearer, following
                    break
                step = step / 2
            else:  # no part of it is better
                step = np.zeros_like(step)
        inverse = lapack.dpotri(root, lower=1)[0]
        covariance = np.tril(inverse) + np.tril(inverse, -1).T
        ages_s = [(frame.stamp_ns - each.stamp_ns) * 1e-9 for each in fit.frames]
        told = [each.trace() - each[0, 0] for each in fit.squares]  # how much each says
        age_s = float(np.average(ages_s, weights=told)) if any(told) else 0.0
        return fit, self._space.drifted(Biases(fit.biases + step, covariance), age_s)

    def _squares(self, frames: Sequence[Keyframe], biases: Array) -> tuple[Array, int]:
        """Return squares and products of keyframes at biases, and how many readings one has."""
        offsets, of = self._space.offsets(biases), self._space.constants
        readings = []
        for frame in frames:
            place = frame.place + frame.slopes @ (biases - frame.biases)
            pose, _ = self._coordinates.place(np.concatenate([place, offsets]))
            readings.append(frame.readings_at(pose))
        stacked = LinearisedReadings(*map(np.array, zip(*readings, strict=True)))
        residuals, by_pose, by_biases = self._space.whitened(stacked, stacked.slopes)
        # Readings that cannot be linearised again are linear at constants of their own.
        off = np.tile(biases, (len(frames), 1))
        off[:, of] = (offsets - stacked.at[:, 5:]) / self._space.stds[of]
        rows = np.concatenate([residuals[..., None] - by_biases @ off[..., None], by_biases], 2)
        basis, _ = np.linalg.qr(by_pose)
        rows -= basis @ (basis.transpose(0, 2, 1) @ rows)
        squares = rows.transpose(0, 2, 1) @ rows
        squares[:, 0, 0] += stacked.deviances.sum(axis=1)
        return squares, residuals.shape[1]


def _step(keyframes: Keyframes) -> tuple[float, Array, Array]:
    """Return what biases cost, Gauss and Newton's step, and the lower root of the information.

    The cost is twice the negative logarithm of their posterior density, but for a constant.
    """
    biases, squares = keyframes.biases, np.sum(keyframes.squares, axis=0)
    root = lapack.dpotrf(np.eye(len(biases)) + squares[1:, 1:], lower=1)[0]
    step, _ = lapack.dpotrs(root, squares[1:, 0] - biases, lower=1)
    return float(squares[0, 0] + biases @ biases), step, root
