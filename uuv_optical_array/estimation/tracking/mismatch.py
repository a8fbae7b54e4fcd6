"""What differs from the scene for long, by what many frames leave together.

An error of one frame is lost in its noise; one that lasts is in all frames. Each frame is linear in
its pose, which is free, and in lasting errors: of constants and gains, as large as the prior says,
and of the lamp's power with time, whose prior is 0. Scores s of these and their information J,
summed over frames, are Gaussian about 0 with covariance J + J P J, P the prior's, if the scene is
right. A score test for each error beyond its prior (C. R. Rao, 1948, Proc. Camb. Phil. Soc. 44, 50)
and the chi-square of all tell if it is not, and the largest score what explains it best.

What is wrong from frame to frame, as where the lamp loses power, may also pass for other constants
than the prior lets expect. Where it is right, means that were learnt with covariance C are Gaussian
about 0 with covariance P - C.

What changed at once just before is told apart by the motion (`change`), and named instead.

A scene that names shades is not tested: frames that pass for clear may be shaded, alike for long.
"""

import math

import numpy as np
from scipy.linalg import lapack
from scipy.special import chdtrc

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import BiasSpace, Learnt
from uuv_optical_array.estimation.tracking.change import Changes
from uuv_optical_array.estimation.tracking.motion import LONG_AGO_NS
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.forward.prior import DAYLIGHT, OWN_POWER, POWER, shade_modes

MOST_TESTED = 49  # detectors
# Frames of a window are tested together with those of the one before, so often.
WINDOW_S, CHECK_S = 30.0, 2.0
EVENNESS, MOST_UNEVEN = "the evenness of the light", 0.6
MOSTLY_UNEVEN = f"{EVENNESS} is off in most frames of {WINDOW_S:g} s, or since the first"
# Of the frames since the first, where these are of LEAST_S or more: a cloud comes after clear ones.
MOST_OF_ALL, LEAST_S = 0.75, 3.0
LEAST = 1 - math.exp(-LEAST_S / WINDOW_S)  # the same, as a share of the window
CHANCE = 1e-5  # that frames of the scene are taken for others, at each test
LEAST_GAIN = 1e-3  # error of a detector that linearising may leave
# Of changes at once: standard deviations of the prior of those of light and detectors, and of those
# of water and optics; how often others than lamps change, all detectors as often as one constant.
SUDDEN, SLOW, RARELY = 10.0, 2.0, 0.02
LEAST_TOLD = 0.5  # degrees of freedom that were learnt, below which there is nothing to test
LEAST_LEARNT = 0.02  # of a prior variance
NEGLIGIBLE = 1e-9  # of the largest information, below which rounding is all there is


class LastingResiduals:
    """Tests the frames of a track, by arrays of at most `MOST_TESTED` detectors.

    - changes: tell what changed at once, where that is why what is found; None: nothing does.
    - mismatch: what would explain the frames best; empty while the scene does.
    - said: the same, or of what was learnt, as it was said last.
    """

    def __init__(self, constants: Constants, changes: Changes | None = None) -> None:
        side, q = round(constants.detectors**0.5), len(constants.names)
        self._clear = not constants.names_shades
        self._tests = self._clear and 0 < side**2 == constants.detectors <= MOST_TESTED
        self.mismatch = self.said = ""
        self._changes, self._change = changes, ""
        self._by_detector = constants.by_detector
        # Time with frames, of it with uneven ones, as shares of the window; stamp of the last one.
        self._lit, self._uneven, self._light_ns = 0.0, 0.0, 0
        self._power = constants.names.index(POWER) if POWER in constants.names else -1
        places = [divmod(i, side) for i in range(constants.detectors)]
        self._names = [
            *constants.names,
            *(f"the detector of row {i}, column {k}" for i, k in places),
            f"{POWER} with time, per s,",
            *(f"the row {i} of detectors" for i in range(side)),
            *(f"the column {k} of detectors" for k in range(side)),
            *[EVENNESS] * 5,
        ]
        if not self._tests:
            return
        gain = max(constants.gain_std, LEAST_GAIN)
        modes = shade_modes(side)
        self._prior = np.diag(np.square([*constants.stds, *[gain] * side**2, 0.0]))
        size = len(self._prior)
        self._directions = np.zeros((size, len(self._names)))
        self._directions[:, :size] = np.eye(size)
        row = np.repeat(np.eye(side), side, axis=0)
        column = np.tile(np.eye(side), (side, 1))
        patterns = np.hstack([row, column, modes.T])
        self._directions[q : q + side**2, size:] = patterns
        self._units = np.array([*constants.stds, *[gain] * (len(self._names) - q)])
        lamps = np.array([name.endswith(f".{OWN_POWER}") for name in self._names])
        slow = (np.arange(len(lamps)) < q) & ~lamps & ~np.isin(self._names, DAYLIGHT)
        self._sizes = np.where(slow, SLOW, SUDDEN)
        each = np.repeat([RARELY, RARELY / side**2], [q, len(lamps) - q])
        self._odds = np.where(lamps, 1.0, each)
        self._begin(LONG_AGO_NS)

    def beyond_prior(self, biases: Learnt, space: BiasSpace) -> str:
        """Return what is learnt to be as the prior hardly allows, of constants, or with gains."""
        tested = {space.constants.stop, space.learnt} if self._tests else {space.constants.stop}
        tested = tested if self._clear else set()
        for of in filter(None, tested):
            mean, spread = biases.mean[:of], np.eye(of) - biases.covariance[:of, :of]
            known = spread + LEAST_LEARNT * np.eye(of)  # what says nothing of a bias is no test
            _, solved, failed = lapack.dposv(known, np.column_stack([mean, spread]), lower=1)
            told = 0.0 if failed else float(solved[:, 1:].trace())
            chance = chdtrc(told, mean @ solved[:, 0]) if told > LEAST_TOLD else 1.0
            if chance < CHANCE:
                best = int((mean**2 / known.diagonal()).argmax())
                return self._off(best, space.stds[best] * mean[best], chance)
        return ""

    def _off(self, error: int, size: float, chance: float) -> str:
        """Return what changed at once, where that is as certain, or else that an error is off."""
        if not self.said:  # once for each alarm
            self._change = self._changed()
        if self._change:
            return f"{self._change} (chance {chance:.0e})"
        return f"{self._names[error]} is off by {size:+.2g} (chance {chance:.0e})"

    def _changed(self) -> str:
        if not (self._tests and self._changes):
            return ""
        best = self._changes.likeliest(self._directions, self._sizes, self._odds)
        if best is None or best.evidence < -math.log(CHANCE):
            return ""
        size = best.size * self._units[best.error]
        return f"{self._names[best.error]} changed by {size:+.2g}"

    def say(self, biases: Learnt, space: BiasSpace) -> str:
        """Return what would explain the frames best, or what they taught."""
        self.said = self.mismatch or self.beyond_prior(biases, space)
        return self.said

    def _begin(self, stamp_ns: int, after_ns: int = 0) -> None:
        """Begin a window, so long after the start of the last one, if that still counts."""
        size = len(self._prior)
        self._before: tuple[Array, Array] = np.zeros((size, size)), np.zeros(size)
        if 0 < after_ns <= 2 * WINDOW_S * 1e9:
            since = np.eye(size)  # time counts from the start of this one
            since[self._power, -1] = -after_ns * 1e-9 * (self._power >= 0)
            self._before = since.T @ self._information @ since, since.T @ self._score
        self._information: Array = np.zeros((size, size))
        self._score: Array = np.zeros(size)
        self._start_ns = self._checked_ns = stamp_ns

    def add(self, stamp_ns: int, readings: LinearisedReadings) -> None:
        """Take the readings of a frame of the track, linearised at the track's own place."""
        self.add_light(stamp_ns, False)
        if not self._tests:
            return
        since_ns = stamp_ns - self._start_ns
        if not 0 <= since_ns <= WINDOW_S * 1e9:
            self._begin(stamp_ns, since_ns)
        whiten = 1 / np.sqrt(readings.variances)[:, None]
        of_pose, of_constants = np.split(whiten * readings.slopes, [5], axis=1)
        with_time: Array = np.zeros((len(whiten), 1))
        if self._power >= 0:
            since_s = (stamp_ns - self._start_ns) * 1e-9
            with_time = since_s * of_constants[:, self._power : self._power + 1]
        of_gains = whiten * readings.light[:, None] * self._by_detector
        lasting = np.hstack([of_constants, of_gains, with_time])
        left = whiten[:, 0] * readings.residuals + of_constants @ readings.at[5:]
        basis, root = np.linalg.qr(of_pose)
        if abs(root.diagonal()).min() <= NEGLIGIBLE * abs(root.diagonal()).max():
            return  # too few readings for a pose
        rest = lasting - basis @ (basis.T @ lasting)
        self._information += rest.T @ rest
        self._score += rest.T @ left
        if stamp_ns - self._checked_ns >= CHECK_S * 1e9:
            self._checked_ns = stamp_ns
            self._check(stamp_ns, stamp_ns - self._start_ns > (WINDOW_S - CHECK_S) * 1e9)

    def add_light(self, stamp_ns: int, uneven: bool) -> None:
        """Take whether a frame of the track is lit unevenly, as in a scene few are."""
        step_s = np.clip((stamp_ns - (self._light_ns or stamp_ns)) * 1e-9, 0.0, CHECK_S)
        self._light_ns, kept = stamp_ns, float(np.exp(-step_s / WINDOW_S))
        self._lit = kept * self._lit + 1 - kept
        self._uneven = kept * self._uneven + (1 - kept) * uneven
        if self._uneven > min(MOST_UNEVEN, MOST_OF_ALL * max(self._lit, LEAST)):
            self.mismatch = MOSTLY_UNEVEN
        elif self.mismatch == MOSTLY_UNEVEN:
            self.mismatch = ""

    def _check(self, stamp_ns: int, last: bool) -> None:
        """Test what was summed; what was found stays until the last test of a window clears it."""
        information, score = self._before[0] + self._information, self._before[1] + self._score
        spread = information + information @ self._prior @ information
        scale = np.sqrt(np.maximum(spread.diagonal(), 1e-300))
        values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
        keep = values > NEGLIGIBLE * values[-1]
        whiten = (vectors[:, keep] / np.sqrt(values[keep])).T / scale
        white, shifts = whiten @ score, whiten @ information @ self._directions
        known = np.square(shifts).sum(axis=0)
        known[known <= NEGLIGIBLE * known.max()] = np.inf
        sizes = (shifts.T @ white) / known
        scores = sizes**2 * np.where(np.isfinite(known), known, 0.0)
        best = int(scores.argmax())
        chance = min(chdtrc(len(white), white @ white), len(scores) * chdtrc(1, scores[best]))
        if chance < CHANCE:
            self.mismatch = self._off(best, sizes[best], chance)
            self._begin(stamp_ns)  # so that it ends a window after what it tells
        elif last:
            self.mismatch = ""
