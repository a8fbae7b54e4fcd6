"""Kinds of frame that an image may be, such as clear and shaded, weighed by their evidence."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.frame import FITTED, FrameResult
from uuv_optical_array.estimation.least_squares.problem import Problem


class FrameKind(NamedTuple):
    """A kind of frame, with r nuisances, some of which are the scene's q unknown constants.

    Parameters
    ----------
    problem
        Its posterior, without readings.
    log_odds
        Logarithm of the share of such frames.
    places
        Those of the scene's constants among the nuisances, shape ``(q,)``.
    added
        What this kind adds to the covariance of the constants, shape ``(r, r)``.
    """

    problem: Problem
    log_odds: float
    places: NDArray[np.intp]
    added: Array

    def knowing(self, constants: tuple[Array, Array] | None) -> Problem:
        """Return the problem where the constants are known by a mean and a covariance."""
        if constants is None or not len(self.places):
            return self.problem
        mean, covariance = constants
        whole, at = self.added.copy(), np.zeros(len(self.added))
        whole[np.ix_(self.places, self.places)] += covariance
        at[self.places] = mean
        precision: Array = np.asarray(np.linalg.inv(whole), dtype=float)
        return self.problem._replace(nuisance_mean=at, nuisance_precision=precision)


def frame_kind(
    problem: Problem, log_odds: float, stds: Mapping[str, float], constants: Mapping[str, float]
) -> FrameKind:
    """Return a kind of frame.

    Parameters
    ----------
    problem, log_odds
        As in `FrameKind`.
    stds
        Standard deviation of each of its nuisances, by name, in the order of the problem.
    constants
        The same of the scene's unknown constants.
    """
    names = list(stds)
    places = np.array([names.index(name) for name in constants], dtype=np.intp)
    added = np.square(list(stds.values()))
    added[places] -= np.square(list(constants.values()))
    return FrameKind(problem, log_odds, places, np.diag(added))


def mixture(frames: list[FrameResult], evidence: Array) -> FrameResult:
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
    """
    fitted = [i for i, frame in enumerate(frames) if frame.outcome == FITTED]
    if not fitted:
        return frames[0]
    best = max(fitted, key=lambda i: evidence[i])
    weights = np.exp(evidence[fitted] - evidence[best])
    weights /= weights.sum()
    poses = np.array([frames[i].pose for i in fitted])
    pose = weights @ poses
    off = poses - pose
    covariance = (weights[:, None] * off).T @ off
    for weight, i in zip(weights, fitted, strict=True):
        covariance += weight * frames[i].covariance
    return frames[best]._replace(pose=pose, covariance=0.5 * (covariance + covariance.T))
