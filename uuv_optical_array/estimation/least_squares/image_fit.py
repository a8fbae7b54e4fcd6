"""The fit of an image: the posterior of the pose, over all else that the scene leaves unknown.

The fits of all that an image may show (`hypotheses`) are weighted by their evidence.
"""

import math
from collections.abc import Callable
from itertools import compress
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, PITCH, Array
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.estimate import Estimate
from uuv_optical_array.estimation.information.linearised import LinearisedReadings, Lineariser
from uuv_optical_array.estimation.least_squares.frame import (
    BELIEVED,
    FITTED,
    LINEARISED,
    MISFIT,
    NO_START,
    NOWHERE,
    FrameResult,
    estimate_frame,
    new_rows,
)
from uuv_optical_array.estimation.least_squares.frame_kinds import (
    FrameKind,
    expecting,
    frame_kinds,
    mixture,
)
from uuv_optical_array.estimation.least_squares.hypotheses import Hypotheses, Hypothesis, Image
from uuv_optical_array.estimation.least_squares.linear_model import LinearModel
from uuv_optical_array.estimation.least_squares.no_lamp import NoLamp
from uuv_optical_array.estimation.least_squares.posterior import LOG_2PI
from uuv_optical_array.estimation.least_squares.problem import STEEPEST
from uuv_optical_array.estimation.least_squares.starts import guide_of
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
CLEAR = 0.9  # probability beyond which an image counts as clear
# Pitch, rad, beyond which a fit may have stopped at the steepest on its way to a steeper one.
STEEP = STEEPEST - 0.03
# How many times as probable an image must be with the lamp as without it: so at most one of as many
# images without it has a pose.
SEEN = 100.0


def pose_prior(scene: Scene) -> tuple[Array, Array]:
    """Return mean and standard deviation of the pose by the table, m and rad, ``(5,)`` each."""
    axes = grid_axes(scene.table)
    middle = np.array([(axis[0] + axis[-1]) / 2 for axis in axes])
    half = np.array([(axis[-1] - axis[0]) / 2 for axis in axes])
    return middle, PRIOR_HALF_EXTENTS * np.maximum(half, 0.2)


class ImageFit:
    """Fits the images of a scene; made once, so that no frame takes longer than the next.

    - model: the scene's forward model; the extent of its table is where the lamp is looked for.
    - constants: what the scene leaves unknown.
    - candidates, max_misfit, compiled: as of `Estimator`.
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
        self._pose_prior = pose_prior(scene)
        # What the evidence of all frames leaves out of the pose's prior.
        self._log_prior = -float(np.log(self._pose_prior[1]).sum()) - LOG_2PI
        self._unobservable_variance = (UNOBSERVABLE * self._pose_prior[1]) ** 2
        self._guide = guide_of(model, candidates, float(-ndtri(max_misfit)))
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
            example = self._guide, BELIEVED, NOWHERE, new_rows(kinds[0].problem)
            ready = compilation.prepare(estimate_frame, kinds[0].problem, *example)
            for kind in kinds:  # all are of the same types
                frame = compilation.entry(ready, kind.problem, *example)
        lineariser, linear = Lineariser(model, constants.names, self._write_linear), None
        if model.scene.lamps:
            linear = LinearModel(model, kinds, constants.names, self._write_linear)
        self._kinds, self._linearise, self._frame = kinds, lineariser, frame
        self._hypotheses = Hypotheses(model, frame, linear, self._guide)
        gaussian = self._guide._replace(gaussian=True)
        self._about_match = Hypotheses(model, frame, linear, gaussian)
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
        self._frame(problem, self._guide, LINEARISED, at, linear)

    @np.errstate(all="ignore")  # of light too dim and places too far for a float64
    def __call__(
        self,
        readings: Array,
        roll: float = 0.0,
        uneven: float | None = None,
        match: Array | None = None,
    ) -> Estimate:
        """Fit an image.

        - readings: counts, shape ``(m,)``.
        - roll, uneven: as of `Estimator.estimate`.
        - match: pose of a level follower, ``(5,)``, from which alone a fit starts; its posterior is
          taken as Gaussian. ``None``: from poses of like signature.
        - NoPose: for an image that no pose of the scene explains.
        """
        image, kinds = Image(readings, roll), expecting(self._kinds, uneven)
        hypotheses = self._hypotheses if match is None else self._about_match
        found = hypotheses.of(image, kinds, match)
        if self._no_lamp:
            self._check_seen(self._no_lamp, readings, kinds, found)
        return self._together(image, found, uneven is not None)

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
        pose, rolls, near = result.pose[:5], result.pose[5:], main.near
        covariance: Array = result.covariance[:5, :5]
        # A reading at full scale says only how little the light is at least, which is not linear.
        linear = clear > CLEAR and image.readings.max() < self._model.noise.high
        stds = np.array(self._constants.stds[len(main.kind.names) :])
        if near:
            count = 5 + len(self._constants.names)
            near = near._replace(at=near.at[:count], slopes=near.slopes[:, :count])
        elif tracked and (linear or (len(stds) and clear > 0)):
            at = np.concatenate([main.frame.best, np.zeros(len(stds))])
            near = self.near(image.readings, at, image.roll, main.frame.weights)
            if len(stds) and clear > 0:
                # A clear frame takes as exact what only many images determine; it is not.
                fitted = np.concatenate([main.problem.pose_std, main.problem.nuisance_std])
                slopes = stds * near.pose_slopes(fitted, self._constants.gain_std)
                covariance = covariance + clear * slopes @ slopes.T
        if not linear:
            near = None
        dark, left_out = self._left_out(result.weights)
        unobservable = covariance.diagonal() > self._unobservable_variance
        return Estimate(
            pose=pose,
            covariance=covariance,
            angle_rad=float(result.angles[0]),
            runner_up_pose=None if math.isnan(result.runner_up_score) else result.runner_up,
            runner_up_angle_rad=float(result.angles[1]),
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
        fitted = [each.log_evidence for each in found if each.fitted]
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
            chance = float(ndtr(-result.score))
            said = f"of {chance:.1e}" if chance else "below 1e-300"
            raise NoPose(
                f"no fit: an image of this scene leaves such residuals with a probability {said}, "
                f"less than max_misfit {self._max_misfit:g}"
            )
        if result.outcome != FITTED:
            raise NoPose("no fit: the image does not determine a covariance of the pose")
        if abs(pitch := result.best[PITCH]) > STEEP:
            raise NoPose(
                f"no fit: the follower would pitch by {math.degrees(pitch):.1f} deg, "
                f"more than the {math.degrees(STEEP):.1f} deg that a fit can tell"
            )
