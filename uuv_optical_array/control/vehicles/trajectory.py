"""A vehicle's recent poses by time, so that two vehicles can be compared at one instant."""

from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity

MAX_GAP = Quantity("longest gap in an odometry that is interpolated", "s", 0.001, 10)
MAX_GAP_S = 0.5  # the default


class TooEarly(Exception):
    """The pose of this instant is not on record yet; try again later."""


class Between(NamedTuple):
    """An instant between two poses on record: its share of the way from one to the other.

    Positions are in m, shape ``(3,)``, attitudes quaternions x, y, z, w.
    """

    share: float
    positions: tuple[Array, Array]
    quaternions: tuple[Array, Array]


class Trajectory:
    """The last `length` poses (``None``: all), interpolated across gaps of up to `max_gap_s`."""

    def __init__(self, max_gap_s: float, length: int | None = 200) -> None:
        self.max_gap_s = max_gap_s
        self._samples: deque[tuple[int, Array, Array]] = deque(maxlen=length)

    @property
    def newest_ns(self) -> int | None:
        """Return the stamp of the newest pose, ns; ``None`` without one."""
        return self._samples[-1][0] if self._samples else None

    def add(self, stamp_ns: int, position: Array, quaternion_xyzw: Array) -> None:
        """Record a position, m, ``(3,)``, and attitude; of two with one stamp the later counts.

        A stamp that goes back starts the record anew: the clock was reset.
        """
        if self._samples and stamp_ns < self._samples[-1][0]:
            self._samples.clear()
        elif self._samples and stamp_ns == self._samples[-1][0]:
            self._samples.pop()
        self._samples.append((stamp_ns, position, quaternion_xyzw))

    def at(self, stamp_ns: int) -> tuple[Array, Array]:
        """Return position, m, and rotation matrix at an instant, `interpolated`."""
        (position,), (rotation,) = interpolated([self.around(stamp_ns)])
        return position, rotation

    def around(self, stamp_ns: int) -> Between:
        """Return the poses on record around an instant.

        TooEarly for an instant after the last record; LookupError for one before the first, or
        inside a gap.
        """
        if not self._samples or stamp_ns > self._samples[-1][0]:
            late = "it is later than every pose on record"
            raise TooEarly(late if self._samples else "there is none")
        later = bisect_left(self._samples, stamp_ns, key=lambda sample: sample[0])
        stamp, position, quaternion = self._samples[later]
        if stamp == stamp_ns:
            return Between(0.0, (position, position), (quaternion, quaternion))
        if later == 0:
            raise LookupError("it is older than every pose on record")
        before, old_position, old_quaternion = self._samples[later - 1]
        gap_s = (stamp - before) * 1e-9
        if gap_s > self.max_gap_s:
            raise LookupError(f"it falls in a gap of {gap_s:.3g} s, more than {self.max_gap_s:g}")
        share = (stamp_ns - before) / (stamp - before)
        return Between(share, (old_position, position), (old_quaternion, quaternion))


def interpolated(instants: Sequence[Between]) -> tuple[Array, Array]:
    """Return positions, m, ``(m, 3)``, and rotation matrices, ``(m, 3, 3)``, at m >= 1 instants.

    Between two poses the position is linear, the rotation along the great arc.
    """
    shares, positions, quaternions = map(np.array, zip(*instants, strict=True))
    share, (start, end) = shares[:, None], np.swapaxes(positions, 0, 1)
    first, last = map(Rotation.from_quat, np.swapaxes(quaternions, 0, 1))
    turn = Rotation.from_rotvec(share * (first.inv() * last).as_rotvec())
    return start + share * (end - start), (first * turn).as_matrix()
