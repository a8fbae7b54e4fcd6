"""How probable an image is without the lamp: by daylight and noise alone."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.special import logsumexp

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.information.likelihood import log_likelihood
from uuv_optical_array.estimation.least_squares.frame_kinds import FrameKind
from uuv_optical_array.forward.daylight import without_lamps
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import grows, reading_variance
from uuv_optical_array.forward.prior import DAYLIGHT

STEPS = 3  # of Gauss and Newton: readings at zero, or of photons, are not quite Gaussian


class NoLamp:
    """Weighs images of a scene as if its one lamp were out, by each kind of frame.

    Light without the lamp is linear in what is unknown of it, so its posterior is as good as
    Gaussian.

    - model, kinds: of the scene.
    """

    def __init__(self, model: ForwardModel, kinds: Sequence[FrameKind]) -> None:
        self._noise = noise = kinds[0].problem.noise
        # Of a reading inside of the limits, at least, where noise grows with the light.
        least = reading_variance(noise.black, noise) if grows(noise) else 1.0
        self._log_variance = math.log(least)
        names = [name for name in DAYLIGHT if name in kinds[-1].names]
        self._light, slopes = without_lamps(model, names)
        self._even, _ = np.linalg.qr(np.vstack([np.ones(slopes.shape[1]), slopes]).T)
        self._daylight: list[tuple[Array, Array]] = []
        for kind in kinds:
            among = [names.index(name) for name in names if name in kind.names]
            own = [kind.names.index(names[i]) for i in among]
            self._daylight.append((slopes[among], kind.problem.nuisance_std[own] ** -2.0))

    def most(self, readings: Array) -> float:
        """Return what `log_evidence` does not exceed, in a tenth of its time."""
        off, noise = readings - self._light, self._noise
        along = off @ self._even
        squares = float(off @ off - along @ along)
        inside = np.count_nonzero((noise.low < readings) & (readings < noise.high))
        log: float = -0.5 * squares / reading_variance(float(readings.max()), noise)
        return log - 0.5 * inside * self._log_variance

    def log_evidence(self, readings: Array, shares: Sequence[float]) -> float:
        """Return the logarithm of the probability of an image, less what all kinds have in common.

        - readings: counts, shape ``(n,)``.
        - shares: of the kinds of frame.
        """
        of_kinds = [self._of_kind(readings, *daylight) for daylight in self._daylight]
        return float(logsumexp(of_kinds, b=shares))

    def _of_kind(self, readings: Array, slopes: Array, precision: Array) -> float:
        """Return the logarithm of the probability by Laplace's approximation."""
        at, size, log = np.zeros(len(precision)), len(precision), 0.0
        for _ in range(STEPS if size else 0):
            _, score, curvature = log_likelihood(readings, self._light + at @ slopes, self._noise)
            factor, _ = dpotrf((curvature * slopes) @ slopes.T + np.diag(precision), lower=1)
            step, _ = dpotrs(factor, slopes @ score - precision * at, lower=1)
            at, log = at + step, 0.5 * float(np.log(precision).sum())
            log -= float(np.log(factor.diagonal()).sum())
        value, _, _ = log_likelihood(readings, self._light + at @ slopes, self._noise)
        return log + float(value.sum() - 0.5 * precision @ (at * at))
