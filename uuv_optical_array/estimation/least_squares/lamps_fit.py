"""An image of several lamps fitted: what else than the scene may be behind it, and its posterior.

By several lamps the posterior is nearly Gaussian. So one linearisation at the best fit of a clear
frame says how much more likely the image is by each kind of frame that leaves more unknown: the
Bayes factor of a linear model. Only kinds that may be behind the image are fitted. All covariances
are those of linear models at the best fits, of the pose and the follower's roll together.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv
from scipy.special import chdtrc

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array, rolled
from uuv_optical_array.estimation.information.linearised import LinearisedReadings, Lineariser
from uuv_optical_array.estimation.least_squares.frame import (
    DISTINCT,
    FITTED,
    MISFIT,
    NO_COVARIANCE,
    NO_START,
    FrameResult,
    Guide,
)
from uuv_optical_array.estimation.least_squares.frame_kinds import (
    FrameKind,
    expecting,
    frame_kinds,
    weighed,
)
from uuv_optical_array.estimation.least_squares.image_fit import (
    Fitted,
    ImageFit,
    nearly_gaussian,
)
from uuv_optical_array.estimation.least_squares.problem import UNUSUAL, Problem
from uuv_optical_array.estimation.signature.features import scene_parameters
from uuv_optical_array.estimation.unknowns.constants import Expected
from uuv_optical_array.forward.prior import (
    BEAM_SIGMA,
    OWN_POWER,
    ROLL,
    SHADES,
    FrameLight,
    of_lamp,
)
from uuv_optical_array.forward.scene import Scene

# Standard deviations of what is rarely wrong: each mode of a shade, in the logarithm of the light;
# the roll, rad, as without an IMU; the beam's width, deg; power, in its logarithm, and axis of one
# lamp. Our choice, for the unforeseen, and the share of frames of each kind.
SHADED, ROLLED, WIDER_DEG = 0.1, 0.3, 2.0
OTHER_LAMP = {OWN_POWER: 0.3, "pitch_deg": 2.0, "yaw_deg": 2.0}
RARE = 1e-3
# Logarithm of the odds against a clear frame from which a kind is fitted.
CONSIDERED = math.log(2e-2)
# In the moments of the pose all but clear frames are so many times as frequent, as a shade may look
# like another pose, and the shares are a choice.
OFTEN = 3.0
# Probability that a lamp is off or hidden, and chance of noise from which one that shows nothing
# may be.
LAMP_OFF, LIKELY_DARK = 1e-3, 1e-3
FIRST_STARTS = 12  # poses to start from before other explanations than a lost fit are tried


class Hypothesis(NamedTuple):
    """A kind of frame that may be behind an image, and what came of it.

    - place: of the kind among all; 0 for a clear frame, also without a dark lamp or faulty
      detectors.
    - kind, problem, frame: the kind, its posterior, and the fit.
    - near: readings linearised at the fit, by pose and all unknowns of all kinds.
    - weights: of the readings, by noise and gain errors, shape ``(n,)``.
    - covariance: of pose and unknowns of the kind, not stretched.
    """

    place: int
    kind: FrameKind
    problem: Problem
    frame: FrameResult
    near: LinearisedReadings
    weights: Array
    covariance: Array


def rare_kinds(scene: Scene) -> list[tuple[FrameLight, dict[str, float]]]:
    """Return kinds of frame of several lamps that no prior names, as `frame_kinds` takes them."""
    lamps = [
        {of_lamp(i, setting): std for setting, std in OTHER_LAMP.items()}
        for i in range(len(scene.lamps))
    ]
    stds = scene.nuisance_std()
    wider = [{ROLL: ROLLED}, {BEAM_SIGMA: WIDER_DEG}, *lamps]
    kinds = [
        {key: std for key, std in each.items() if 0 < stds.get(key, 0.0) < std} for each in wider
    ]
    shade = FrameLight(RARE), dict.fromkeys(SHADES, SHADED)
    return [shade, *((FrameLight(RARE), kind) for kind in kinds if kind)]


class LampsFit(ImageFit):
    """Fits the images of a scene of several lamps."""

    most_mended = UNUSUAL  # what is left has readings enough to tell

    def run(self, compiled: bool) -> None:
        """Run as of `ImageFit`."""
        super().run(compiled)
        model, constants = self._model, self._constants.names
        self._kinds = frame_kinds(model, self._prior, rare_kinds(model.scene))
        more = (name for kind in self._kinds for name in kind.names if name not in constants)
        self._names = (*constants, *dict.fromkeys(more))
        self._linearise_all = Lineariser(model, self._names, compiled)
        # Of each kind, where its unknowns are among all, from the pose's on.
        self._columns = [
            np.array([*range(5), *(5 + self._names.index(name) for name in kind.names)])
            for kind in self._kinds
        ]
        # Of each but the first, which of them are wider than in a clear frame, and by how much.
        count = max(np.count_nonzero(kind.added) for kind in self._kinds)
        self._wider = np.zeros((len(self._kinds) - 1, count), dtype=np.intp)
        self._wider_stds = np.zeros(self._wider.shape)
        for k, (kind, columns) in enumerate(zip(self._kinds[1:], self._columns[1:], strict=True)):
            stds = np.sqrt(kind.added.diagonal())
            self._wider[k, : np.count_nonzero(stds)] = columns[5:][stds > 0]
            self._wider_stds[k, : np.count_nonzero(stds)] = stds[stds > 0]

    @np.errstate(all="ignore")  # of light too dim and places too far for a float64
    def __call__(
        self,
        readings: Array,
        parameters: Array | None = None,
        roll: float = 0.0,
        expected: Expected | None = None,
        guide: Guide | None = None,
    ) -> Fitted:
        """Fit an image, as `ImageFit` does."""
        kinds = expecting(self._kinds, expected)
        problem = kinds[0].knowing(expected)._replace(readings=readings, roll=roll)
        if parameters is None:
            parameters = self._parameters(readings)
        found: list[Hypothesis] = []
        few = self.guide._replace(most=FIRST_STARTS)
        for trial in [guide] if guide else [few, self.guide]:
            found = self._hypotheses(kinds, problem, expected, trial, parameters)
            if any(each.frame.outcome == FITTED for each in found):
                break
        return self._together(found)

    def _hypotheses(
        self,
        kinds: list[FrameKind],
        problem: Problem,
        expected: Expected | None,
        guide: Guide,
        parameters: Array,
    ) -> list[Hypothesis]:
        """Return what may be behind an image, first that it is clear."""
        readings, roll = problem.readings, problem.roll
        dark = self._without_dark_lamp(kinds[0], problem, guide)
        # Where a lamp is dark, no start with all of them may lead anywhere.
        start = self._from(dark[-1].best[:5], roll) if dark else guide
        clear = self._linear(0, kinds[0], problem, self._frame(problem, start, parameters, 0))
        found = [clear]
        if dark:
            found.append(self._linear(0, *dark))
        if clear.frame.outcome == NO_START or (dark and clear.frame.outcome == MISFIT):
            return found
        there, odds = self._from(clear.frame.best[:5], roll), self._log_odds(clear, kinds)
        enough = CONSIDERED + max(0.5 * odds.max(), 0.0)
        for k, (kind, odd) in enumerate(zip(kinds[1:], odds, strict=True), start=1):
            if odd > enough or not kind.rare:
                other = kind.knowing(expected)._replace(readings=readings, roll=roll)
                frame = self._frame(other, there, parameters, 0)
                if frame.outcome == FITTED and frame.strict_score > self.most_mended:
                    frame = frame._replace(outcome=MISFIT)
                found.append(self._linear(k, kind, other, frame))
        if guide.most == FIRST_STARTS:
            fits = [each.frame for each in found if each.frame.outcome == FITTED]
            best = min(fits or [clear.frame], key=lambda frame: frame.strict_score)
            if faults := self._faults(kinds[0], problem, best):
                found.append(self._linear(0, *faults))
        return found

    def _without_dark_lamp(
        self, kind: FrameKind, problem: Problem, guide: Guide
    ) -> tuple[FrameKind, Problem, FrameResult] | None:
        """Return a clear frame without a lamp that shows nothing, as if it were off or hidden."""
        noise, side = self._model.noise, self._model.array.side
        images = problem.readings.reshape(-1, side**2)
        squares = (np.square(images - noise.black) / noise.variance).sum(axis=1)
        dark = int(squares.argmin())
        likely = int((chdtrc(side**2, squares) >= LIKELY_DARK).sum())
        if likely > 1:  # they may be off, or the follower may be where only the others shine
            raise NoPose(f"no fit: {likely} of {len(squares)} lamps show nothing")
        if not likely:
            return None
        weights = np.ones_like(images)
        weights[dark] = 0.0
        problem = problem._replace(weights=weights.ravel())
        frame = self._frame(problem, guide, self._parameters(weights * images), 0)
        return self._mended(kind, problem, frame, math.log(LAMP_OFF) - 0.5 * squares[dark])

    def _parameters(self, readings: Array) -> Array:
        """Return the key parameters of an image, shape ``(5, 1)``."""
        image = readings.reshape(self._model.image_shape)
        return scene_parameters(image, self._model.scene)[:, None]

    def _linear(
        self, place: int, kind: FrameKind, problem: Problem, frame: FrameResult
    ) -> Hypothesis:
        """Return a fit with the linear model about it."""
        columns, at = self._columns[place], np.zeros(5 + len(self._names))
        at[columns] = frame.best
        if ROLL in self._names:
            r = 5 + self._names.index(ROLL)
            at[:5], roll = rolled(at[:5], problem.roll, float(at[r]))
            at[r] = roll - problem.roll
        near = self._linearise_all(problem.readings, at, problem.roll)
        near.variances[problem.weights == 0] = np.inf
        weights = 1 / (near.variances + problem.noise.square * np.square(near.light))
        slopes = near.slopes[:, columns]
        information = (slopes.T * weights) @ slopes
        information[:5, :5] += self._pose_precision
        information[5:, 5:] += problem.nuisance_precision
        _, covariance, failed = dposv(information, np.eye(len(columns)))
        if failed or not np.isfinite(covariance).all():
            covariance = np.zeros_like(information)
            if frame.outcome == FITTED:
                frame = frame._replace(outcome=NO_COVARIANCE)
        return Hypothesis(place, kind, problem, frame, near, weights, covariance)

    def _log_odds(self, clear: Hypothesis, kinds: list[FrameKind]) -> Array:
        """Return the logarithm of the odds of the other kinds against a clear one."""
        near, columns, problem = clear.near, self._columns[0], clear.problem
        fitted = near.slopes[:, columns]
        weighted = near.slopes.T * clear.weights
        shared = weighted @ fitted
        information = weighted @ near.slopes - shared @ clear.covariance @ shared.T
        pull = weighted[columns] @ near.residuals
        pull[5:] -= problem.nuisance_precision @ (near.at[columns[5:]] - problem.nuisance_mean)
        score = weighted @ near.residuals - shared @ (clear.covariance @ pull)
        at, stds = self._wider, self._wider_stds
        spread = stds[:, :, None] * information[at[:, :, None], at[:, None, :]] * stds[:, None, :]
        # Where the clear fit is lost the numbers are large, and no matrix may be regular.
        values, vectors = np.linalg.eigh(np.where(np.isfinite(spread), spread, 0.0))
        moved = np.einsum("ki,kij->kj", stds * score[at], vectors)
        more = 1 + np.maximum(values, 0.0)
        gain = (np.square(moved) / more - np.log(more)).sum(axis=1)
        shares = np.array([kind.share for kind in kinds])
        return np.log(shares[1:] / shares[0]) + 0.5 * gain

    def _together(self, found: list[Hypothesis]) -> Fitted:
        """Return the mixture of hypotheses; `NoPose` where none fits."""
        frames = []
        for each in found:
            frame, shown = each.frame, list(range(5))
            if ROLL in each.kind.names:
                shown.append(5 + each.kind.names.index(ROLL))
            covariance = frame.stretch * each.covariance[np.ix_(shown, shown)]
            if frame.wider:
                off = (frame.runner_up - frame.pose) / DISTINCT
                covariance[:5, :5] += np.outer(off, off)
            pose = each.near.at[self._columns[each.place][shown]]
            frames.append(frame._replace(pose=pose, covariance=covariance))
        kinds, problems = [each.kind for each in found], [each.problem for each in found]
        for i, each in enumerate(found):
            if each.place > 0:
                kinds[i] = each.kind._replace(share=OFTEN * each.kind.share)
        result, shares = weighed(kinds, problems, frames)
        self._check(result)
        clears = [i for i, each in enumerate(found) if each.place == 0]
        main, clear = max(clears, key=lambda i: shares[i]), float(shares[clears].sum())
        frame, near, weights = found[main].frame, found[main].near, problems[main].weights
        constants = 5 + len(self._constants.names)
        near = near._replace(
            at=near.at[:constants],
            slopes=near.slopes[:, :constants],
            variances=frame.stretch * near.variances,
        )
        linear = nearly_gaussian(frame) and problems[0].readings.max() < self._model.noise.high
        (pose, rolls), covariance = np.split(result.pose, [5]), result.covariance
        return Fitted(
            result._replace(pose=pose, covariance=covariance[:5, :5]),
            clear / (clear + (1 - clear) / OFTEN),
            near if linear else None,
            np.flatnonzero(weights == 0),
            float(rolls.sum()),
            covariance[:, 5] if len(rolls) else None,
        )
