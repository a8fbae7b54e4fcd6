"""An image of several lamps as a linear model about a fit.

By several lamps the posterior is nearly Gaussian. So one linearisation gives its covariance, of
pose and roll together; and that of a clear frame says how much more likely the image is by each
kind of frame that leaves more unknown: the Bayes factor of a linear model.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from uuv_optical_array.core.geometry import Array, rolled
from uuv_optical_array.estimation.information.linearised import LinearisedReadings, Lineariser
from uuv_optical_array.estimation.least_squares.frame import (
    DISTINCT,
    FITTED,
    NO_COVARIANCE,
    FrameResult,
)
from uuv_optical_array.estimation.least_squares.frame_kinds import FrameKind
from uuv_optical_array.estimation.least_squares.problem import Problem
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import ROLL

# Logarithm of the odds against a clear frame from which a kind is fitted.
CONSIDERED = math.log(2e-2)


class LinearModel(NamedTuple):
    """The linear model about a fit.

    - near: readings linearised at the fit, by pose and all unknowns of all kinds.
    - score, information: of the log-likelihood there, without any prior.
    - covariance: of pose and unknowns of the kind, not stretched.
    """

    near: LinearisedReadings
    score: Array
    information: Array
    covariance: Array


class LinearModels:
    """Makes the linear models of images of one scene.

    - constants: their names.
    - pose_precision: inverse covariance of the pose's prior.
    """

    def __init__(
        self,
        model: ForwardModel,
        kinds: Sequence[FrameKind],
        constants: Sequence[str],
        pose_precision: Array,
        compiled: bool,
    ) -> None:
        names = list(dict.fromkeys([*constants, *(name for kind in kinds for name in kind.names)]))
        self._linearise = Lineariser(model, names, compiled)
        self._size, self._roll = 5 + len(names), 5 + names.index(ROLL) if ROLL in names else None
        self._pose_precision = pose_precision
        # Of each kind, by its unknowns, where pose and unknowns are among all, and pose and roll
        # among its own.
        self._columns = {
            kind.names: np.array([*range(5), *(5 + names.index(name) for name in kind.names)])
            for kind in kinds
        }
        self._shown = {
            kind: np.flatnonzero((columns < 5) | (columns == self._roll))
            for kind, columns in self._columns.items()
        }
        # Of each but the first, which of them are wider than in a clear frame, and by how much.
        count = max(np.count_nonzero(kind.added) for kind in kinds)
        self._wider = np.zeros((len(kinds) - 1, count), dtype=np.intp)
        self._wider_stds = np.zeros(self._wider.shape)
        for k, kind in enumerate(kinds[1:]):
            stds = np.sqrt(kind.added.diagonal())
            self._wider[k, : np.count_nonzero(stds)] = self._columns[kind.names][5:][stds > 0]
            self._wider_stds[k, : np.count_nonzero(stds)] = stds[stds > 0]

    def about(
        self, kind: FrameKind, problem: Problem, frame: FrameResult
    ) -> tuple[FrameResult, LinearModel]:
        """Return a fit with pose and roll, shape ``(6,)``, their covariance, and its model."""
        columns, at = self._columns[kind.names], np.zeros(self._size)
        at[columns] = frame.best
        if self._roll is not None:
            at[:5], roll = rolled(at[:5], problem.roll, float(at[self._roll]))
            at[self._roll] = roll - problem.roll
        near = self._linearise(problem.readings, at, problem.roll)
        near.variances[problem.weights == 0] = np.inf
        weighted = near.slopes.T / (near.variances + problem.noise.square * np.square(near.light))
        score, information = weighted @ near.residuals, weighted @ near.slopes
        known = information[columns[:, None], columns]
        known[:5, :5] += self._pose_precision
        known[5:, 5:] += problem.nuisance_precision
        _, covariance, failed = dposv(known, np.eye(len(columns)))
        outcome = frame.outcome
        if failed or not np.isfinite(covariance).all():
            covariance = np.zeros_like(known)
            outcome = NO_COVARIANCE if outcome == FITTED else outcome
        shown = self._shown[kind.names]
        spread = frame.stretch * covariance[shown[:, None], shown]
        if frame.wider:
            off = (frame.runner_up - frame.pose) / DISTINCT
            spread[:5, :5] += np.outer(off, off)
        frame = frame._replace(outcome=outcome, pose=at[columns[shown]], covariance=spread)
        return frame, LinearModel(near, score, information, covariance)

    def likely(
        self, clear: LinearModel, problem: Problem, kinds: Sequence[FrameKind]
    ) -> list[bool]:
        """Say which of the other kinds may be behind an image, by the model of a clear frame."""
        odds = self.log_odds(clear, problem, kinds)
        enough = CONSIDERED + max(0.5 * odds.max(), 0.0)
        return [odd > enough or not kind.rare for odd, kind in zip(odds, kinds[1:], strict=True)]

    def log_odds(self, clear: LinearModel, problem: Problem, kinds: Sequence[FrameKind]) -> Array:
        """Return the logarithm of the odds of the other kinds against a clear one."""
        columns = self._columns[kinds[0].names]
        shared, pull = clear.information[:, columns], clear.score[columns]
        information = clear.information - shared @ clear.covariance @ shared.T
        off = clear.near.at[columns[5:]] - problem.nuisance_mean
        pull[5:] -= problem.nuisance_precision @ off
        score = clear.score - shared @ (clear.covariance @ pull)
        at, stds = self._wider, self._wider_stds
        spread = stds[:, :, None] * information[at[:, :, None], at[:, None, :]] * stds[:, None, :]
        # Where the clear fit is lost the numbers are large, and no matrix may be regular.
        values, vectors = np.linalg.eigh(np.where(np.isfinite(spread), spread, 0.0))
        moved = np.einsum("ki,kij->kj", stds * score[at], vectors)
        more = 1 + np.maximum(values, 0.0)
        gain = (np.square(moved) / more - np.log(more)).sum(axis=1)
        shares = np.array([kind.share for kind in kinds])
        return np.log(shares[1:] / shares[0]) + 0.5 * gain
