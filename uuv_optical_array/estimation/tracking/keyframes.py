"""What is known of the biases by keyframes: frames that are linearised again as more is learnt.

A filter that learns constants keeps each frame linearised at the constants of its time, and that
error stays. So frames from new places become keyframes, which keep their images. They are
linearised anew as the biases become known better, each where the track expected it before its image
came, moved with the biases: at a place that its own noise chose, slopes and noise would be
correlated, which biases what is learnt, the same in each frame. In a manoeuvre it was expected too
far off to be linear from there, and is linearised where it was found. Their poses are free; what
these leave fits the biases by Gauss and Newton. Far from the likely biases linear images misjudge
the likelihood, so steps are halved until the next is shorter in standard deviations.

A place is new where it is farther from the last one than one image tells places apart. Frames of
the same place share the error of the place at which they are linearised, and would teach the biases
that error as often as there are frames.

When there are too many, every second one is left out and the time between them doubles; a sum of
frames linearised once would go wrong where slopes change, as with the logarithm of scattering. The
oldest are left out before the biases have drifted far. What the rest say has their average age.
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from uuv_optical_array.core.geometry import Array, wrapped
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import Biases, BiasSpace
from uuv_optical_array.estimation.tracking.measurement import Measurement
from uuv_optical_array.estimation.tracking.motion import LONG_AGO_NS
from uuv_optical_array.estimation.unknowns.joint_coordinates import JointCoordinates

EVERY_S = 0.09  # between keyframes, at first: ten a second, of stamps that vary a little
NEW_PLACE = 1.0  # from the last keyframe, in standard deviations of the pose of one frame
MOST_READINGS = 12_000
# Older ones than this share of the time in which biases drift are left out, but of so few.
MEMORY, FEWEST = 0.02, 30
MOST_HALVINGS = 6
# A step is as good as linear where its length in standard deviations of the prior times that in
# those of the posterior is less: the error of second order in the latter, for curvatures of 1.
LINEAR = 0.3


class Keyframe(NamedTuple):
    """A frame of a track.

    - stamp_ns: of its image, ns.
    - pose: where it is linearised, m and rad, shape ``(5,)``.
    - place, slopes: `pose` in straight coordinates, its slopes by the biases, ``(5,)``, ``(5, k)``.
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
    - squares: of each, products of its residuals and their slopes by biases, ``(1 + k, 1 + k)``.
    - ranges: the same of ranges, at biases of 0; ``ranged_ns``: stamp of the newest, ns.
    """

    biases: Array
    every_s: float
    frames: tuple[Keyframe, ...]
    squares: tuple[Array, ...]
    ranges: Array
    ranged_ns: int = LONG_AGO_NS

    def ranged(self, stamp_ns: int, says: Array, kept: float) -> "Keyframes":
        """Return them with a range, and of older ranges so much, a share.

        - says: residual at biases of 0 and slopes by the biases, of variance 1, ``(1 + k,)``.
        """
        ranges = kept * self.ranges + np.outer(says, says)
        return self._replace(ranges=ranges, ranged_ns=stamp_ns)

    def want(self, frame: Measurement, expected: Array) -> bool:
        """Say whether a frame is to be a keyframe, whose pose was expected there, m and rad."""
        if not self.frames:
            return len(self.biases) > 0
        last = self.frames[-1]
        moved, _ = lapack.dtrtrs(frame.root, wrapped(expected - last.pose), lower=1)
        step_s = abs(frame.stamp_ns - last.stamp_ns) * 1e-9  # clocks are set back, too
        return bool(step_s >= self.every_s and moved @ moved >= NEW_PLACE**2)


class BiasFit:
    """Fits biases, which drift to new values in `hold_s`, s, to keyframes."""

    def __init__(self, space: BiasSpace, hold_s: float, coordinates: JointCoordinates) -> None:
        self._space, self._coordinates = space, coordinates
        self._memory_ns = MEMORY * hold_s * 1e9

    def prior(self) -> Keyframes:
        """Return that there is no keyframe yet."""
        k = self._space.learnt
        return Keyframes(np.zeros(k), EVERY_S, (), (), np.zeros((1 + k, 1 + k)))

    def fitted(self, keyframes: Keyframes, frame: Keyframe) -> tuple[Keyframes, Biases]:
        """Return keyframes with one more, and the biases that fit them, at its stamp."""
        biases, every_s, frames, squares, *_ = keyframes
        (newest,), count = self._squares((frame,), biases)
        oldest_ns = frame.stamp_ns - self._memory_ns
        first = bisect_left(frames, oldest_ns, key=lambda each: each.stamp_ns)
        first = min(first, max(len(frames) - FEWEST, 0))
        frames, squares = (*frames[first:], frame), (*squares[first:], newest)
        if len(frames) > max(MOST_READINGS // count, 1):
            every_s, frames, squares = 2 * every_s, frames[::-2][::-1], squares[::-2][::-1]
        fit = keyframes._replace(every_s=every_s, frames=frames, squares=squares)
        return self.solved(fit, frame.stamp_ns)

    def solved(self, fit: Keyframes, stamp_ns: int) -> tuple[Keyframes, Biases]:
        """Return keyframes linear near the biases that fit them, and these biases, at a stamp."""
        step, root, size = _step(fit)
        untaken: Array = np.zeros_like(step)
        if size * np.linalg.norm(step) > LINEAR:
            for k in range(1 + MOST_HALVINGS):
                nearer = self._at(fit, fit.biases + step / 2**k)
                following = _step(nearer)
                if following[-1] < size:
                    fit, (step, root, _) = nearer, following
                    break
            else:  # the biases are not known better than by the step that leads nowhere
                untaken, step = step, untaken
        inverse = lapack.dpotri(root, lower=1)[0]
        covariance = np.tril(inverse) + np.tril(inverse, -1).T + np.outer(untaken, untaken)
        stamps_ns = [*(each.stamp_ns for each in fit.frames), fit.ranged_ns]
        ages_s = [(stamp_ns - each_ns) * 1e-9 for each_ns in stamps_ns]
        # How much each says.
        told = [each.trace() - each[0, 0] for each in (*fit.squares, fit.ranges)]
        age_s = float(np.average(ages_s, weights=told)) if any(told) else 0.0
        return fit, self._space.drifted(Biases(fit.biases + step, covariance), age_s)

    def _at(self, keyframes: Keyframes, biases: Array) -> Keyframes:
        """Return keyframes linearised at biases."""
        if not keyframes.frames:  # ranges are linear everywhere
            return keyframes._replace(biases=biases)
        squares, _ = self._squares(keyframes.frames, biases)
        return keyframes._replace(biases=biases, squares=tuple(squares))

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
        return rows.transpose(0, 2, 1) @ rows, residuals.shape[1]


def _step(keyframes: Keyframes) -> tuple[Array, Array, float]:
    """Return Gauss and Newton's step, the lower root of the information, and the step by that."""
    at = np.eye(len(keyframes.ranges))
    at[1:, 0] = -keyframes.biases
    squares = np.sum((*keyframes.squares, at.T @ keyframes.ranges @ at), axis=0)
    root = lapack.dpotrf(np.eye(len(squares) - 1) + squares[1:, 1:], lower=1)[0]
    step, _ = lapack.dpotrs(root, squares[1:, 0] - keyframes.biases, lower=1)
    return step, root, float(np.linalg.norm(root.T @ step))
