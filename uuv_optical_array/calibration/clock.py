"""By how much the clock of the images differs from that of the poses, fitted with a calibration.

An offset moves each pose along its course, so that its slopes are those by the pose times the rate
of the pose. All that is fitted beside it, and the errors of the poses, are eliminated.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uuv_optical_array.calibration.result import Calibration
from uuv_optical_array.recording.clocks import rates_of, shifted
from uuv_optical_array.recording.images import Recording

ROUNDS = 8  # of fits at the offset that the one before found
SETTLED = 0.1  # of its standard error: a step that is the last
SETTLED_S = 1e-5
SURE, LEAST_S = 3.0, 1e-3  # standard errors, and s, from which an offset is accepted


@dataclass(frozen=True)
class Clock:
    """The offset of the images' clock: a pose is that of an image's stamp and `offset_s`.

    - std_s: its standard error, s; inf: not observable on this drive.
    - applied: whether it was large and certain enough to be taken into account.
    """

    offset_s: float
    std_s: float
    applied: bool

    def text(self) -> str:
        """Return what a user should know, in a sentence."""
        if not np.isfinite(self.std_s):
            return "clocks: their offset is not known; record a drive that turns back"
        size = f"{abs(self.offset_s) * 1e3:.3g} ms +- {self.std_s * 1e3:.2g} ms"
        if not self.applied:
            return f"clocks: images and poses agree within {size}"
        side = "late" if self.offset_s < 0 else "early"
        return (
            f"clocks: the images' stamps are {size} {side}, which was taken into account "
            f"(time_offset_s={self.offset_s:.6g})"
        )


def synchronised(
    recording: Recording, fit: Callable[[Recording], Calibration]
) -> tuple[Recording, Calibration, Clock]:
    """Fit a recording, whose poses are known at other times, with the offset of its clocks.

    `fit` takes a recording with `Recording.rates` and returns its calibration, which has `clock`.
    An offset that is not certain leaves recording and calibration as they are.
    """
    moved, total = recording, 0.0
    first = result = fit(rates_of(recording))
    for _ in range(ROUNDS):
        step, std = result.clock
        if not np.isfinite(std) or abs(step) < max(SETTLED * std, SETTLED_S):
            break
        total += step
        moved = shifted(recording, total)
        result = fit(rates_of(moved))
    if not np.isfinite(std) or abs(total) < max(SURE * std, LEAST_S):
        return recording, first, Clock(total, std, False)
    return moved, result, Clock(total, std, True)
