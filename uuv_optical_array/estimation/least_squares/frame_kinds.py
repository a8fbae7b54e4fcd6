"""Kinds of frame that an image may be, clear or shaded, weighed by their evidence."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.frame import FITTED, FrameResult
from uuv_optical_array.estimation.least_squares.problem import PosePrior, Problem, problem_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import POWER, SHADE_DOUBT


class FrameKind(NamedTuple):
    """A kind of frame, with r nuisances, some of which are the scene's q unknown constants.

    Parameters
    ----------
    problem
        Its posterior, without readings.
    log_share
        Logarithm of the share of such frames.
    places
        Those of the scene's constants among the nuisances, shape ``(q,)``.
    added
        What this kind adds to the covariance of the constants, shape ``(r, r)``.
    doubt
        Factor of the pose's covariance, >= 1, for what the kind does not describe.
    """

    problem: Problem
    log_share: float
    places: NDArray[np.intp]
    added: Array
    doubt: float

    def knowing(self, constants: tuple[Array, Array] | None) -> Problem:
        """Return the problem where the constants are known by a mean and a covariance."""
        if constants is None or not len(self.places):
            return self.problem
        mean, covariance = constants
        whole, at = self.added.copy(), self.problem.nuisance_mean.copy()
        whole[self.places[:, None], self.places] += covariance
        at[self.places] += mean
        precision: Array = np.asarray(np.linalg.inv(whole), dtype=float)
        return self.problem._replace(nuisance_mean=at, nuisance_precision=precision)


def frame_kinds(model: ForwardModel, prior: PosePrior, compiled: bool) -> list[FrameKind]:
    """Return the kinds of frame that the prior of a model's scene names, clear frames first.

    Parameters
    ----------
    model
        The scene's forward model.
    prior
        Of the pose, and of the scene's unknown constants.
    compiled
        Whether they are for compiled code.
    """
    known, constants = model.scene.prior, list(prior.nuisance_std)
    kinds = []
    for share, depth in known.shades():
        stds = known.shaded_std(depth)
        names = list(stds)
        problem = problem_of(model, replace(prior, nuisance_std=stds), compiled)
        mean = problem.nuisance_mean.copy()
        if depth:
            mean[names.index(POWER)] = -depth
        noise = problem.noise._replace(square=known.shaded_gain_std(depth) ** 2)
        places = np.array([names.index(name) for name in constants], dtype=np.intp)
        added = np.square(list(stds.values()))
        added[places] -= np.square(list(prior.nuisance_std.values()))
        problem = problem._replace(nuisance_mean=mean, noise=noise)
        doubt = SHADE_DOUBT if depth else 1.0
        kinds.append(FrameKind(problem, math.log(share), places, np.diag(added), doubt))
    return kinds


def mixture(frames: list[FrameResult], evidence: Array) -> tuple[FrameResult, float]:
    """Return what different kinds of frame make of one image together.

    Parameters
    ----------
    frames
        The image as each kind of frame, such as clear and shaded.
    evidence
        Logarithm of the probability of each, without constants in common; asked where a frame has
        a pose.

    Returns
    -------
    FrameResult
        Of the most probable one, with the mean and the covariance of all that have a pose.
    float
        Probability of the first kind, in [0, 1].
    """
    fitted = [i for i, frame in enumerate(frames) if frame.outcome == FITTED]
    if not fitted:
        return frames[0], 0.0
    best = max(fitted, key=lambda i: evidence[i])
    weights = np.exp(evidence[fitted] - evidence[best])
    weights /= weights.sum()
    poses = np.array([frames[i].pose for i in fitted])
    pose = weights @ poses
    off = poses - pose
    covariance = (weights[:, None] * off).T @ off
    for weight, i in zip(weights, fitted, strict=True):
        covariance += weight * frames[i].covariance
    first = float(weights[0]) if fitted[0] == 0 else 0.0
    together = frames[best]._replace(pose=pose, covariance=0.5 * (covariance + covariance.T))
    return together, first
