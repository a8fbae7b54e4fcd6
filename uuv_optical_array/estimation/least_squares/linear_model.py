"""An image of several lamps as a linear model about a fit.

By several lamps the posterior is nearly Gaussian. So one linearisation gives its covariance, of
pose and roll together.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg.lapack import dposv

from uuv_optical_array.core.geometry import rolled
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


class LinearModel:
    """Makes the images of one scene linear about their fits.

    - constants: their names.
    - write: as of `Lineariser`.
    """

    def __init__(
        self,
        model: ForwardModel,
        kinds: Sequence[FrameKind],
        constants: Sequence[str],
        write: Callable[..., None],
    ) -> None:
        names = list(dict.fromkeys([*constants, *(name for kind in kinds for name in kind.names)]))
        self._linearise = Lineariser(model, names, write)
        self._size, self._roll = 5 + len(names), 5 + names.index(ROLL) if ROLL in names else None
        # Of each kind, by its unknowns, where pose and unknowns are among all, and pose and roll
        # among its own.
        self._columns = {
            kind.names: np.array([*range(5), *(5 + names.index(name) for name in kind.names)])
            for kind in kinds
        }
        self._shown = {
            names: np.flatnonzero((columns < 5) | (columns == self._roll))
            for names, columns in self._columns.items()
        }

    def about(
        self, kind: FrameKind, problem: Problem, frame: FrameResult
    ) -> tuple[FrameResult, LinearisedReadings]:
        """Return a fit with pose and roll, ``(6,)``, their covariance, and its readings there."""
        columns, at = self._columns[kind.names], np.zeros(self._size)
        at[columns] = frame.best
        if self._roll is not None:
            at[:5], roll = rolled(at[:5], problem.roll, float(at[self._roll]))
            at[self._roll] = roll - problem.roll
        near = self._linearise(problem.readings, at, problem.roll).believed(frame.weights)
        weighted = near.slopes.T / (near.variances + problem.noise.square * np.square(near.light))
        information = weighted @ near.slopes
        stds = np.concatenate([problem.pose_std, problem.nuisance_std])
        known = information[columns[:, None], columns] + np.diag(stds**-2.0)
        _, covariance, failed = dposv(known, np.eye(len(columns)))
        outcome = frame.outcome
        if failed or not np.isfinite(covariance).all():
            covariance = np.zeros_like(known)
            outcome = NO_COVARIANCE if outcome == FITTED else outcome
        shown = self._shown[kind.names]
        spread = covariance[shown[:, None], shown]
        if frame.wider:
            off = (frame.runner_up - frame.pose) / DISTINCT
            spread[:5, :5] += np.outer(off, off)
        frame = frame._replace(outcome=outcome, pose=at[columns[shown]], covariance=spread)
        return frame, near
