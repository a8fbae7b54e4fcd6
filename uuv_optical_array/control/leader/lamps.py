"""Which lamp in sight is the leader's, by sudden changes of the light and by where lamps are.

If the light falls suddenly, a lamp went out, and what is left is another one unless the leader is
expected there; until the track has adapted, a pose says little of either. Light that falls faster
and faster, as when the follower leaves the beam, does not fall suddenly. If light grows suddenly
beside a lamp that is kept apart, a second one is lit.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Literal

from uuv_optical_array.control.leader.motion import LIKELY, Glow, LeaderMotion
from uuv_optical_array.control.leader.other_lamp import OtherLamp
from uuv_optical_array.control.leader.sight import SightSettings
from uuv_optical_array.core.geometry import Array

# Factor by which light exceeds each of so many last images if a second lamp is lit, or falls below
# each, faster than before, if one of two goes out; time in which the track adapts, s.
LIT, LIT_IMAGES, LEFT_S = 1.4, 3, 2.0

Change = Literal["lit", "out"]
Whose = Literal["leader", "other", "both"]


class Lamps:
    """The lamps in sight.

    - other: one that is held apart from the leader's; ``None``: there is none.
    - met: whether there was one.
    """

    def __init__(self) -> None:
        self.other: OtherLamp | None = None
        self.met = False
        self._peaks: deque[float] = deque(maxlen=LIT_IMAGES)
        self._out_s = -math.inf  # when a lamp went out last
        self._left = False  # whether it left light, by which the follower steered

    def look(self, stamp_s: float, glow: Glow | None, steers: bool) -> Change | None:
        """Take how bright an image is, at a stamp, s; return what became of a lamp.

        - glow: ``None``: it is dark. steers: whether light steers the follower.
        - returned: ``lit``: a second lamp beside the one that is held apart, from now on its light
          is not the only one; ``out``: one of two, or a part of the light; ``None``: nothing.
        """
        peaks = self._peaks
        if glow is None:
            peaks.clear()
            self._out_s, self._left = stamp_s, False
            return None
        grew = bool(peaks) and glow.peak > LIT * max(peaks)
        fell = bool(peaks) and LIT * glow.peak < min(peaks)
        if fell and len(peaks) > 1:
            fell = LIT * glow.peak * peaks[-2] < peaks[-1] ** 2
        peaks.append(glow.peak)
        if fell:
            self._out_s, self._left = stamp_s, steers
            return "out"
        if grew and self.other is not None and self.other.alone:
            self.other.alone = False
            return "lit"
        return None

    def advance(self, now_s: float, twist: Array) -> None:
        """Move the other lamp on to a time, s, by the follower's own motion, ``(5,)``."""
        if self.other is not None:
            self.other.motion.advance(now_s, twist)

    def whose(
        self,
        stamp_s: float,
        pose: Array,
        covariance: Array,
        leaders: Sequence[LeaderMotion],
        reached: bool,
        sight: SightSettings | None,
    ) -> Whose:
        """Say whose lamp a pose is of, or that it is of the light of ``both``.

        - leaders: the leader as it is expected, and as a light that settles has it; all moved on.
        - reached: whether the leader may have got there since its light was seen.
        - sight: of lamps, while the leader is taken to go on; ``None``: it is not.
        - Outlier: where the leader is not expected, and no lamp went out.
        """
        leader, other = leaders[0], self.other
        if other is not None and other.has(pose, covariance, leaders):
            return "other"
        if other is not None and sight is not None and other.mixes(leader, sight):
            return "both"
        ours = leader.in_line(pose, covariance, LIKELY) if self._left else reached
        if ours or not self._fell(stamp_s):
            if not reached:  # as where two lights part
                leader.check(pose, covariance)
            return "leader"
        self.other, self.met = OtherLamp(stamp_s, pose, covariance, leader), True
        return "other"

    def taken_up(self, stamp_s: float) -> bool:
        """Say whether the track may still be taking up the light that a lamp left."""
        return self._left and self._fell(stamp_s)

    def _fell(self, stamp_s: float) -> bool:
        """Say whether a lamp went out shortly before."""
        return 0 <= stamp_s - self._out_s <= LEFT_S
