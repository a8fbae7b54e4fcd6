"""Errors of poses, and errors and times of estimators."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.cli import progress
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature.features import scene_parameters
from uuv_optical_array.forward.model import ForwardModel

# From an image to a pose and its covariance, nan where it has none; raises `NoPose`.
Answer: TypeAlias = Callable[[Array], tuple[Array, Array | float]]

# The forward model that a frame's time is compared with: this many poses, timed every so often.
MODEL_POSES = 4
MODEL_EVERY = 16
SIGMAS = 6.0  # off by more of its own standard deviations, an estimate is false
BLOCK_READINGS = 1 << 14  # of images worked out at a time, which limits the memory


def bounds(model: ForwardModel, poses: Array) -> tuple[Array, Array]:
    """Return information ``(n, 5, 5)`` and Cramer-Rao sigmas ``(n, 5)`` of images, m and rad."""
    found = (cramer_rao_bound(model, block) for block in blocks(model, poses))
    information, stds = zip(*((of.information, of.std) for of in found), strict=True)
    return np.concatenate(information), np.concatenate(stds)


def blocks(model: ForwardModel, poses: Array) -> list[Array]:
    """Split poses ``(n, 5)`` into blocks that need little memory at a time."""
    step = max(1, BLOCK_READINGS // model.array.side**2)
    return np.array_split(poses, range(step, len(poses), step))


def position_and_angle(errors: Array) -> tuple[float, float]:
    """Root mean square of distance, m, and of angle, deg, of errors ``(n, 5)`` in m and rad."""
    if not len(errors):
        return float("nan"), float("nan")
    position, angle = (np.sqrt((part**2).sum(axis=1).mean()) for part in np.split(errors, [3], 1))
    return float(position), float(np.degrees(angle))


def by_column(values: Array) -> dict[str, float]:
    """Name values of the five degrees of freedom, m and deg."""
    names = (f"{name}_{unit}" for name, unit in zip(DOF_NAMES, DOF_UNITS, strict=True))
    return dict(zip(names, values.tolist(), strict=True))


def range_across_angle(rms: Iterable[float]) -> tuple[float, float, float]:
    """Return RMS errors in x, of y and z together, and of pitch and yaw, of five in any units."""
    x, y, z, pitch, yaw = rms
    return x, math.hypot(y, z) / math.sqrt(2), math.hypot(pitch, yaw) / math.sqrt(2)


@dataclass(frozen=True)
class FrameErrors:
    """Errors of an estimator on n frames, m and rad, nan without a pose, and times."""

    errors: Array  # estimate less truth, (n, 5)
    covariances: Array  # the estimates' own, (n, 5, 5)
    frame_s: Array  # from each image to its estimate, (n,)
    model_s: Array  # of a forward model with Jacobian for `MODEL_POSES` poses, (k,)

    @classmethod
    def untimed(cls, answers: Sequence[tuple[Array, Array] | None], truth: Array) -> "FrameErrors":
        """Return the errors of poses with covariances, or ``None``, at true poses ``(n, 5)``."""
        nothing = np.full(5, np.nan), np.full((5, 5), np.nan)
        poses, covariances = map(np.array, zip(*(it or nothing for it in answers), strict=True))
        return cls(poses - truth, covariances, np.empty(0), np.empty(0))

    @property
    def posed(self) -> NDArray[np.bool_]:
        """Which frames got a pose, shape ``(n,)``."""
        return ~np.isnan(self.errors[:, 0])

    @property
    def rms_error(self) -> Array:
        """Root mean square error of the posed frames, m and rad, shape ``(5,)``."""
        return np.sqrt(np.mean(self.errors[self.posed] ** 2, axis=0))

    @property
    def nees(self) -> Array:
        """Normalised squared error of each posed frame; 5 on average for consistent covariances."""
        errors = self.errors[self.posed]
        weighted = np.linalg.solve(self.covariances[self.posed], errors[..., None])[..., 0]
        return (errors * weighted).sum(axis=1)

    def beyond_sigma(self, limit: float) -> NDArray[np.bool_]:
        """Say which frames are off by more than `limit` of their own sigmas in any DOF."""
        stds = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))
        return np.asarray((np.abs(self.errors) > limit * stds).any(axis=1))

    def summary(self) -> dict[str, Any]:
        """Return how many frames were answered, how many are false, NEES, and RMS errors."""
        answered = int(self.posed.sum())
        rms = self.rms_error if answered else np.full(5, np.nan)
        ahead, across, angle = range_across_angle((rms * IN_DEGREES).tolist())
        return {
            "answered": answered,
            "beyond_6_sigma": int(self.beyond_sigma(SIGMAS).sum()),
            "rms_range_m": ahead,
            "rms_across_m": across,
            "rms_angle_deg": angle,
            "nees_mean": self.nees.mean() if answered else None,
        }

    @property
    def frame_ms(self) -> tuple[float, float]:
        """Median and 99th percentile of the time of a frame, ms."""
        median, slow = 1e3 * np.percentile(self.frame_s, [50, 99])
        return float(median), float(slow)

    @property
    def model_ms(self) -> float:
        """Median time of the forward model, ms."""
        return 1e3 * float(np.median(self.model_s))


def answer_of(estimator: Estimator) -> Answer:
    """Return an estimator's answer to an image."""

    def answer(image: Array) -> tuple[Array, Array]:
        estimate = estimator.estimate(image, scene_parameters(image, estimator.scene))
        return estimate.pose, estimate.covariance

    return answer


def errors_of(
    estimator: Estimator, yardstick: ForwardModel, poses: Array, images: Array, what: str = ""
) -> FrameErrors:
    """Return the `frame_errors` of an estimator, with progress in the name of `what`."""
    rounds = progress.over(range(len(poses)), what=what)
    return frame_errors(answer_of(estimator), yardstick, poses, images, rounds)


def frame_errors(
    answer: Answer, yardstick: ForwardModel, poses: Array, images: Array, rounds: Iterable[int]
) -> FrameErrors:
    """Estimate frame after frame, as `rounds` count them.

    `images` are counts, ``(n, side, side)``, at true `poses`, m and rad, ``(n, 5)``. Between frames
    the `yardstick` is timed, as the machine's speed varies. Ctrl-C ends it once a frame is done.
    """
    errors, covariances = np.full((len(poses), 5), np.nan), np.full((len(poses), 5, 5), np.nan)
    frame_s: list[float] = []
    model_s: list[float] = []
    try:
        with suppress(NoPose):  # the first call is slower
            answer(images[0])
        for i in rounds:
            began = time.perf_counter()
            with suppress(NoPose):
                pose, covariances[i] = answer(images[i])
                errors[i] = pose - poses[i]
            took_s = time.perf_counter() - began
            if i % MODEL_EVERY == 0:
                began = time.perf_counter()
                yardstick.linearised(np.resize(poses[i : i + MODEL_POSES], (MODEL_POSES, 5)))
                model_s.append(time.perf_counter() - began)
            frame_s.append(took_s)
    except KeyboardInterrupt:
        if not frame_s:
            raise
    done = len(frame_s)
    return FrameErrors(errors[:done], covariances[:done], np.array(frame_s), np.array(model_s))
