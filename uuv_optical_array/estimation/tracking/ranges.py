"""A track corrected by a range from elsewhere, such as an acoustic modem's.

The range is the distance between the lamp and the follower's ``base_link``: the length of the
pose's position. By images alone it is uncertain because of their constants, such as the power of
the lamp, which ranges help to learn.

Ranges share errors, such as that of a delay or of the speed of sound, which no number of them
averages out: half of their variance is one error of all (a bias of `belief`). The rest is
correlated between ranges in quick succession: one counts by the time since the last.
"""

import math
from bisect import bisect_left, bisect_right
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.tracking.belief import (
    STATE,
    Belief,
    BiasSpace,
    Observation,
    correct,
)
from uuv_optical_array.estimation.tracking.motion import LONG_AGO_NS
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import RangeUse, StampRefused

LEAST_M, MAX_RANGE_M, MAX_STD_M = 1e-3, 1e4, 1e3
COMMON = 0.5  # of a range's variance
ALIKE_S = 10.0  # ranges within that count as one
MOST_BEFORE_NS = 500_000_000  # of its frame; the motion in between is that at the frame
STAMP = attrgetter("stamp_ns")


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
    """Keeps ranges for their frames, and for late ones, and corrects beliefs by them."""

    def __init__(self, settings: TrackerSettings, space: BiasSpace) -> None:
        self._settings, self._space = settings, space
        self._gate = math.sqrt(chdtri(1, 1 - settings.gate_probability))
        self._ranges: list[Range] = []  # in order of stamps

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
        place = bisect_left(self._ranges, stamp_ns, key=STAMP)
        if self._ranges[place:] and self._ranges[place].stamp_ns == stamp_ns:
            raise StampRefused(f"repeated range: {stamp_ns} ns is that of another", newest_ns)
        self._ranges.insert(place, measured)

    def between(self, before_ns: int | None, stamp_ns: int) -> list[Range]:
        """Return those of a frame's stamp or shortly before, but after the frame before it."""
        since_ns = max(stamp_ns - MOST_BEFORE_NS, LONG_AGO_NS if before_ns is None else before_ns)
        first, end = (bisect_right(self._ranges, at, key=STAMP) for at in (since_ns, stamp_ns))
        return self._ranges[first:end]

    def forget(self, newest_ns: int) -> None:
        """Drop those that no frame needs, while the newest has that stamp."""
        s = self._settings
        first_ns = newest_ns - round(s.buffer_s * 1e9) - MOST_BEFORE_NS
        last_ns = newest_ns + round(s.reset_after_s * 1e9)
        self._ranges = [each for each in self._ranges if first_ns <= each.stamp_ns <= last_ns]

    def correct(
        self, belief: Belief, measured: Range, stamp_ns: int, own_way: Array, common: Array
    ) -> Belief:
        """Return a belief at a stamp corrected by a range of that time or shortly before.

        - own_way: of the follower since then by its commands, in ``beacon``, m, shape ``(3,)``.
        - common: covariance of errors of the position beside those of the belief, ``(3, 3)``.
        """
        ago_s = (stamp_ns - measured.stamp_ns) * 1e-9
        place = belief.mean[:3] - ago_s * belief.mean[5:8] - own_way
        expected = float(np.linalg.norm(place))
        along = place / max(expected, LEAST_M)
        slopes = np.zeros(len(belief.mean))
        slopes[:3], slopes[5:8] = along, -ago_s * along
        slopes[STATE + self._space.range] = math.sqrt(COMMON) * measured.std_m
        bias = slopes[STATE + self._space.range] * belief.mean[STATE + self._space.range]
        off = measured.range_m - expected - bias
        others, own = float(along @ common @ along), (1 - COMMON) * measured.std_m**2
        std = math.sqrt(slopes @ belief.covariance @ slopes + others + own)
        since_s = abs(measured.stamp_ns - belief.ranged_ns) * 1e-9  # clocks are set back, too
        noise = others + own / max(-math.expm1(-since_s / ALIKE_S), 1e-9)
        use = RangeUse(measured.stamp_ns, off, std, 0)
        if abs(off) > self._gate * std:
            refused = 1 if belief.range is None else 1 + belief.range.refused
            if refused % self._settings.reacquire_frames == 0:  # older ones may be what is wrong
                belief = self._space.forgotten(belief)
            return belief._replace(range=use._replace(refused=refused))
        said = Observation(np.array([off]) / math.sqrt(noise), slopes[None] / math.sqrt(noise))
        return correct(belief, said)._replace(range=use, ranged_ns=measured.stamp_ns)
