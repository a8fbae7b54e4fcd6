"""How far estimates of random frames are from the truth, and whether their covariances say so."""

import dataclasses
from collections.abc import Iterator
from typing import Any, get_args

import numpy as np
from scipy.special import gammaincinv

from uuv_optical_array.core.geometry import DOF_NAMES, IN_DEGREES, Array
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.table.signature_table import BLOCK_POSES, Progress
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import PRIORS, Known, PriorSettings, Scene
from uuv_optical_array.forward.working_volume import DAY_S, lit_poses
from uuv_optical_array.studies.errors import (
    SIGMAS,
    FrameErrors,
    answer_of,
    by_column,
    frame_errors,
)

BAND = 0.95


@dataclasses.dataclass(frozen=True)
class Accuracy(FrameErrors):
    """Errors of n frames beside their bound; every mean is over the frames that got a pose.

    Parameters
    ----------
    errors, covariances, frame_s, model_s
        As in `FrameErrors`.
    bounds
        Least standard deviation at each true pose, the Cramer-Rao bound, shape ``(n, 5)``.
    """

    bounds: Array

    @property
    def rms_bound(self) -> Array:
        """Root of the mean variance of the bound, m and rad, shape ``(5,)``."""
        return np.sqrt(np.mean(self.bounds[self.posed] ** 2, axis=0))

    @property
    def ratio_to_bound(self) -> Array:
        """RMS error over RMS bound, shape ``(5,)``; 0 where the bound is infinite."""
        return self.rms_error / self.rms_bound

    @property
    def nees_band(self) -> tuple[float, float]:
        """Where the mean of as many chi-square(5) variables lies with probability `BAND`."""
        count = int(self.posed.sum())
        tails = np.array([(1 - BAND) / 2, (1 + BAND) / 2])
        # The quantile of chi-square(k) is twice that of the gamma distribution of shape k / 2.
        low, high = 2 * gammaincinv(5 * count / 2, tails) / count
        return float(low), float(high)

    def beyond_bound(self, limit: float) -> int:
        """Count frames off by more than `limit` times the local bound in any DOF."""
        return int((np.abs(self.errors) > limit * self.bounds).any(axis=1).sum())


def measure(
    estimator: Estimator,
    poses: Array,
    images: Array,
    progress: Progress = iter,
) -> Accuracy:
    """Estimate frame after frame; an interrupt ends it with the frames it has.

    Parameters
    ----------
    estimator
        The estimator, with the scene as it is believed to be.
    poses
        True poses, m and rad, shape ``(n, 5)``, n >= 1.
    images
        What the array read there, counts, shape ``(n, side, side)``.
    progress
        Wraps the loop over frames, such as ``tqdm.tqdm``.

    Returns
    -------
    Accuracy
        Of all frames, or of those before an interrupt; the bound is that of the believed scene.

    Raises
    ------
    ValueError
        Where no frame got a pose.
    KeyboardInterrupt
        Before the first frame was done.
    """
    scene = estimator.scene
    model = ForwardModel(scene)
    blocks = [poses[start : start + BLOCK_POSES] for start in range(0, len(poses), BLOCK_POSES)]
    bounds = np.concatenate([cramer_rao_bound(model, block).std for block in blocks])
    answers = {"estimator": answer_of(estimator)}
    frames = frame_errors(answers, model, poses, images, progress)["estimator"]
    done = len(frames.errors)
    if not frames.posed.any():
        raise ValueError(f"scene {scene.name}: none of {done} frames got a pose")
    return Accuracy(**vars(frames), bounds=bounds[:done])


def exposed(
    model: ForwardModel,
    poses: Array,
    seed: int,
    drawn: bool,
    moving: bool,
    rng: np.random.Generator,
) -> Array:
    """Expose images at poses, with a truth that the estimator does not know.

    Parameters
    ----------
    model
        Of the scene.
    poses
        m and rad, shape ``(n, 5)``.
    seed
        Of what is drawn of the truth.
    drawn
        Whether what the scene's prior leaves open is drawn from it, or is at its mean.
    moving
        Whether each image is of a random moment of a day, or of none.
    rng
        Of the noise, which does not depend on the other choices.

    Returns
    -------
    Array
        Counts, shape ``(n, side, side)``.
    """
    truth = np.random.default_rng((seed, 1))
    moments = truth.uniform(0, DAY_S, len(poses)) if moving else None
    stds = model.scene.prior.nuisance_std() if drawn else {}
    offsets = {name: std * truth.standard_normal(len(poses)) for name, std in stds.items()}
    light = model.light(poses, 0.0, offsets, moments)
    if drawn:
        light = light * (1 + model.scene.prior.gain_std * truth.standard_normal(light.shape))
    return model.read(light, rng)


def compare_known(
    scene: Scene, count: int, seed: int, candidates: int, progress: Progress = iter
) -> Iterator[tuple[Known, Accuracy]]:
    """Measure a scene in seas drawn from each of `PRIORS`: the price of what is not known.

    An interrupt ends it with what it has; before the first frame it passes on.

    Parameters
    ----------
    scene
        Its own prior is not used.
    count
        How many poses, >= 1, the same in every sea.
    seed
        Of poses, seas and noise.
    candidates
        As in `Estimator`.
    progress
        Wraps each loop over frames.

    Yields
    ------
    Known
        How well the scene is known.
    Accuracy
        The last one perhaps of fewer frames.
    """
    poses = lit_poses(ForwardModel(scene), count, np.random.default_rng(seed))
    begun = False
    for known in get_args(Known):
        believed = dataclasses.replace(scene, prior=PriorSettings(known, **PRIORS[known]))
        model = ForwardModel(believed)
        # The same noise in every sea.
        images = exposed(model, poses, seed, True, False, np.random.default_rng((seed, 2)))
        estimator = Estimator(believed, "least_squares", candidates=candidates).wait()
        try:
            found = measure(estimator, poses, images, progress)
        except KeyboardInterrupt:
            if not begun:
                raise
            return
        begun = True
        yield known, found
        if len(found.errors) < count:
            return


def as_object(found: Accuracy) -> dict[str, Any]:
    """Return plain values, errors in m and deg, times in ms; None is not known."""
    nees = found.nees
    median_ms, slow_ms = found.frame_ms
    return {
        "poses": len(found.errors),
        "rms_error": by_column(found.rms_error * IN_DEGREES),
        "rms_bound": by_column(found.rms_bound * IN_DEGREES),
        "ratio_to_bound": dict(zip(DOF_NAMES, found.ratio_to_bound.tolist(), strict=True)),
        "beyond_6_sigma": int(found.beyond_sigma(SIGMAS).sum()),
        "beyond_6_bounds": found.beyond_bound(SIGMAS),
        "nees_mean": float(nees.mean()),
        "nees_std_error": float(nees.std() / np.sqrt(len(nees))),
        "nees_band": list(found.nees_band),
        "without_pose": int((~found.posed).sum()),
        "frame_ms": {"median": median_ms, "99th_percentile": slow_ms},
        "model_ms": found.model_ms,
    }
