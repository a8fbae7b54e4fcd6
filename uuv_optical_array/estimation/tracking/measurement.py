"""What a tracker takes of a frame, and what it refuses."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from uuv_optical_array.core.geometry import DOF_NAMES, Array, wrapped
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.unknowns.constants import Constants

# What is beyond any sea but not beyond double precision, m and rad.
MAX_POSE, MIN_VARIANCE, MAX_VARIANCE, MAX_CONDITION = 1e6, 1e-12, 1e8, 1e10
POSE_CURE = f"give ({', '.join(DOF_NAMES)}), five numbers within +-{MAX_POSE:g}"

Relinearise = Callable[[Array], LinearisedReadings]


class Measurement(NamedTuple):
    """A frame as `Tracker.take` takes it, checked.

    - stamp_ns: of the image, ns.
    - pose: m and rad, shape ``(5,)``, yaw in [-pi, pi].
    - root: of the covariance of `pose`, lower triangular, shape ``(5, 5)``.
    - readings, relinearise, shaded: as of `Tracker.take`.
    """

    stamp_ns: int
    pose: Array
    root: Array
    readings: LinearisedReadings | None
    relinearise: Relinearise | None
    shaded: float

    @property
    def uneven(self) -> bool:
        """Whether the frame is more likely lit unevenly than as the scene says."""
        return self.shaded > 0.5

    @property
    def bent(self) -> bool:
        """Whether its readings are far from linear over what the image leaves of the pose."""
        return self.readings is None and self.relinearise is not None

    def near(self, at: Array, constants: Constants) -> LinearisedReadings | None:
        """Return what `relinearise` does near a place; ``None`` where that is not finite."""
        assert self.relinearise is not None
        try:
            return checked_readings(self.relinearise(at), constants)
        except ValueError:
            return None


def checked_pose(pose: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    """Return copies of a pose, its yaw in [-pi, pi], and of the lower root of its covariance.

    ValueError for a wrong shape or bound, or a covariance that is not symmetric positive definite.
    """
    pose, covariance = np.array(pose, dtype=float), np.asarray(covariance, dtype=float)
    if pose.shape != (5,):
        raise ValueError(f"pose: {pose.tolist()}; {POSE_CURE}")
    for name, value in zip(DOF_NAMES, pose.tolist(), strict=True):
        if not abs(value) <= MAX_POSE:
            raise ValueError(f"pose: {name} is {value}; {POSE_CURE}")
    if covariance.shape != (5, 5) or not np.isfinite(covariance).all():
        raise ValueError(f"covariance: {covariance.tolist()}; give 5 x 5 finite numbers")
    if np.abs(covariance - covariance.T).max() > 1e-9 * np.abs(covariance).max():
        raise ValueError(f"covariance: {covariance.tolist()} is not symmetric; give (C + C^T) / 2")
    # LAPACK itself, as the checks around it take three times as long with so few numbers.
    low, *_, high = lapack.dsyev(covariance, compute_v=0)[0].tolist()
    if not max(MIN_VARIANCE, high / MAX_CONDITION) <= low <= high <= MAX_VARIANCE:
        raise ValueError(
            f"covariance: its eigenvalues are {low:.3g} to {high:.3g}; give a positive definite "
            f"one, from {MIN_VARIANCE:g} to {MAX_VARIANCE:g} and in a ratio of {MAX_CONDITION:g}"
        )
    return wrapped(pose), lapack.dpotrf(covariance, lower=1, clean=1)[0]


def checked_readings(readings: LinearisedReadings, constants: Constants) -> LinearisedReadings:
    """Return a copy of readings.

    ValueError for shapes not of `constants`, numbers that are not finite, or variances not > 0.
    """
    readings = LinearisedReadings(*(np.array(part, dtype=float) for part in readings))
    width = 5 + len(constants.names)
    count = readings.residuals.size
    if constants.gain_std > 0:
        count = constants.detectors * constants.lamps
    shapes = ((width,), (count,), (count, width), (count,), (count,))
    for name, part, shape in zip(readings._fields, readings, shapes, strict=True):
        if part.shape != shape:
            raise ValueError(f"readings: {name} has the shape {part.shape}; give {shape}")
        if name != "variances" and not np.isfinite(part).all():
            raise ValueError(f"readings: {name} holds numbers that are not finite")
    if not (readings.variances > 0).all():
        low = readings.variances.min()
        raise ValueError(f"readings: a variance is {low:g}; give variances > 0, inf for no reading")
    return readings
