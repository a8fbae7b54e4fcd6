"""Lasting differences from the scene, found in the residuals of many frames together.

An error of one frame is lost in its noise; one that lasts is in all frames. Each frame is linear in
its pose, which is free, and in lasting errors: of constants and gains, as large as the prior says,
and of the lamp's power with time, whose prior is 0. Scores s of these and their information J,
summed over frames, are Gaussian about 0 with covariance ``J + J P J``, P the prior's, if the scene
is right. A score test (C. R. Rao, 1948, Proc. Camb. Phil. Soc. 44, 50) for each way in which the
sea may differ (a constant, a detector, a row or column, the evenness of the light) and the
chi-square of all tell if it is not, and the largest what explains it best.

Of large arrays some detectors are tested, as many as gains are learnt by blocks (`belief`).

A sudden change just before is recognised by the motion (`change`), and named instead. Frames that
are lit unevenly are not summed; if most are, this is reported. Nor are those whose light bends over
what an image leaves of the pose: the error of a place lasts, and what it leaves in their residuals
looks like an error of the scene.

A scene that names shades is not tested: frames that count as clear may be shaded alike for long.
"""

import math

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtrc

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.linear_algebra import orthonormal
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import MOST_BLOCKS
from uuv_optical_array.estimation.tracking.change import Changes
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.forward.prior import OWN_POWER, POWER, shade_modes

# Frames of a window are tested together with those of the one before, so often.
WINDOW_S, CHECK_S = 30.0, 2.0
FALSE_ALARM = 1e-5  # probability of a false alarm, of each of two tests, every `CHECK_S`
# The light is uneven where that share of the time with frames is, that fades as long as a window,
# or of 3 s or more since the first frame.
UNEVEN_SHARE, LEAST_LIT = 2 / 3, 1 - math.exp(-3 / WINDOW_S)
# Of sudden changes: their standard deviation in those of the prior; how often others than lamps
# change, all detectors together as often as one constant.
SUDDEN, RARELY = 10.0, 0.02
LEAST_GAIN = 1e-3  # error of a detector that linearising may leave
NEGLIGIBLE = 1e-9  # of the largest information, below which rounding is all there is
EVENNESS = "the evenness of the light"
MOSTLY_UNEVEN = f"{EVENNESS} is off in most frames of {WINDOW_S:g} s, or since the first"


class Alarm:
    """Finds what differs from the scene.

    - changes: find a sudden change, where that is the cause; ``None``: nothing does.
    - said: what would explain the frames best; empty while the scene explains them.
    """

    def __init__(self, constants: Constants, changes: Changes | None = None) -> None:
        q, side = len(constants.names), round(constants.detectors**0.5)
        self._tests = not constants.names_shades
        self._sums = self._tests and 0 < constants.detectors == side**2
        self._changes = changes
        self._change = self._off = self.said = ""
        # Time with frames, of it with uneven ones, as shares of the window; stamp of the last one.
        self._lit, self._uneven, self._newest_ns = 0.0, 0.0, 0
        if not self._sums:
            return
        lines = np.linspace(0, side - 1, min(side, MOST_BLOCKS)).round().astype(int).tolist()
        chosen = [side * i + k for i in lines for k in lines]
        count, by_detector = len(chosen), constants.by_detector[:, chosen]
        self._chosen = np.flatnonzero(by_detector.any(axis=1))
        self._by_detector = by_detector[self._chosen]
        gain = max(constants.gain_std, LEAST_GAIN)
        self._stds = np.array([*constants.stds, *[gain] * count])
        self._power = constants.names.index(POWER) if POWER in constants.names else None
        # Information and score of the frames of this window, by errors and the power with time.
        self._sum = np.zeros((len(self._stds) + 1, len(self._stds) + 2))
        self._begin(0)
        self._names = [
            *constants.names,
            *(f"the detector of row {i}, column {k}" for i in lines for k in lines),
            *(f"the {line} {i} of detectors" for line in ("row", "column") for i in lines),
            *[EVENNESS] * 5,
            f"{POWER} with time, per s,",
        ]
        each = np.eye(len(lines))
        row, column = np.repeat(each, len(lines), axis=0), np.tile(each, (len(lines), 1))
        patterns = np.hstack([np.eye(count), row, column, shade_modes(side)[:, chosen].T])
        self._directions = block_diag(np.eye(q), patterns, 1.0)
        size = patterns.shape[1] + 1
        self._units = np.array([*constants.stds, *[gain] * patterns.shape[1], 1.0])
        lamps = np.array([name.endswith(f".{OWN_POWER}") for name in self._names])
        self._odds = np.where(lamps, 1.0, np.repeat([RARELY, RARELY / count], [q, size]))

    def add(self, stamp_ns: int, uneven: bool, readings: LinearisedReadings | None = None) -> None:
        """Take the newest frame of the track, and test what was summed now and then.

        - uneven: whether it is lit unevenly, as in a scene few are.
        - readings: linearised at the track's own place; ``None``: there are none, or they are far
          from linear, and it is known only how the frame is lit.
        """
        step_s = max(stamp_ns - (self._newest_ns or stamp_ns), 0) * 1e-9
        kept = math.exp(-step_s / WINDOW_S)
        new = min(1 - kept, LEAST_LIT)
        self._newest_ns = stamp_ns
        self._lit, self._uneven = kept * self._lit + new, kept * self._uneven + new * uneven
        if readings is not None and self._sums:
            self._add(stamp_ns, readings)
        mostly = self._tests and self._uneven > UNEVEN_SHARE * max(self._lit, LEAST_LIT)
        self.said = MOSTLY_UNEVEN if mostly else self._off

    def _begin(self, stamp_ns: int, after_s: float = 0.0) -> None:
        """Begin a window, so long after the start of the last one, if that still counts."""
        last, self._sum = self._sum, np.zeros_like(self._sum)
        self._before = self._sum.copy()
        if 0 < after_s <= 2 * WINDOW_S:
            since: Array = np.eye(len(last))  # time counts from the start of this one
            if self._power is not None:
                since[self._power, -1] = -after_s / self._stds[self._power]
            self._before = since.T @ last @ block_diag(since, 1.0)
        self._start_ns = self._checked_ns = stamp_ns

    def _add(self, stamp_ns: int, readings: LinearisedReadings) -> None:
        """Add the information and the score of a frame whose pose is free; test now and then."""
        since_s = (stamp_ns - self._start_ns) * 1e-9
        if not 0 <= since_s <= WINDOW_S:
            self._off = ""  # a whole window found nothing
            self._begin(stamp_ns, since_s)
            since_s = 0.0
        residuals, slopes, light, variances = (part[self._chosen] for part in readings[1:])
        white = 1 / np.sqrt(variances)[:, None]
        by_pose, by_constants = np.split(white * slopes, [5], axis=1)
        basis = orthonormal(by_pose)
        sizes = np.abs((basis.T @ by_pose).diagonal())
        if sizes.min() <= NEGLIGIBLE * sizes.max():
            return  # too few readings for a pose
        by_gains = white * light[:, None] * self._by_detector
        with_time: Array = np.zeros((len(white), 1))
        if self._power is not None:
            with_time = since_s * by_constants[:, [self._power]]
        by_errors = np.hstack([self._stds * np.hstack([by_constants, by_gains]), with_time])
        rest = by_errors - basis @ (basis.T @ by_errors)
        left = white[:, 0] * residuals + by_constants @ readings.at[5:]
        self._sum += rest.T @ np.column_stack([rest, left])
        if stamp_ns - self._checked_ns >= CHECK_S * 1e9:
            self._checked_ns = stamp_ns
            if found := self._found():
                self._off = found
                self._begin(stamp_ns)  # so that it ends a window after what it tells

    def _found(self) -> str:
        """Return what the frames have in common that is improbable under the prior."""
        both = self._before + self._sum
        information, score = both[:, :-1], both[:, -1]
        spread = information + information[:, :-1] @ information[:-1]
        scale = np.sqrt(np.maximum(spread.diagonal(), 1e-300))
        values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
        keep = values > NEGLIGIBLE * values[-1]
        whiten = (vectors[:, keep] / np.sqrt(values[keep])).T / scale
        white, shifts = whiten @ score, whiten @ information @ self._directions
        known = np.square(shifts).sum(axis=0)
        known[known <= NEGLIGIBLE * known.max()] = np.inf
        sizes = white @ shifts / known
        scores = sizes * (white @ shifts)
        best = int(scores.argmax())
        chance = min(chdtrc(len(white), white @ white), len(scores) * chdtrc(1, scores[best]))
        if chance >= FALSE_ALARM:
            return ""
        if not self._off:  # once for each alarm
            self._change = self._changed()
        size = sizes[best] * self._units[best]
        what = self._change or f"{self._names[best]} is off by {size:+.2g}"
        return f"{what} (chance {chance:.0e})"

    def _changed(self) -> str:
        """Return the sudden change, where it is as certain."""
        best = None
        if self._changes:
            best = self._changes.likeliest(self._directions, SUDDEN, self._odds)
        if best is None or best.evidence < -math.log(FALSE_ALARM):
            return ""
        size = best.size * self._units[best.error]
        return f"{self._names[best.error]} changed by {size:+.2g}"
