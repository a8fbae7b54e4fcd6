"""An image fitted: its posterior of the pose, over what else the scene leaves unknown."""

from collections.abc import Callable, Sequence
from itertools import compress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import ndtr, ndtri

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, Array, X, turned_about_beam, wrapped
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.information.linearised import LinearisedReadings, Lineariser
from uuv_optical_array.estimation.least_squares.faults import log_evidence, most_faulty
from uuv_optical_array.estimation.least_squares.frame import (
    FITTED,
    MISFIT,
    MOST_STARTS,
    NO_START,
    FrameResult,
    Guide,
    estimate_frame,
)
from uuv_optical_array.estimation.least_squares.frame_kinds import (
    FrameKind,
    expecting,
    frame_kinds,
    is_doubtful,
    weighed,
)
from uuv_optical_array.estimation.least_squares.problem import PosePrior, Problem
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
BENT, FAR = 0.5, 0.1
# Poses of the working volume from which fits may start: more make no fit more exact.
STARTS = 1024
# Beside them poses nearer than that, and the share of the range that they go down to.
NEAR_STARTS, NEAREST = 4096, 0.2
BY_SIGNATURE = 1536  # of all these are looked up by their signature, too, and the others by image
# Score from which detectors may be faulty: of one valid image of two hundred.
DOUBTED = 2.576
MENDED = 2.054  # score up to which the others have to fit: that of one image of fifty
# Probability, by a fit that is linear about its minimum, from which no other kind is integrated.
MOSTLY_CLEAR = 0.8


class Fitted(NamedTuple):
    """What the fit makes of an image.

    - result: pose, covariance, angles and scores, of all kinds of light that may be behind the
      image.
    - clear: probability that the image is lit as the scene says.
    - readings: the likelihood of the image near its best fit as a clear one, where the fit was told
      what is expected and the posterior was integrated and is nearly Gaussian; ``None`` otherwise.
    - left_out: places of the readings that are probably those of faulty detectors.
    - roll, turn: by several lamps, how much more the follower rolls than was given, rad; its
      covariance with the pose, and its variance, shape ``(6,)``.
    """

    result: FrameResult
    clear: float
    readings: LinearisedReadings | None
    left_out: NDArray[np.intp]
    roll: float = 0.0
    turn: Array | None = None


def nearly_gaussian(frame: FrameResult) -> bool:
    """Say whether the posterior of a frame is nearly Gaussian, and its image as good as linear."""
    off, covariance = wrapped(frame.best[:5] - frame.pose), frame.covariance / frame.stretch
    known = covariance[X, X] < (FAR * frame.pose[X]) ** 2
    return bool(known and not frame.wider and off @ np.linalg.solve(covariance, off) < BENT**2)


class ImageFit:
    """Fits the images of a scene; made once, so that no frame takes longer than the next.

    - model: the scene's forward model; the extent of its table is where the lamp is looked for.
    - constants: what the scene leaves unknown.
    - candidates, max_misfit, compiled: as of `Estimator`.
    - compiled: whether it runs as Numba compiles it.
    - guide: where fits start from and how far they go, unless they are told otherwise.
    - most_mended: score up to which what is left of an image has to fit.
    """

    most_mended = MENDED

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
        axes = grid_axes(scene.table)
        middle = np.array([(axis[0] + axis[-1]) / 2 for axis in axes])
        half = np.array([(axis[-1] - axis[0]) / 2 for axis in axes])
        prior_std = PRIOR_HALF_EXTENTS * np.maximum(half, 0.2)
        self._unobservable_variance = (UNOBSERVABLE * prior_std) ** 2
        self._prior = PosePrior(middle, prior_std, scene.nuisance_std())
        self._pose_precision = np.diag(1 / np.square(prior_std))
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
            MOST_STARTS,
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
        kinds = frame_kinds(model, self._prior)
        lineariser = Lineariser(model, constants.names, compiled)
        frame: Callable[..., FrameResult] = estimate_frame
        if compiled:
            features.prepare(model.array.side)
            joint_coordinates.prepare(constants)
            example = kinds[0].problem, self.guide, np.ones((5, 1)), 0
            frame = compilation.prepare(estimate_frame, *example)
        self._kinds, self._linearise, self._frame = kinds, lineariser, frame
        self.compiled = compiled

    def _starts(self, axes: list[Array]) -> tuple[Array, Array]:
        """Return poses that fits may start from, and their images."""
        rng = np.random.default_rng(0)  # the same in every run: an image has one answer
        # Points of the grid: from its edges fits find minima that they miss from within.
        poses = np.stack([rng.choice(axis, STARTS) for axis in axes], axis=-1)
        # Nearer than that the array saturates, and from afar no fit leads there.
        near = np.stack([rng.choice(axis, NEAR_STARTS) for axis in axes], axis=-1)
        near[:, :3] *= rng.uniform(NEAREST, 1, (len(near), 1))
        poses = np.concatenate([poses, near])
        images = self._model.converted(self._model.light(poses))
        lit = images.max(axis=(1, 2)) - self._model.noise.black >= MIN_PEAK_COUNTS
        if not lit.any():
            raise no_light(self._model.scene)
        return poses[lit], images[lit]

    @np.errstate(all="ignore")  # of light too dim and places too far for a float64
    def __call__(
        self,
        readings: Array,
        parameters: Array | None = None,
        roll: float = 0.0,
        expected: Expected | None = None,
        guide: Guide | None = None,
    ) -> Fitted:
        """Fit an image.

        - readings: counts, shape ``(m,)``.
        - parameters: key parameters of the image, shape ``(5, 1)``; ``None``: worked out from the
          image.
        - roll: of the follower, rad.
        - expected: as of `Estimator.estimate`.
        - guide: ``None``: that of all images.
        - NoPose: for an image that no pose of the scene explains.
        """
        match, guide = guide is not None, guide or self.guide
        if parameters is None:
            parameters = np.full((5, 1), np.nan)  # the frame's: it writes into it
        kinds = expecting(self._kinds, expected)
        problems: list[Problem] = []
        frames: list[FrameResult] = []
        for kind in kinds:
            if kind.rare and not is_doubtful(frames[0], kind.share):
                break
            problems.append(kind.knowing(expected)._replace(readings=readings, roll=roll))
            if kind.rare and not guide.gaussian:
                # The integral takes several times as long as a clear one, and few images need it.
                there = self._from(frames[0].best[:5], roll)
                frames.append(self._frame(problems[-1], there, parameters, 0))
                _, shares = weighed(kinds, problems, frames)
                if shares[0] > MOSTLY_CLEAR:
                    break
                frames.pop()
            frames.append(self._frame(problems[-1], guide, parameters, 0))
        kinds, problems = kinds[: len(frames)], problems[: len(frames)]
        faults = None if match else self._faults(kinds[0], problems[0], frames[0])
        if faults:
            kinds, problems, frames = (
                [*kinds, faults[0]],
                [*problems, faults[1]],
                [*frames, faults[2]],
            )
        result, shares = frames[0], np.ones(1)
        if len(frames) > 1:
            result, shares = weighed(kinds, problems, frames)
        # A frame with faulty detectors is lit as the scene says, too.
        main = len(frames) - 1 if faults and shares[-1] > shares[0] else 0
        clear = float(shares[0] + (shares[-1] if faults else 0.0))
        self._check(result)
        fitted, best = len(kinds[0].places), frames[main].best
        left_out = np.flatnonzero(problems[main].weights == 0)
        if expected is None or (match and len(expected.mean) == fitted):
            return Fitted(result, clear, None, left_out)
        at = np.concatenate([best[:5], kinds[0].constants(best[5:], expected)])
        near = self.near(readings, at, roll, result.stretch, left_out)
        if len(expected.mean) > fitted and clear > 0:
            # What the clear fit was given is not known exactly.
            precision = block_diag(self._pose_precision, problems[main].nuisance_precision)
            slopes = near.pose_slopes(precision, self._constants.gain_std)
            spread = clear * slopes @ expected.covariance[fitted:, fitted:] @ slopes.T
            covariance = result.covariance + 0.5 * (spread + spread.T)
            result = result._replace(covariance=covariance)
        # A reading at full scale says only how little the light is at least, which is not linear.
        linear = nearly_gaussian(frames[main]) and readings.max() < self._model.noise.high
        return Fitted(result, clear, near if linear else None, left_out)

    def _from(self, pose: Array, roll: float) -> Guide:
        """Return the guide of a fit from the pose of a follower of this roll, by Laplace."""
        # The frame turns poses of level followers.
        poses = np.tile(turned_about_beam(pose, -roll), (2, 1))
        units = np.ascontiguousarray(self.guide.units[:, :2])  # else Numba compiles once more
        return self.guide._replace(poses=poses, units=units, gaussian=True)

    def _faults(
        self, kind: FrameKind, problem: Problem, frame: FrameResult
    ) -> tuple[FrameKind, Problem, FrameResult] | None:
        """Return a frame with faulty detectors, where that explains what one without does not."""
        if frame.outcome == FITTED and frame.strict_score < DOUBTED:
            return None
        count = most_faulty(problem)
        if not count:
            return None
        readings, weights = problem.readings.copy(), np.ones(len(problem.readings))
        problem = problem._replace(readings=readings, weights=weights)
        frame = self._frame(problem, self.guide, np.full((5, 1), np.nan), count)
        return self._mended(kind, problem, frame, log_evidence(problem))

    def _mended(
        self, kind: FrameKind, problem: Problem, frame: FrameResult, log_chance: float
    ) -> tuple[FrameKind, Problem, FrameResult] | None:
        """Return what is left of a frame where that fits, with its chance in the kind's share."""
        if frame.outcome != FITTED or frame.strict_score > self.most_mended:
            return None
        return kind._replace(share=kind.share * np.exp(log_chance)), problem, frame

    def near(
        self,
        readings: Array,
        at: Array,
        roll: float,
        stretch: float,
        left_out: Sequence[int] | NDArray[np.intp] = (),
    ) -> LinearisedReadings:
        """Return the likelihood of an image near a place, of pose and constants.

        - readings, roll: as they were fitted.
        - at: pose and offsets of the constants, shape ``(5 + q,)``.
        - stretch: of the fit, as its result has it.
        - left_out: places of readings that say nothing.
        """
        near = self._linearise(readings, at, roll)
        variances = stretch * near.variances
        variances[np.array(left_out, dtype=int)] = np.inf
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

    def unobservable(self, covariance: Array) -> tuple[str, ...]:
        """Name the degrees of freedom of which a covariance leaves next to all of the prior."""
        known = covariance.diagonal() <= self._unobservable_variance
        return () if known.all() else tuple(compress(DOF_NAMES, ~known))
