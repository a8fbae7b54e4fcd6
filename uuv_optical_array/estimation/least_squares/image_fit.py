"""The fit of an image: the posterior of the pose, over all else that the scene leaves unknown.

An image is fitted first as a clear frame, then as each other kind of frame that is still likely,
and without faulty detectors; the fits are weighted by their evidence.
"""

import math
from collections.abc import Callable
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, ndtr, ndtri

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, PITCH, Array, X, turned_about_beam, wrapped
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.linear_algebra import solve
from uuv_optical_array.estimation.estimate import Estimate
from uuv_optical_array.estimation.information.linearised import LinearisedReadings, Lineariser
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
    LINEARISED,
    MISFIT,
    NO_START,
    NOTHING,
    NOWHERE,
    ONE_STEP,
    FrameResult,
    estimate_frame,
)
from uuv_optical_array.estimation.least_squares.frame_kinds import (
    FrameKind,
    expecting,
    frame_kinds,
    mixture,
)
from uuv_optical_array.estimation.least_squares.linear_model import LinearModel
from uuv_optical_array.estimation.least_squares.no_lamp import NoLamp
from uuv_optical_array.estimation.least_squares.posterior import LOG_2PI
from uuv_optical_array.estimation.least_squares.problem import (
    STEEPEST,
    UNUSUAL,
    Problem,
    lit,
)
from uuv_optical_array.estimation.least_squares.starts import Guide, guide_of
from uuv_optical_array.estimation.signature import features
from uuv_optical_array.estimation.signature_table import grid_axes
from uuv_optical_array.estimation.unknowns import joint_coordinates
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import ReadingNoise
from uuv_optical_array.forward.optics import Optics
from uuv_optical_array.forward.scene import Scene

# The pose's prior is Gaussian about the middle of the table, this many half extents wide: too
# wide to be seen where the image says much, and finite where it says nothing.
PRIOR_HALF_EXTENTS = 3.0
# A degree of freedom is unobservable where the image leaves more than this of the prior.
UNOBSERVABLE = 0.5
# An image is as good as linear where its posterior's mode is within so many standard deviations of
# its mean (0.1 near the lamp, 1 far away or of a planar array), and its range known to this share.
BENT, FAR = 0.5, 0.06
# Score from which detectors may be faulty: of one valid image of two hundred.
DOUBTFUL = 2.576
# Score up to which a kind that is not clear must fit: that of one image of fifty, or of a thousand
# by several lamps, which have enough readings for it.
MENDED, MENDED_BY_SEVERAL = 2.054, UNUSUAL
# And the same where light differs by more than its usual sizes, as anything nearly fits there.
EVEN = 0.0
# Share of the others that are lit where a row or column is hidden; else the pose may be the cause.
MOSTLY_LIT = 0.75
# Logarithm of the odds of a kind against a clear frame, by a linear step, from which it counts, and
# from which it is fitted.
LOG_CONSIDERED, LOG_LIKELY = math.log(0.002), math.log(0.2)
CLEAR = 0.9  # probability beyond which an image counts as clear
# Pitch, rad, beyond which a fit may have stopped at the steepest on its way to a steeper one.
STEEP = STEEPEST - 0.03
# How many times as probable an image must be with the lamp as without it: so at most one of as many
# images without it has a pose.
SEEN = 100.0
# Probability that a lamp is off or hidden, and chance of noise from which a dark one may be.
LAMP_OFF, LIKELY_DARK = 1e-3, 1e-3


def pose_prior(scene: Scene) -> tuple[Array, Array]:
    """Return mean and standard deviation of the pose by the table, m and rad, ``(5,)`` each."""
    axes = grid_axes(scene.table)
    middle = np.array([(axis[0] + axis[-1]) / 2 for axis in axes])
    half = np.array([(axis[-1] - axis[0]) / 2 for axis in axes])
    return middle, PRIOR_HALF_EXTENTS * np.maximum(half, 0.2)


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
    def log_evidence(self) -> float:
        """Logarithm of the probability of image and kind, without constants."""
        return math.log(self.kind.share) + self.log_chance + self.frame.log_evidence

    @property
    def refused(self) -> "Hypothesis":
        """The hypothesis without a pose, where it has one."""
        if self.frame.outcome != FITTED:
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


class ImageFit:
    """Fits the images of a scene; made once, so that no frame takes longer than the next.

    - model: the scene's forward model; the extent of its table is where the lamp is looked for.
    - constants: what the scene leaves unknown.
    - candidates, max_misfit, compiled: as of `Estimator`.
    - guide: where fits start from and how far they go, unless they are told otherwise.
    """

    def __init__(
        self,
        model: ForwardModel,
        constants: Constants,
        candidates: int,
        max_misfit: float,
        compiled: bool,
    ) -> None:
        scene = model.scene
        self._model, self._constants = model, constants
        self._max_misfit = max_misfit
        self._most_mended = MENDED_BY_SEVERAL if scene.lamps else MENDED
        self._pose_prior = pose_prior(scene)
        # What the evidence of all frames leaves out of the pose's prior.
        self._log_prior = -float(np.log(self._pose_prior[1]).sum()) - LOG_2PI
        self._pose_precision = np.diag(1 / np.square(self._pose_prior[1]))
        self._unobservable_variance = (UNOBSERVABLE * self._pose_prior[1]) ** 2
        self.guide = guide_of(model, candidates, float(-ndtri(max_misfit)))
        self.run(compiled)

    def run(self, compiled: bool) -> None:
        """Run compiled by Numba from the next image on, or as plain Python.

        - ValueError: where it is to be compiled and Numba is not installed, or not for this NumPy.
        """
        model, constants = self._model, self._constants
        kinds = frame_kinds(model, *self._pose_prior)
        frame: Callable[..., Any] = estimate_frame
        if compiled:
            features.prepare(model.array.side)
            joint_coordinates.prepare(constants)
            example = self.guide, BELIEVED, NOWHERE, NOTHING
            ready = compilation.prepare(estimate_frame, kinds[0].problem, *example)
            for kind in kinds:  # all are of the same types
                frame = compilation.entry(ready, kind.problem, *example)
        lineariser, linear = Lineariser(model, constants.names, self._write_linear), None
        if model.scene.lamps:
            writing = self._pose_precision, self._write_linear
            linear = LinearModel(model, kinds, constants.names, *writing)
        self._kinds, self._linearise, self._frame, self._linear = kinds, lineariser, frame, linear
        self._no_lamp = None if model.scene.lamps else NoLamp(model, kinds)
        self.compiled = compiled

    def _write_linear(
        self,
        optics: Optics,
        noise: ReadingNoise,
        readings: Array,
        at: Array,
        roll: float,
        linear: Array,
    ) -> None:
        """Do what `write_linear` does by what fits an image."""
        problem = self._kinds[0].problem._replace(
            optics=optics, noise=noise, readings=readings, roll=roll
        )
        self._frame(problem, self.guide, LINEARISED, at, linear)

    @np.errstate(all="ignore")  # of light too dim and places too far for a float64
    def __call__(
        self,
        readings: Array,
        roll: float = 0.0,
        uneven: float | None = None,
        guide: Guide | None = None,
    ) -> Estimate:
        """Fit an image.

        - readings: counts, shape ``(m,)``.
        - roll, uneven: as of `Estimator.estimate`.
        - guide: ``None``: that of all images, some of whose detectors may be faulty.
        - NoPose: for an image that no pose of the scene explains.
        """
        image, kinds = Image(readings, roll), expecting(self._kinds, uneven)
        found = self._hypotheses(image, kinds, guide or self.guide, faults=guide is None)
        if self._no_lamp:
            self._check_seen(self._no_lamp, readings, kinds, found)
        return self._together(image, found, uneven is not None)

    def _hypotheses(
        self, image: Image, kinds: list[FrameKind], guide: Guide, faults: bool
    ) -> list[Hypothesis]:
        """Return the hypotheses of an image, the clear one first."""
        problem = image.problem(kinds[0])
        dark = self._without_dark_lamp(image, kinds[0], problem, guide) if self._linear else None
        # Where a lamp is dark, no start with all of them may lead anywhere.
        start = self._from(dark.frame.best[:5], image.roll) if dark else guide
        clear = self._hypothesis(kinds[0], problem, start)
        found = [clear, dark] if dark else [clear]
        if dark and clear.frame.outcome != FITTED:
            return found
        start = guide
        if faults and clear.frame.score > DOUBTFUL:
            mended = self._mended(image, kinds[0])
            found += mended
            if mended[0].frame.outcome == FITTED:
                start = self._from(mended[0].frame.best[:5], image.roll)
        if clear.frame.outcome == FITTED:
            for kind in kinds[1:]:
                beside = self._beside(image, kind, clear)
                if beside:
                    found.append(beside)
                elif kind.size >= 1:
                    break  # a larger one is less likely still
            return found
        found += [self._uneven(kind, image.problem(kind), start) for kind in kinds[:0:-1]]
        if faults and not any(each.frame.outcome == FITTED for each in found):
            # Very uneven light beside a few detectors that are not believed would explain anything.
            found += self._mended(image, kinds[1]) if len(kinds) > 1 else []
        return found

    def _hypothesis(
        self, kind: FrameKind, problem: Problem, guide: Guide, way: int = BELIEVED
    ) -> Hypothesis:
        frame, near = self._frame(problem, guide, way, NOWHERE, NOTHING), None
        if self._linear:
            frame, near = self._linear.about(kind, problem, frame)
        if kind.doubt != 1:
            frame = frame._replace(covariance=kind.doubt * frame.covariance)
        return Hypothesis(kind, problem, frame, near)

    def _uneven(self, kind: FrameKind, problem: Problem, guide: Guide) -> Hypothesis:
        """Fit an image as one that is not clear, which must fit as well as most of these."""
        found = self._hypothesis(kind, problem, guide)
        return found if self._fits(found) else found.refused

    def _beside(self, image: Image, kind: FrameKind, clear: Hypothesis) -> Hypothesis | None:
        """Return the hypothesis of a kind near the fit of a clear frame, if it is likely.

        One linear step gives its probability, and is enough where that is small.
        """
        problem, at = image.problem(kind), np.zeros(5 + len(kind.names))
        at[:5], at[5 + kind.shared] = clear.frame.coordinates, clear.frame.best[5:]
        near = self._frame(problem, self.guide, ONE_STEP, at, NOTHING)
        log_odds = math.log(kind.share / clear.kind.share)
        log_odds += near.log_evidence - clear.frame.linear_log_evidence
        if not log_odds > LOG_CONSIDERED:
            return None
        if log_odds > LOG_LIKELY or self._linear:
            return self._uneven(kind, problem, self._from(clear.frame.best[:5], image.roll))
        odds = near.log_evidence + clear.frame.log_evidence - clear.frame.linear_log_evidence
        frame = clear.frame._replace(pose=near.pose, covariance=near.covariance, log_evidence=odds)
        return Hypothesis(kind, problem, frame, None)

    def _mended(self, image: Image, kind: FrameKind) -> list[Hypothesis]:
        """Fit an image with faulty readings, if they are few and the others fit.

        If they are neighbours, all of their row or column may be faulty.
        """
        problem, lamps = image.problem(kind), self._model.scene.lamp_count
        most, readings = most_faulty(problem), problem.readings.copy()
        problem = problem._replace(readings=readings, weights=np.ones(len(readings)))
        found = self._hypothesis(kind, problem, self.guide, DOUBTED)
        out = found.frame.weights < 0.5
        if np.count_nonzero(out) > most * lamps:
            return [found.refused]
        mended = [found]
        line = lines_of_neighbours(out.reshape(self._model.image_shape)).ravel()
        others = image.readings[~line]
        if line.any() and lit(others, problem) >= MOSTLY_LIT * len(others):
            weights = np.where(line, 0.0, found.frame.weights)
            problem = image.problem(kind)._replace(weights=weights)
            hidden = self._hypothesis(kind, problem, self.guide)
            noise, more = problem.noise, np.count_nonzero(line & ~out) / lamps
            chance = log_faulty(image.readings, image.readings, noise, weights, lamps)
            # As probable as that its neighbours alone are.
            mended.append(hidden._replace(log_chance=float(chance - more * math.log(FAULTY))))
        return [each if self._fits(each) else each.refused for each in mended]

    def _without_dark_lamp(
        self, image: Image, kind: FrameKind, problem: Problem, guide: Guide
    ) -> Hypothesis | None:
        """Return a clear frame without a lamp that shows nothing, as if it were off or hidden."""
        noise = problem.noise
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
        problem = problem._replace(weights=weights.ravel())
        found = self._hypothesis(kind, problem, guide)
        chance = math.log(LAMP_OFF) - 0.5 * squares[dark]
        return found._replace(log_chance=chance) if self._fits(found) else None

    def _fits(self, found: Hypothesis) -> bool:
        """Say whether a frame that is hardly a clear one fits as if it were."""
        most = EVEN if found.kind.size > 1 else self._most_mended
        return found.frame.outcome == FITTED and found.frame.score <= most

    def _from(self, pose: Array, roll: float) -> Guide:
        """Return the guide of a fit from the pose of a follower of this roll."""
        # The frame turns poses of level followers.
        poses = np.tile(turned_about_beam(pose, -roll), (2, 1))
        # Contiguous, else Numba compiles once more.
        units, roots = self.guide.units[:, :2].copy(), self.guide.roots[:, :0].copy()
        return self.guide._replace(poses=poses, units=units, roots=roots, candidates=1)

    def _together(self, image: Image, found: list[Hypothesis], tracked: bool) -> Estimate:
        """Return the mixture of hypotheses, with readings for a track; `NoPose` where none fits."""
        main, result, clear = found[0], found[0].frame, 1.0
        if len(found) > 1:
            result, shares = mixture([h.frame for h in found], [h.log_evidence for h in found])
            # A frame with faulty detectors or a dark lamp is lit as the scene says, too.
            clears = [i for i, each in enumerate(found) if each.kind.names == main.kind.names]
            main = found[max(clears, key=lambda i: shares[i])]
            clear = min(sum(shares[i] for i in clears), 1.0)
        self._check(result)
        pose, rolls, near = result.pose[:5], result.pose[5:], None
        covariance: Array = result.covariance[:5, :5]
        if main.near:
            near, count = main.near, 5 + len(self._constants.names)
            near = near._replace(at=near.at[:count], slopes=near.slopes[:, :count])
        elif tracked:
            stds = np.array(self._constants.stds[len(main.kind.names) :])
            at = np.concatenate([main.frame.best, np.zeros(len(stds))])
            near = self.near(image.readings, at, image.roll, main.frame.weights)
            if len(stds) and clear > 0:
                # A clear frame takes as exact what only many images determine; it is not.
                prior = self._pose_precision, main.problem.nuisance_precision
                slopes = stds * near.pose_slopes(*prior, self._constants.gain_std)
                covariance = covariance + clear * slopes @ slopes.T
        # A reading at full scale says only how little the light is at least, which is not linear.
        if near and not (clear > CLEAR and image.readings.max() < self._model.noise.high):
            near = None
        dark, left_out = self._left_out(result.weights)
        unobservable = covariance.diagonal() > self._unobservable_variance
        return Estimate(
            pose=pose,
            covariance=covariance,
            angle_rad=result.angle,
            runner_up_pose=None if math.isnan(result.runner_up_score) else result.runner_up,
            runner_up_angle_rad=result.runner_up_angle,
            misfit=float(ndtr(-result.score)),
            runner_up_misfit=float(ndtr(-result.runner_up_score)),
            unobservable=tuple(compress(DOF_NAMES, unobservable)),
            readings=near,
            clear=clear,
            left_out=left_out,
            roll=float(rolls[0]) if len(rolls) else 0.0,
            turn=result.covariance[:, 5] if len(rolls) else None,
            dark_lamp=dark,
            believed=main.frame.weights,
            bent=near is not None and not main.nearly_gaussian,
        )

    def _check_seen(
        self, no_lamp: NoLamp, readings: Array, kinds: list[FrameKind], found: list[Hypothesis]
    ) -> None:
        """Raise `NoPose` for an image that is hardly more probable with the lamp than without."""
        fitted = [each.log_evidence for each in found if each.frame.outcome == FITTED]
        if not fitted:
            return
        log_seen = float(np.logaddexp.reduce(fitted)) + self._log_prior
        if log_seen - no_lamp.most(readings) > math.log(SEEN):
            return
        log_odds = log_seen - no_lamp.log_evidence(readings, [kind.share for kind in kinds])
        if log_odds < math.log(SEEN):
            raise NoPose(
                f"no light: the image is {math.exp(log_odds):.2g} times as probable with the lamp "
                f"as with daylight alone, less than {SEEN:g}"
            )

    def _left_out(self, weights: Array) -> tuple[int | None, tuple[tuple[int, int], ...]]:
        """Return the lamp, and the detectors, whose readings are not believed."""
        if not weights.min() < 0.5:
            return None, ()
        out = weights.reshape(self._model.scene.lamp_count, -1) < 0.5
        dark = np.flatnonzero(out.all(axis=1)).tolist()
        detectors = np.flatnonzero(out[[i for i in range(len(out)) if i not in dark]].any(axis=0))
        places = (divmod(it, self._model.array.side) for it in detectors.tolist())
        return dark[0] if dark else None, tuple(places)

    def near(self, readings: Array, at: Array, roll: float, weights: Array) -> LinearisedReadings:
        """Return readings linearised at a place, as far as they are believed."""
        return self._linearise(readings, at, roll).believed(weights)

    def _check(self, result: FrameResult) -> None:
        """Raise `NoPose` for a result without a pose."""
        if result.outcome == NO_START:
            raise NoPose("no fit: no start led to a finite likelihood")
        if result.outcome == MISFIT:
            raise NoPose(
                f"no fit: an image of this scene leaves such residuals with a probability of "
                f"{ndtr(-result.score):.1e}, less than max_misfit {self._max_misfit:g}"
            )
        if result.outcome != FITTED:
            raise NoPose("no fit: the image does not determine a covariance of the pose")
        if abs(pitch := result.best[PITCH]) > STEEP:
            raise NoPose(
                f"no fit: the follower would pitch by {math.degrees(pitch):.1f} deg, "
                f"more than the {math.degrees(STEEP):.1f} deg that a fit can tell"
            )
