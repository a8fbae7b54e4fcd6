"""An image fitted: its posterior of the pose, over what else the scene leaves unknown.

What may be behind an image is tried first as a clear frame, then as one of each other kind that is
likely by then, and without faulty detectors; what fits is weighed by its evidence.
"""

import math
from collections.abc import Callable
from itertools import compress
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, ndtr, ndtri

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import (
    DOF_NAMES,
    PITCH,
    Array,
    X,
    turned_about_beam,
    wrapped,
)
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.linear_algebra import solve
from uuv_optical_array.estimation.estimate import Estimate
from uuv_optical_array.estimation.information.linearised import LinearisedReadings, Lineariser
from uuv_optical_array.estimation.least_squares.faults import log_evidence, most_faulty
from uuv_optical_array.estimation.least_squares.frame import (
    FITTED,
    MISFIT,
    NO_START,
    FrameResult,
    Guide,
    estimate_frame,
)
from uuv_optical_array.estimation.least_squares.frame_kinds import (
    SUSPECTED,
    FrameKind,
    expecting,
    frame_kinds,
    is_doubtful,
    mixture,
)
from uuv_optical_array.estimation.least_squares.linear_model import LinearModel, LinearModels
from uuv_optical_array.estimation.least_squares.problem import STEEPEST, UNUSUAL, Problem
from uuv_optical_array.estimation.signature import features
from uuv_optical_array.estimation.signature.features import lifted, scene_parameters
from uuv_optical_array.estimation.signature.spectral_angle import unit_vectors
from uuv_optical_array.estimation.signature_table import MIN_PEAK_COUNTS, grid_axes, no_light
from uuv_optical_array.estimation.unknowns import joint_coordinates
from uuv_optical_array.estimation.unknowns.constants import Constants, Expected
from uuv_optical_array.forward.model import ForwardModel

# The pose's prior is Gaussian about the middle of the table, this many half extents wide: too
# wide to be seen where the image says much, and finite where it says nothing.
PRIOR_HALF_EXTENTS = 3.0
# A degree of freedom is unobservable where the image leaves more than this of the prior.
UNOBSERVABLE = 0.5
# An image is as good as linear where its posterior's mode is within so many standard deviations of
# its mean (0.1 near by, 1 from afar or of a planar array), and its range known to this share.
BENT, FAR = 0.5, 0.06
# Poses of the working volume from which fits may start: more make no fit more exact.
STARTS = 1024
# Beside them poses nearer than that, and the share of the range that they go down to; and as many
# down to this share of the least range, the farther off the beam's axis the nearer.
NEAR_STARTS, NEAREST, ASIDE = 4096, 0.2, 0.15
BY_SIGNATURE = 1536  # of all these are looked up by their signature, too, and the others by image
# Score from which detectors may be faulty: of one valid image of two hundred.
DOUBTED = 2.576
# Score up to which the others have to fit: that of one image of fifty, or of a thousand by several
# lamps, whose readings are enough to tell.
MENDED, MENDED_BY_SEVERAL = 2.054, UNUSUAL
# Probability, by a fit that is linear about its minimum, from which no other kind is integrated.
MOSTLY_CLEAR = 0.8
CLEAR = 0.99  # probability beyond which an image counts as one that nothing shades
# By several lamps all but clear frames are so many times as frequent in the moments of the pose, as
# a shade may look like another pose, and the shares are a choice.
OFTEN = 3.0
# Pitch, rad, beyond which a fit may have stopped at the steepest on its way to a steeper one.
STEEP = STEEPEST - 0.03
# Probability that a lamp is off or hidden, and chance of noise from which a dark one may be.
LAMP_OFF, LIKELY_DARK = 1e-3, 1e-3


class Image(NamedTuple):
    """An image and what is known of it, as `ImageFit` is given them."""

    readings: Array
    roll: float
    expected: Expected | None

    def problem(self, kind: FrameKind) -> Problem:
        """Return the posterior of the image as a frame of a kind."""
        return kind.knowing(self.expected)._replace(readings=self.readings, roll=self.roll)


class Hypothesis(NamedTuple):
    """A kind of frame that may be behind an image, and its fit; by several lamps a linear model."""

    kind: FrameKind
    problem: Problem
    frame: FrameResult
    linear: LinearModel | None

    @property
    def log_evidence(self) -> float:
        """Logarithm of the probability of image and kind, without constants."""
        volume = np.linalg.slogdet(self.problem.nuisance_precision)[1] / 2
        return float(math.log(self.kind.share) + volume + self.frame.log_evidence)

    @property
    def nearly_gaussian(self) -> bool:
        """Whether the posterior is nearly Gaussian, and the image as good as linear."""
        frame = self.frame
        covariance = frame.covariance[:5, :5] / frame.stretch
        if frame.wider or not covariance[X, X] < (FAR * frame.pose[X]) ** 2:
            return False
        off = wrapped(frame.best[:5] - frame.pose[:5])
        return bool(self.linear or off @ solve(covariance, off) < BENT**2)


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
        axes = grid_axes(scene.table)
        middle = np.array([(axis[0] + axis[-1]) / 2 for axis in axes])
        half = np.array([(axis[-1] - axis[0]) / 2 for axis in axes])
        self._pose_prior = middle, PRIOR_HALF_EXTENTS * np.maximum(half, 0.2)
        self._pose_precision = np.diag(1 / np.square(self._pose_prior[1]))
        self._unobservable_variance = (UNOBSERVABLE * self._pose_prior[1]) ** 2
        poses, images = self._starts(axes)
        full_scale, peak = scene.full_scale_counts, scene.signature.peak
        side = model.array.side
        first = scene_parameters(images[:BY_SIGNATURE], scene)
        vectors, flat = lifted(first, scene.signature, side), images.reshape(len(poses), -1)
        self.guide = Guide(
            np.ascontiguousarray(unit_vectors(vectors).T),
            poses,
            np.ascontiguousarray(np.sqrt(np.maximum(flat, 0.0)).T),
            lifted(np.ones(5), scene.signature, side),
            candidates,
            float(-ndtri(max_misfit)),
            bool(scene.lamps),
            side,
            float(full_scale),
            peak == "subdetector",
        )
        self.run(compiled)

    def run(self, compiled: bool) -> None:
        """Run as Numba compiles it from the next image on, or as it stands.

        - ValueError: where it is to be compiled and Numba is not installed, or not for this NumPy.
        """
        model, constants = self._model, self._constants
        kinds = frame_kinds(model, *self._pose_prior)
        lineariser = Lineariser(model, constants.names, compiled)
        models = None
        if model.scene.lamps:
            models = LinearModels(model, kinds, constants.names, self._pose_precision, compiled)
        frame: Callable[..., FrameResult] = estimate_frame
        if compiled:
            features.prepare(model.array.side)
            joint_coordinates.prepare(constants)
            example = kinds[0].problem, self.guide, 0
            frame = compilation.prepare(estimate_frame, *example)
        self._kinds, self._linearise, self._frame, self._models = kinds, lineariser, frame, models
        self.compiled = compiled

    def _starts(self, axes: list[Array]) -> tuple[Array, Array]:
        """Return poses that fits may start from, and their images."""
        rng = np.random.default_rng(0)  # the same in every run: an image has one answer

        def drawn(count: int) -> Array:
            # Points of the grid: from its edges fits find minima that they miss from within.
            return np.stack([rng.choice(axis, count) for axis in axes], axis=-1)

        poses = drawn(STARTS)
        # Nearer than that the array saturates, and from afar no fit leads there.
        near = drawn(NEAR_STARTS)
        near[:, :3] *= rng.uniform(NEAREST, 1, (len(near), 1))
        aside = drawn(NEAR_STARTS)
        share = np.exp(rng.uniform(math.log(ASIDE), 0, NEAR_STARTS))
        aside[:, 0] = share * axes[0].max()
        aside[:, 1:3] *= np.sqrt(share)[:, None]
        poses = np.concatenate([poses, near, aside])
        images = self._model.converted(self._model.light(poses))
        lit = images.max(axis=(1, 2)) - self._model.noise.black >= MIN_PEAK_COUNTS
        if not lit.any():
            raise no_light(self._model.scene)
        return poses[lit], images[lit]

    @np.errstate(all="ignore")  # of light too dim and places too far for a float64
    def __call__(
        self,
        readings: Array,
        roll: float = 0.0,
        expected: Expected | None = None,
        guide: Guide | None = None,
    ) -> Estimate:
        """Fit an image.

        - readings: counts, shape ``(m,)``.
        - roll, expected: as of `Estimator.estimate`.
        - guide: ``None``: that of all images, some of whose detectors may be faulty.
        - NoPose: for an image that no pose of the scene explains.
        """
        image, kinds = Image(readings, roll, expected), expecting(self._kinds, expected)
        found = self._hypotheses(image, kinds, guide or self.guide, faults=guide is None)
        return self._together(image, found)

    def _hypotheses(
        self, image: Image, kinds: list[FrameKind], guide: Guide, faults: bool
    ) -> list[Hypothesis]:
        """Return what may be behind an image, detectors with faults too, first that it is clear."""
        models, problem = self._models, image.problem(kinds[0])
        dark = self._without_dark_lamp(image, kinds[0], problem, guide) if models else None
        # Where a lamp is dark, no start with all of them may lead anywhere.
        start = self._from(dark.frame.best[:5], image.roll) if dark else guide
        clear = self._hypothesis(kinds[0], problem, start)
        found = [clear, dark] if dark else [clear]
        if models and clear.linear:
            if clear.frame.outcome == NO_START or (dark and clear.frame.outcome == MISFIT):
                return found
            likely = models.likely(clear.linear, problem, kinds)
        else:
            likely = [not kind.rare or is_doubtful(clear.frame, kind.share) for kind in kinds[1:]]
        found += [self._other(image, kind, clear, guide) for kind in compress(kinds[1:], likely)]
        faulty = self._faulty(found) if faults else None
        return [*found, faulty] if faulty else found

    def _hypothesis(
        self, kind: FrameKind, problem: Problem, guide: Guide, most_faulty: int = 0
    ) -> Hypothesis:
        frame = self._frame(problem, guide, most_faulty)
        linear = None
        if self._models:
            frame, linear = self._models.about(kind, problem, frame)
        if kind.doubt != 1:
            frame = frame._replace(covariance=kind.doubt * frame.covariance)
        return Hypothesis(kind, problem, frame, linear)

    def _other(self, image: Image, kind: FrameKind, clear: Hypothesis, guide: Guide) -> Hypothesis:
        """Fit an image as a frame of another kind than a clear one."""
        problem = image.problem(kind)
        rare = kind.rare and kind.share <= SUSPECTED
        if self._models or (rare and not guide.gaussian):
            there = self._from(clear.frame.best[:5], image.roll)
            found = self._hypothesis(kind, problem, there)
            if self._models:
                lost = found.frame._replace(outcome=MISFIT)
                return found if self._fits(found) else found._replace(frame=lost)
            # The integral takes several times as long as a clear one, and few images need it.
            evidence = np.array([clear.log_evidence, found.log_evidence])
            _, shares = mixture([clear.frame, found.frame], evidence)
            if shares[0] > MOSTLY_CLEAR:
                return found
        return self._hypothesis(kind, problem, guide)

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
        return self._mended(found, math.log(LAMP_OFF) - 0.5 * squares[dark])

    def _faulty(self, found: list[Hypothesis]) -> Hypothesis | None:
        """Return a frame with faulty detectors, where that explains what one without does not."""
        explained = [
            each.frame.outcome == FITTED and each.frame.strict_score < DOUBTED for each in found
        ]
        # By one lamp a shade may well look like faults.
        if any(explained if self._models else explained[:1]):
            return None
        kind, problem = found[0].kind, found[0].problem
        count = most_faulty(problem)
        if not count:
            return None
        readings, weights = problem.readings.copy(), np.ones(len(problem.readings))
        problem = problem._replace(readings=readings, weights=weights)
        faulty = self._hypothesis(kind, problem, self.guide, count)
        return self._mended(faulty, log_evidence(problem))

    def _mended(self, found: Hypothesis, log_chance: float) -> Hypothesis | None:
        """Return what is left of a frame where that fits, with its chance in the kind's share."""
        share = found.kind.share * np.exp(log_chance)
        return found._replace(kind=found.kind._replace(share=share)) if self._fits(found) else None

    def _fits(self, found: Hypothesis) -> bool:
        """Say whether a frame that is hardly a clear one fits as if it were."""
        frame = found.frame
        return frame.outcome == FITTED and frame.strict_score <= self._most_mended

    def _from(self, pose: Array, roll: float) -> Guide:
        """Return the guide of a fit from the pose of a follower of this roll, by Laplace."""
        # The frame turns poses of level followers.
        poses = np.tile(turned_about_beam(pose, -roll), (2, 1))
        units = np.ascontiguousarray(self.guide.units[:, :2])  # else Numba compiles once more
        return self.guide._replace(poses=poses, units=units, gaussian=True)

    def _together(self, image: Image, found: list[Hypothesis]) -> Estimate:
        """Return the mixture of hypotheses; `NoPose` where none fits."""
        main, result, clear = found[0], found[0].frame, 1.0
        if len(found) > 1:
            often = OFTEN if self._models else 1.0
            logs = [h.log_evidence + (0.0 if h.kind.clear else math.log(often)) for h in found]
            result, shares = mixture([h.frame for h in found], np.array(logs))
            # A frame with faulty detectors or a dark lamp is lit as the scene says, too.
            clears = [i for i, each in enumerate(found) if each.kind.clear]
            main, clear = found[max(clears, key=lambda i: shares[i])], float(shares[clears].sum())
            clear = clear / (clear + (1 - clear) / often)
        self._check(result)
        pose, rolls, near = result.pose[:5], result.pose[5:], None
        covariance: Array = result.covariance[:5, :5]
        fitted, best, expected = len(main.kind.places), main.frame.best, image.expected
        if main.linear:
            near, count = main.linear.near, 5 + len(self._constants.names)
            variances = result.stretch * near.variances
            near = near._replace(
                at=near.at[:count], slopes=near.slopes[:, :count], variances=variances
            )
        elif expected:
            constants = best[5:][main.kind.places], expected.mean[fitted:]
            at = np.concatenate([best[:5], *constants])
            near = self.near(image.readings, at, image.roll, result.stretch, main.problem.weights)
            if len(expected.mean) > fitted and clear > 0:
                # What the clear fit was given is not known exactly.
                prior = self._pose_precision, main.problem.nuisance_precision
                slopes = near.pose_slopes(*prior, self._constants.gain_std)
                spread = clear * slopes @ expected.covariance[fitted:, fitted:] @ slopes.T
                covariance = covariance + 0.5 * (spread + spread.T)
        # A reading at full scale says only how little the light is at least, which is not linear.
        below = image.readings.max() < self._model.noise.high
        if near and not (clear > CLEAR and below and main.nearly_gaussian):
            near = None
        left_out: list[int] = []
        dark: list[int] = []
        if not main.problem.weights.all():
            out = main.problem.weights.reshape(self._model.scene.lamp_count, -1) == 0
            left_out, dark = (np.flatnonzero(out.all(axis=k)).tolist() for k in (0, 1))
        return Estimate(
            pose,
            covariance,
            result.angle,
            None if np.isnan(result.runner_up_score) else result.runner_up,
            result.runner_up_angle,
            float(ndtr(-result.score)),
            float(ndtr(-result.runner_up_score)),
            tuple(compress(DOF_NAMES, covariance.diagonal() > self._unobservable_variance)),
            near,
            result.stretch,
            clear,
            tuple(divmod(it, self._model.array.side) for it in left_out),
            float(rolls[0]) if len(rolls) else 0.0,
            result.covariance[:, 5] if len(rolls) else None,
            dark[0] if dark else None,
        )

    def near(
        self, readings: Array, at: Array, roll: float, stretch: float, weights: Array
    ) -> LinearisedReadings:
        """Return readings linearised at a place, variances times `stretch`, inf at weights of 0."""
        near = self._linearise(readings, at, roll)
        variances = stretch * near.variances
        variances[weights == 0] = np.inf
        return near._replace(variances=variances)

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
            raise NoPose("no fit: the image leaves the pose without a covariance")
        if abs(pitch := result.best[PITCH]) > STEEP:
            raise NoPose(
                f"no fit: the follower would pitch by {math.degrees(pitch):.1f} deg, "
                f"more than the {math.degrees(STEEP):.1f} deg that a fit can tell"
            )
