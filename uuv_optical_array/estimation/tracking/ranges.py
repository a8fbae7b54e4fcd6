"""A track corrected by a range from elsewhere, such as an acoustic modem's.

The range is the distance between the lamp and the follower's ``base_link``: the length of the
pose's position. Of images alone it is uncertain by what their constants leave, such as the power of
the lamp. A range corrects pose and rate given the biases, and what it then still differs by teaches
the biases (B. Friedland, 1969, IEEE Trans. Automatic Control 14, 359), so that the frames that
follow, and single images, know their range as well.

Ranges may share their error, such as that of a delay or of the speed of sound, which no number of
them averages out. So a range takes the place of older ones instead of adding to them: all that came
within `ALIKE_S` count as one. Where the biases change, what older ones taught is thus forgotten,
and so it is where a false range that passed the gate lets right ones fail it.
"""

import math
from bisect import bisect_left, bisect_right
from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.tracking.belief import BiasSpace, Motion, triangular
from uuv_optical_array.estimation.tracking.correction import Belief
from uuv_optical_array.estimation.tracking.keyframes import BiasFit, Keyframes
from uuv_optical_array.estimation.tracking.motion import LONG_AGO_NS
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import RangeUse, StampRefused

LEAST_M, MAX_RANGE_M, MAX_STD_M = 1e-3, 1e4, 1e3
MOST_REFUSED = 5  # in a row, until what older ones taught is forgotten
ALIKE_S = 10.0  # errors of ranges that are closer in time are taken for one
MOST_BEFORE_NS = 500_000_000  # of its frame; the motion in between is that at the frame


class Range(NamedTuple):
    """A range, m, its standard deviation, m, and when it was that, ns."""

    stamp_ns: int
    range_m: float
    std_m: float


def checked_range(stamp_ns: int, range_m: float, std_m: float) -> Range:
    """Return a range; ValueError for numbers out of bounds."""
    if not LEAST_M <= range_m <= MAX_RANGE_M:
        raise ValueError(f"range: {range_m:g} m; give from {LEAST_M:g} to {MAX_RANGE_M:g} m")
    if not LEAST_M <= std_m <= MAX_STD_M:
        raise ValueError(f"range std: {std_m:g} m; give from {LEAST_M:g} to {MAX_STD_M:g} m")
    return Range(stamp_ns, float(range_m), float(std_m))


class Ranges:
    """Ranges that wait for their frames, or that late frames may need, in order of stamps."""

    def __init__(self, settings: TrackerSettings) -> None:
        self._settings = settings
        self._ranges: list[Range] = []

    def add(self, measured: Range, newest_ns: int | None) -> None:
        """Take a range while the newest frame has that stamp; refused as by `Tracker.range`."""
        stamp_ns, s = measured.stamp_ns, self._settings
        if newest_ns is None:
            raise StampRefused("range without light: there is no frame yet", stamp_ns)
        ahead_s = (stamp_ns - newest_ns) * 1e-9
        if -ahead_s > s.buffer_s:
            raise StampRefused(
                f"late range: {-ahead_s:.3f} s older than the newest frame, more than "
                f"buffer_s {s.buffer_s:g}",
                newest_ns,
            )
        if ahead_s > s.reset_after_s:
            raise StampRefused(
                f"range without light: {ahead_s:.3f} s newer than the newest frame, more than "
                f"reset_after_s {s.reset_after_s:g}",
                newest_ns,
            )
        place = bisect_left(self._ranges, stamp_ns, key=_stamp)
        if self._ranges[place:] and self._ranges[place].stamp_ns == stamp_ns:
            raise StampRefused(f"repeated range: {stamp_ns} ns is that of another", newest_ns)
        self._ranges.insert(place, measured)

    def between(self, before_ns: int | None, stamp_ns: int) -> list[Range]:
        """Return those of a frame's stamp or shortly before, but after the frame before it."""
        since_ns = max(stamp_ns - MOST_BEFORE_NS, LONG_AGO_NS if before_ns is None else before_ns)
        first, end = (bisect_right(self._ranges, at, key=_stamp) for at in (since_ns, stamp_ns))
        return self._ranges[first:end]

    def forget(self, newest_ns: int) -> None:
        """Drop those that no frame needs, while the newest has that stamp."""
        s = self._settings
        first_ns = newest_ns - round(s.buffer_s * 1e9) - MOST_BEFORE_NS
        last_ns = newest_ns + round(s.reset_after_s * 1e9)
        self._ranges = [each for each in self._ranges if first_ns <= each.stamp_ns <= last_ns]


def _stamp(measured: Range) -> int:
    return measured.stamp_ns


class Ranging:
    """Corrects beliefs by ranges, of which the gate lets so many standard deviations pass."""

    def __init__(self, space: BiasSpace, fit: BiasFit, gate: float) -> None:
        self._space, self._fit, self._gate = space, fit, gate

    def correct(
        self, belief: Belief, measured: Range, stamp_ns: int, own_way: Array, common: Array
    ) -> Belief:
        """Return a belief at a stamp corrected by a range of that time or shortly before.

        - own_way: of the follower since then by its commands, in ``beacon``, m, shape ``(3,)``.
        - common: covariance of errors of the position beside those of the belief, ``(3, 3)``.
        """
        motion, biases, keyframes, *_ = belief
        ago_s = (stamp_ns - measured.stamp_ns) * 1e-9
        place = motion.mean[:3] - ago_s * motion.mean[5:8] - own_way
        expected = float(np.linalg.norm(place))
        along = place / max(expected, LEAST_M)
        by_state = np.concatenate([along, np.zeros(2), -ago_s * along, np.zeros(2)])
        by_root, by_biases = by_state @ motion.root, by_state @ motion.slopes
        others = float(along @ common @ along)
        known = by_root @ by_root + by_biases @ biases.covariance @ by_biases + others
        off, std = measured.range_m - expected, math.sqrt(known + measured.std_m**2)
        use = RangeUse(measured.stamp_ns, off, std, 0)
        if abs(off) > self._gate * std:
            return self._refused(belief, use, stamp_ns)
        since_s = abs(measured.stamp_ns - keyframes.ranged_ns) * 1e-9  # clocks are set back, too
        new = max(-math.expm1(-since_s / ALIKE_S), 1e-9)  # as a share of a range
        noise = measured.std_m**2 / new + others
        # Shades are not learnt: what they may add to the error of the pose lowers the gain.
        shades, learnt = self._space.shades, slice(self._space.learnt)
        both = biases.covariance[shades, shades] @ by_biases[shades]
        spread = by_root @ by_root + by_biases[shades] @ both + noise
        gain = (motion.root @ by_root + motion.slopes[:, shades] @ both) / spread
        left = motion.root - np.outer(gain, by_root)
        root = triangular(np.hstack([left, math.sqrt(noise) * gain[:, None]]))
        mean, slopes = motion.mean + gain * off, motion.slopes - np.outer(gain, by_biases)
        by_learnt, at = by_biases[learnt], biases.mean[learnt]
        says = np.array([off + by_learnt @ at, *by_learnt]) / math.sqrt(spread)
        keyframes = keyframes.ranged(measured.stamp_ns, says, 1 - new)
        corrected = belief._replace(motion=Motion(mean, root, slopes), range=use)
        return self._taught(corrected, keyframes, stamp_ns)

    def _refused(self, belief: Belief, use: RangeUse, stamp_ns: int) -> Belief:
        """Return a belief that a range contradicts; after some, older ranges may be wrong."""
        refused = 1 if belief.range is None else 1 + belief.range.refused
        belief = belief._replace(range=use._replace(refused=refused))
        if refused % MOST_REFUSED:
            return belief
        forgotten = self._fit.prior()
        keyframes = belief.keyframes._replace(ranges=forgotten.ranges, ranged_ns=LONG_AGO_NS)
        return self._taught(belief, keyframes, stamp_ns)

    def _taught(self, belief: Belief, keyframes: Keyframes, stamp_ns: int) -> Belief:
        """Return a belief with the biases that keyframes and ranges teach at a stamp."""
        motion, biases = belief.motion, belief.biases
        if self._space.learnt:
            keyframes, found = self._fit.solved(keyframes, stamp_ns)
            biases = self._space.replaced(biases, found)
            mean = motion.mean + motion.slopes @ (biases.mean - belief.biases.mean)
            motion = motion._replace(mean=mean)
        return belief._replace(motion=motion, biases=biases, keyframes=keyframes)
