"""How far estimates of random frames are from the truth, and whether their covariances say so."""

import dataclasses

import numpy as np
from scipy.special import gammaincinv

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.table.signature_table import BLOCK_POSES, Progress, SignatureTable
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import PriorSettings
from uuv_optical_array.studies.shared.errors import FrameErrors, answer_of, frame_errors

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
        tails = np.array([(1 - BAND) / 2, (1 + BAND) / 2])
        # The quantile of chi-square(k) is twice that of the gamma distribution of shape k / 2.
        low, high = 2 * gammaincinv(5 * count / 2, tails) / count
        return float(low), float(high)

    def beyond_sigma(self, limit: float) -> int:
        """Count frames off by more than `limit` of their own standard deviations in any DOF."""
        return self._beyond(limit * np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)))

    def beyond_bound(self, limit: float) -> int:
        """Count frames off by more than `limit` times the local bound in any DOF."""
        return self._beyond(limit * self.bounds)

    def _beyond(self, most: Array) -> int:
        return int((np.abs(self.errors) > most).any(axis=1).sum())


def with_prior(table: SignatureTable, prior: PriorSettings) -> SignatureTable:
    """Return the table of the same scene with another prior: the signatures are the same."""
    return dataclasses.replace(table, scene=dataclasses.replace(table.scene, prior=prior))


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
    scene = estimator.table.scene
    model = ForwardModel(scene)
    blocks = [poses[start : start + BLOCK_POSES] for start in range(0, len(poses), BLOCK_POSES)]
    bounds = np.concatenate([cramer_rao_bound(model, block).std for block in blocks])
    answers = {"estimator": answer_of(estimator)}
    frames = frame_errors(answers, model, poses, images, progress)["estimator"]
    done = len(frames.errors)
    if not frames.posed.any():
        raise ValueError(f"scene {scene.name}: none of {done} frames got a pose")
    return Accuracy(**vars(frames), bounds=bounds[:done])
