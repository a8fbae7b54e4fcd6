"""How far estimates of random frames are from the truth, and whether their covariances say so."""

import dataclasses
import time
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.estimator import Estimator, NoPose
from uuv_optical_array.estimation.features import key_parameters
from uuv_optical_array.estimation.table.signature_table import BLOCK_POSES, Progress, SignatureTable
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import PriorSettings

# The volume of the study, m and rad: 4 to 8 m, 0.9 m, 20 deg.
HIGH = np.array([-4.0, 0.9, 0.9, *np.radians([20.0, 20.0])])
LOW = np.array([-8.0, *-HIGH[1:]])
MIN_PEAK_COUNTS = 20.0
BAND = 0.95
# The forward model that a frame's time is compared with: this many poses, timed every so often.
MODEL_POSES = 4
MODEL_EVERY = 16


@dataclasses.dataclass(frozen=True)
class Study:
    """What an estimator made of n frames.

    Every mean is over the frames that got a pose.

    Parameters
    ----------
    errors
        Estimate less truth, m and rad, shape ``(n, 5)``; nan where there was no pose.
    covariances
        The estimates' own, shape ``(n, 5, 5)``.
    bounds
        Least standard deviation at each true pose, the Cramer-Rao bound, shape ``(n, 5)``.
    frame_s
        Time from each image to its estimate, s, shape ``(n,)``.
    model_s
        Times of one forward model with Jacobian for `MODEL_POSES` poses, s, shape ``(k,)``.
    """

    errors: Array
    covariances: Array
    bounds: Array
    frame_s: Array
    model_s: Array

    @property
    def posed(self) -> NDArray[np.bool_]:
        """Which frames got a pose, shape ``(n,)``."""
        return ~np.isnan(self.errors[:, 0])

    @property
    def rms_error(self) -> Array:
        """Root mean square error, m and rad, shape ``(5,)``."""
        return np.sqrt(np.mean(self.errors[self.posed] ** 2, axis=0))

    @property
    def rms_bound(self) -> Array:
        """Root of the mean variance of the bound, m and rad, shape ``(5,)``."""
        return np.sqrt(np.mean(self.bounds[self.posed] ** 2, axis=0))

    @property
    def ratio_to_bound(self) -> Array:
        """RMS error over RMS bound, shape ``(5,)``; 0 where the bound is infinite."""
        return self.rms_error / self.rms_bound

    @property
    def nees(self) -> Array:
        """Normalised squared error of each posed frame; 5 on average for honest covariances."""
        errors = self.errors[self.posed]
        weighted = np.linalg.solve(self.covariances[self.posed], errors[..., None])[..., 0]
        return (errors * weighted).sum(axis=1)

    @property
    def nees_band(self) -> tuple[float, float]:
        """Where the mean of as many chi-square(5) variables lies with probability `BAND`."""
        count = int(self.posed.sum())
        low, high = chi2.interval(BAND, 5 * count) / np.array(count)
        return float(low), float(high)

    def beyond_sigma(self, limit: float) -> int:
        """Count frames off by more than `limit` of their own standard deviations in any DOF."""
        return self._beyond(limit * np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)))

    def beyond_bound(self, limit: float) -> int:
        """Count frames off by more than `limit` times the local bound in any DOF."""
        return self._beyond(limit * self.bounds)

    def _beyond(self, most: Array) -> int:
        return int((np.abs(self.errors) > most).any(axis=1).sum())


def random_poses(model: ForwardModel, count: int, rng: np.random.Generator) -> Array:
    """Draw poses uniformly from the study's volume, where there is light.

    Parameters
    ----------
    model
        Forward model of the scene.
    count
        How many, >= 1.
    rng
        Where they come from.

    Returns
    -------
    Array
        Poses whose noiseless image peaks above `MIN_PEAK_COUNTS`, m and rad,
        shape ``(count, 5)``.

    Raises
    ------
    ValueError
        Where a whole block of poses has no such peak.
    """
    poses = np.empty((0, 5))
    while len(poses) < count:
        block = rng.uniform(LOW, HIGH, (BLOCK_POSES, 5))
        lit = model.expected(block).max(axis=(-2, -1)) > MIN_PEAK_COUNTS
        if not lit.any():
            raise ValueError(
                f"scene {model.scene.name}: none of {BLOCK_POSES} poses in 4 to 8 m peaks above "
                f"{MIN_PEAK_COUNTS:g} counts; strengthen the lamp"
            )
        poses = np.concatenate([poses, block[lit]])
    return poses[:count]


def within_volume(information: Array) -> Array:
    """Bound the errors of an image whose pose is known to lie in the study's volume.

    The volume counts as a Gaussian of its variance. Where the image tells more than that, this is
    the Cramer-Rao bound; where it tells nothing, it is the volume's own spread, and never more.

    Parameters
    ----------
    information
        Fisher information of the image, as `limits.fisher_information`, shape ``(..., 5, 5)``.

    Returns
    -------
    Array
        Standard deviations, m and rad, shape ``(..., 5)``.
    """
    covariance = np.linalg.inv(information + np.diag(12 / (HIGH - LOW) ** 2))
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))


def with_prior(table: SignatureTable, prior: PriorSettings) -> SignatureTable:
    """Return the table of the same scene with another prior: the signatures are the same."""
    return dataclasses.replace(table, scene=dataclasses.replace(table.scene, prior=prior))


def study(
    estimator: Estimator,
    poses: Array,
    images: Array,
    progress: Progress = iter,
) -> Study:
    """Estimate frame after frame; an interrupt ends the study with the frames it has.

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
    Study
        Of all frames, or of those before an interrupt; the bound is that of the believed scene.

    Raises
    ------
    ValueError
        Where no frame got a pose.
    KeyboardInterrupt
        Before the first frame was done.
    """
    scene = estimator.table.scene
    model = ForwardModel(scene)
    count, model_s = len(poses), []
    errors, covariances = np.full((count, 5), np.nan), np.full((count, 5, 5), np.nan)
    frame_s = np.empty(count)
    done = 0
    try:
        blocks = [poses[start : start + BLOCK_POSES] for start in range(0, count, BLOCK_POSES)]
        bounds = np.concatenate([cramer_rao_bound(model, block).std for block in blocks])
        for i in progress(range(count)):
            began = time.perf_counter()
            parameters = key_parameters(images[i], scene.full_scale_counts, scene.signature.peak)
            with suppress(NoPose):
                estimate = estimator.estimate(parameters, images[i])
                errors[i], covariances[i] = estimate.pose - poses[i], estimate.covariance
            frame_s[i] = time.perf_counter() - began
            if i % MODEL_EVERY == 0:
                began = time.perf_counter()
                model.linearised(np.resize(poses[i : i + MODEL_POSES], (MODEL_POSES, 5)))
                model_s.append(time.perf_counter() - began)
            done = i + 1
    except KeyboardInterrupt:
        if not done:
            raise
    found = Study(
        errors[:done], covariances[:done], bounds[:done], frame_s[:done], np.array(model_s)
    )
    if not found.posed.any():
        raise ValueError(f"scene {scene.name}: none of {done} frames got a pose")
    return found
