"""What an image may show, each with its fit: a clear frame, uneven light, faults, a dark lamp.

An image is fitted first as a clear frame, then as each other kind of frame that is still likely,
and without faulty detectors.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array, X, turned_about_beam, wrapped
from uuv_optical_array.core.numerics.linear_algebra import solve
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.least_squares.faults import (
    FAULTY,
    lines_of_neighbours,
    log_faulty,
    most_faulty,
)
from uuv_optical_array.estimation.least_squares.frame import (
    BELIEVED,
    DOUBTED,
    FITTED,
    MISFIT,
    NOWHERE,
    ONE_STEP,
    FrameResult,
    frame_result,
)
from uuv_optical_array.estimation.least_squares.frame_kinds import FrameKind
from uuv_optical_array.estimation.least_squares.linear_model import LinearModel
from uuv_optical_array.estimation.least_squares.problem import Problem, light_at, lit
from uuv_optical_array.estimation.least_squares.starts import Guide
from uuv_optical_array.estimation.unknowns.coordinates import from_pose
from uuv_optical_array.forward.model import ForwardModel

# An image is as good as linear where its posterior's mode is within so many standard deviations of
# its mean (0.1 near the lamp, 1 far away or of a planar array), and its range known to this share.
BENT, FAR = 0.5, 0.06
# Score that one valid image of fifty exceeds, or one of a thousand by several lamps, which have
# enough readings for it. Beyond it a clear image may have faulty detectors, and uneven or faulty
# ones are refused.
DOUBTFUL, DOUBTFUL_BY_SEVERAL = 2.054, 3.09
# The same where light is off by more than its usual sizes, as anything nearly fits there: the
# score of every second valid image.
EVEN = 0.0
# Standard deviations of the prior by which no unknown of an unclear kind may be off, such as the
# roll where lamps are exchanged.
FAR_OFF = 5.5
# Share of the others that are lit where a row or column is hidden; else the pose may be the cause.
MOSTLY_LIT = 0.75
# Logarithm of the odds of a kind against a clear frame, by a linear step, from which it counts, and
# from which it is fitted.
LOG_CONSIDERED, LOG_LIKELY = math.log(0.002), math.log(0.2)
# Probability that a lamp is off or hidden, and chance of noise from which a dark one may be.
LAMP_OFF, LIKELY_DARK = 1e-3, 1e-3


class Image(NamedTuple):
    """An image and what is known of it, as `ImageFit` is given them."""

    readings: Array
    roll: float

    def problem(self, kind: FrameKind) -> Problem:
        """Return the posterior of the image as a frame of a kind."""
        return kind.problem._replace(readings=self.readings, roll=self.roll)


class Hypothesis(NamedTuple):
    """A kind of frame that an image may be of, with its fit; by several lamps linear readings.

    - log_chance: logarithm of the probability of further assumptions, such as a dark lamp.
    """

    kind: FrameKind
    problem: Problem
    frame: FrameResult
    near: LinearisedReadings | None
    log_chance: float = 0.0

    @property
    def fitted(self) -> bool:
        """Whether there is a pose."""
        return self.frame.outcome == FITTED

    @property
    def log_evidence(self) -> float:
        """Logarithm of the probability of image and kind, without constants."""
        return math.log(self.kind.share) + self.log_chance + self.frame.log_evidence

    @property
    def refused(self) -> "Hypothesis":
        """The hypothesis without a pose, where it has one."""
        if not self.fitted:
            return self
        return self._replace(frame=self.frame._replace(outcome=MISFIT))

    @property
    def nearly_gaussian(self) -> bool:
        """Whether the posterior is nearly Gaussian, and the image as good as linear."""
        frame = self.frame
        covariance = frame.covariance[:5, :5]
        if frame.wider or not covariance[X, X] < (FAR * frame.pose[X]) ** 2:
            return False
        off = wrapped(frame.best[:5] - frame.pose[:5])
        return bool(self.near or off @ solve(covariance, off) < BENT**2)


class Hypotheses:
    """Fits an image of a scene as each of what it may show.

    - model: the scene's forward model.
    - fit_frame: `estimate_frame`, compiled or not.
    - linear: for several lamps; else ``None``.
    - guide: where fits start from, unless they are told otherwise, and how far they go.
    """

    def __init__(
        self,
        model: ForwardModel,
        fit_frame: Callable[..., Any],
        linear: LinearModel | None,
        guide: Guide,
    ) -> None:
        self._model, self._frame, self._linear, self._guide = model, fit_frame, linear, guide
        self._doubtful = DOUBTFUL_BY_SEVERAL if model.scene.lamps else DOUBTFUL

    def of(self, image: Image, kinds: list[FrameKind], match: Array | None) -> list[Hypothesis]:
        """Return the hypotheses of an image by kinds of frame, the clear one first in both.

        - match: as of `ImageFit`; then no detector is taken to be faulty.
        - NoPose: where more than one lamp shows nothing.
        """
        (kind, *others), faults = kinds, match is None
        start = NOWHERE if match is None else match
        dark = self._without_dark_lamp(image, kind, start) if self._linear else None
        # Where a lamp is dark, no start with all of them may lead anywhere.
        near = _level(dark, image) if dark else start
        clear = self._hypothesis(kind, image.problem(kind), near)
        found = [clear, dark] if dark else [clear]
        if dark and not clear.fitted:
            return found
        if faults and clear.frame.score > self._doubtful:
            mended = self._mended(image, kind)
            found += mended
            if mended[0].fitted:
                start = _level(mended[0], image)
        if clear.fitted:
            return found + self._beside_clear(image, others, clear)
        found += [self._uneven(other, image.problem(other), start) for other in reversed(others)]
        if faults and others and not any(each.fitted for each in found):
            # Very uneven light beside a few detectors that are not believed would explain anything.
            found += self._mended(image, others[0])
        return found

    def _hypothesis(
        self, kind: FrameKind, problem: Problem, start: Array, way: int = BELIEVED
    ) -> Hypothesis:
        """Fit a problem from the pose of a level follower, or from `NOWHERE`."""
        frame, near = frame_result(self._frame, problem, self._guide, way, start), None
        if self._linear and frame.outcome == FITTED:
            frame, near = self._linear.about(kind, problem, frame)
        if kind.doubt != 1:
            frame = frame._replace(covariance=kind.doubt * frame.covariance)
        return Hypothesis(kind, problem, frame, near)

    def _uneven(self, kind: FrameKind, problem: Problem, start: Array) -> Hypothesis:
        """Fit an image as one that is not clear, which must fit as well as most of these."""
        found = self._hypothesis(kind, problem, start)
        return found if self._fits(found) else found.refused

    def _beside_clear(
        self, image: Image, kinds: list[FrameKind], clear: Hypothesis
    ) -> list[Hypothesis]:
        """Return the hypotheses of unclear kinds, the least uneven first, that are likely."""
        found = []
        for kind in kinds:
            beside = self._beside(image, kind, clear)
            if beside:
                found.append(beside)
            elif kind.size >= 1:
                break  # a larger one is less likely still
        return found

    def _beside(self, image: Image, kind: FrameKind, clear: Hypothesis) -> Hypothesis | None:
        """Return the hypothesis of a kind near the fit of a clear frame, if it is likely.

        One linear step gives its probability, and is enough where that is small.
        """
        problem, at = image.problem(kind), np.zeros(5 + len(kind.names))
        at[:5], at[5 + kind.shared] = clear.frame.best[:5], clear.frame.best[5:]
        near = frame_result(self._frame, problem, self._guide, ONE_STEP, at)
        log_odds = math.log(kind.share / clear.kind.share)
        log_odds += near.log_evidence - clear.frame.linear_log_evidence
        if not log_odds > LOG_CONSIDERED:
            return None
        if log_odds > LOG_LIKELY or self._linear:
            return self._uneven(kind, problem, _level(clear, image))
        odds = near.log_evidence + clear.frame.log_evidence - clear.frame.linear_log_evidence
        frame = clear.frame._replace(pose=near.pose, covariance=near.covariance, log_evidence=odds)
        return Hypothesis(kind, problem, frame, None)

    def _mended(self, image: Image, kind: FrameKind) -> list[Hypothesis]:
        """Fit an image without faulty detectors, if these are few and the others fit.

        If they are neighbours, it is also fitted without all of their row or column.
        """
        problem, lamps = image.problem(kind), self._model.scene.lamp_count
        most, readings = most_faulty(problem), problem.readings.copy()
        problem = problem._replace(readings=readings, weights=np.ones(len(readings)))
        found = self._hypothesis(kind, problem, NOWHERE, DOUBTED)
        out = found.frame.weights < 0.5
        if np.count_nonzero(out) > most * lamps:
            return [found.refused]
        mended = [found]
        line = lines_of_neighbours(out.reshape(self._model.image_shape)).ravel()
        others = image.readings[~line]
        if line.any() and lit(others, problem) >= MOSTLY_LIT * len(others):
            weights = np.where(line, 0.0, found.frame.weights)
            problem = image.problem(kind)._replace(weights=weights)
            hidden = self._hypothesis(kind, problem, NOWHERE)
            more, at = np.count_nonzero(line & ~out) / lamps, hidden.frame.best.copy()
            at[:5] = from_pose(problem.frame, at, problem.roll)
            light = light_at(problem, at)
            chance = log_faulty(image.readings, light, problem.noise, weights, lamps)
            # As probable as that its neighbours alone are.
            mended.append(hidden._replace(log_chance=float(chance - more * math.log(FAULTY))))
        return [each if self._fits(each) else each.refused for each in mended]

    def _without_dark_lamp(self, image: Image, kind: FrameKind, start: Array) -> Hypothesis | None:
        """Return a clear frame without a lamp that shows nothing, as if it were off or hidden."""
        noise = kind.problem.noise
        images = image.readings.reshape(self._model.scene.lamp_count, -1)
        squares = (np.square(images - noise.black) / noise.variance).sum(axis=1)
        dark = int(squares.argmin())
        likely = int((chdtrc(images.shape[1], squares) >= LIKELY_DARK).sum())
        if likely > 1:  # they may be off, or the follower may be where only the others shine
            raise NoPose(f"no fit: {likely} of {len(squares)} lamps show nothing")
        if not likely:
            return None
        weights = np.ones_like(images)
        weights[dark] = 0.0
        problem = image.problem(kind)._replace(weights=weights.ravel())
        found = self._hypothesis(kind, problem, start)
        chance = math.log(LAMP_OFF) - 0.5 * squares[dark]
        return found._replace(log_chance=chance) if self._fits(found) else None

    def _fits(self, found: Hypothesis) -> bool:
        """Return whether a frame that is not clear, or has faults, fits well enough."""
        frame, problem = found.frame, found.problem
        most = EVEN if found.kind.size > 1 else self._doubtful
        if not found.fitted or frame.score > most:
            return False
        offs = np.abs(frame.best[5:] - problem.nuisance_mean) / problem.nuisance_std
        return not (found.kind.size > 0 and (offs > FAR_OFF).any())


def _level(found: Hypothesis, image: Image) -> Array:
    """Return the pose that was found, turned about the beam to that of a level follower."""
    return turned_about_beam(found.frame.best[:5], -image.roll)
