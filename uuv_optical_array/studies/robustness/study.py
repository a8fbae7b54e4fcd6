"""Measure estimates, kind of mismatch by kind, by an estimator that believes its scene."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from uuv_optical_array.core.geometry import PITCH, Array, X, Y, Z
from uuv_optical_array.core.storage.formats import plain
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.studies.errors import (
    SIGMAS,
    FrameErrors,
    answer_of,
    frame_errors,
)
from uuv_optical_array.studies.robustness.kinds import Kind

FAR_M = 1.0
# An image that so few honest ones fit worse cannot be told from an honest one.
PLAUSIBLE = 1e-3


@dataclass(frozen=True)
class KindResult:
    """What an estimator made of the frames of a kind.

    Parameters
    ----------
    kind
        What differed from the scene.
    frames
        Errors and covariances.
    plausible
        Which frames' images an honest frame at the answer could have shown, shape ``(n,)``.
    """

    kind: Kind
    frames: FrameErrors
    plausible: NDArray[np.bool_]

    def as_object(self) -> dict[str, Any]:
        """Return plain values; None where no frame was answered, or for what is not finite."""
        frames = self.frames
        beyond, answered = frames.beyond_sigma(SIGMAS), int(frames.posed.sum())
        told: dict[str, Any] = {
            "kind": self.kind.name,
            "what": self.kind.what,
            "times_prior": self.kind.times_prior,
            "within_twice_prior": self.kind.within,
            "frames": len(frames.errors),
            "answered": answered,
            "beyond_6_sigma": int(beyond.sum()),
            "beyond_1_m": int((np.linalg.norm(frames.errors[:, : Z + 1], axis=1) > FAR_M).sum()),
            "indistinguishable": int((beyond & self.plausible).sum()),
        }
        if answered:
            square = frames.rms_error**2
            told["rms_range_m"] = float(np.sqrt(square[X]))
            told["rms_across_m"] = float(np.sqrt(square[Y : Z + 1].mean()))
            told["rms_angle_deg"] = float(np.degrees(np.sqrt(square[PITCH:].mean())))
            told["nees_mean"] = float(frames.nees.mean())
        else:
            keys = ("rms_range_m", "rms_across_m", "rms_angle_deg", "nees_mean")
            told |= dict.fromkeys(keys)
        return plain(told)


def tail_probability(model: ForwardModel, poses: Array, covariances: Array, images: Array) -> Array:
    """Return how probable it is that an honest image fits its answer worse.

    The squared distance of the readings from those expected at the answer, in standard deviations
    of noise, of what the scene's prior leaves open, and of the answer, is chi-square with as many
    degrees of freedom as there are readings within their limits, less the five of the pose. All
    is linear about the answer.

    Parameters
    ----------
    model
        Of the scene as it is believed to be.
    poses, covariances
        Answers and what they claim, m and rad, shapes ``(n, 5)`` and ``(n, 5, 5)``.
    images
        What was read, counts, shape ``(n, side, side)``.

    Returns
    -------
    Array
        Shape ``(n,)``; 0 where there is no answer.
    """
    posed, probability = ~np.isnan(poses[:, 0]), np.zeros(len(poses))
    if not posed.any():
        return probability
    readings = images[posed].reshape(int(posed.sum()), -1)
    stds = model.scene.prior.nuisance_std()
    offsets = {name: np.zeros(len(readings)) for name in stds}
    light, jacobian = model.linearised(poses[posed], 0.0, offsets)
    low, high = model.noise.low, model.noise.high
    off = readings - np.clip(light, low, high)
    # Beyond a limit the light changes no reading.
    jacobian = np.where(((light > low) & (light < high))[..., None], jacobian, 0.0)
    joint = np.zeros((len(readings), 5 + len(stds), 5 + len(stds)))
    joint[:, :5, :5] = covariances[posed]
    joint[:, 5:, 5:] = np.diag(np.square(list(stds.values())))
    spread = jacobian @ joint @ np.swapaxes(jacobian, -1, -2)
    spread += np.eye(light.shape[1]) * model.variance(light)[0][:, None, :]
    distance = (off * np.linalg.solve(spread, off[..., None])[..., 0]).sum(axis=1)
    free = ((readings > low) & (readings < high)).sum(axis=1) - 5
    probability[posed] = chdtrc(np.maximum(free, 1), distance)
    return probability


def measure_kinds(
    estimator: Estimator,
    kinds: Sequence[Kind],
    count: int,
    seed: int,
    progress: Callable[[str, range], Iterable[int]] = lambda name, frames: frames,
) -> Iterator[KindResult]:
    """Estimate frames of every kind.

    An interrupt ends it with what it has; before the first frame it passes on.

    Parameters
    ----------
    estimator
        The estimator, with the scene as it is believed to be.
    kinds
        What differs from it, one after the other.
    count
        Frames of each kind, >= 1.
    seed
        Of poses, noise and what of a kind is random. Kinds share poses and noise.
    progress
        Wraps the loop over the frames of a kind, by its name.

    Yields
    ------
    KindResult
        Of each kind, the last one perhaps of fewer frames.
    """
    model = ForwardModel(estimator.scene)
    answers = {"estimator": answer_of(estimator)}
    begun = False
    for kind in kinds:
        try:
            poses = lit_poses(model, count, np.random.default_rng(seed), kind.draw)
            light = kind.light(model, poses, np.random.default_rng((seed, 1)))
            images = model.read(light, np.random.default_rng((seed, 2)))
            found = frame_errors(answers, model, poses, images, partial(progress, kind.name))
        except KeyboardInterrupt:
            if not begun:
                raise
            return
        frames = found["estimator"]
        begun, done = True, len(frames.errors)
        answered = poses[:done] + frames.errors
        tail = tail_probability(model, answered, frames.covariances, images[:done])
        yield KindResult(kind, frames, tail > PLAUSIBLE)
        if done < count:
            return
