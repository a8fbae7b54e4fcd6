"""From signature to pose: the nearest entry of the table by spectral angle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.features import lifted
from uuv_optical_array.pose import Array
from uuv_optical_array.sam import SpectralIndex
from uuv_optical_array.table import SignatureTable, grid_axes


class NoPose(Exception):
    """There is no honest pose for this signature; the message says why."""


@dataclass(frozen=True)
class Estimate:
    """A pose and how far it can be trusted.

    Parameters
    ----------
    pose
        ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.
    covariance
        Of `pose`, m^2, m rad and rad^2, shape ``(5, 5)``, positive definite.
    angle_rad
        Spectral angle to the signature of `pose`, in [0, pi].
    runner_up_pose
        The second nearest pose, shape ``(5,)``.
    runner_up_angle_rad
        Its spectral angle.
    """

    pose: Array
    covariance: Array
    angle_rad: float
    runner_up_pose: Array
    runner_up_angle_rad: float


class Estimator:
    """Match signatures against a table, by spectral angle on the lifted vectors.

    Parameters
    ----------
    table
        The signature table, of at least two rows.
    max_angle_rad
        A match farther away than this is refused: the image belongs to no pose of the table.
    neighbours
        Nearest rows whose spread about the best is the covariance. On a 13^5 table 64 give
        a mean normalised squared error near its expectation of 5; fewer are overconfident.

    Raises
    ------
    ValueError
        For a table of fewer than two rows, or fewer than two neighbours.
    """

    def __init__(
        self, table: SignatureTable, max_angle_rad: float = 0.25, neighbours: int = 64
    ) -> None:
        if len(table.poses) < 2:
            raise ValueError(f"table: {len(table.poses)} row; a match needs at least two")
        if neighbours < 2:
            raise ValueError(f"neighbours: {neighbours}; the runner-up needs at least 2")
        self.table = table
        self.max_angle_rad = max_angle_rad
        self.neighbours = neighbours
        self._index = SpectralIndex(self._vectors(table.parameters))
        # A pose is known no better than its cell of the grid, uniform: step^2 / 12.
        axes = grid_axes(table.scene.table)
        steps = [(axis[-1] - axis[0]) / max(len(axis) - 1, 1) for axis in axes]
        self._cell = np.diag(np.maximum(np.square(steps) / 12, 1e-8))

    def _vectors(self, parameters: ArrayLike) -> Array:
        scene = self.table.scene
        return lifted(parameters, scene.signature, scene.array.detectors_per_side)

    def estimate(self, parameters: ArrayLike) -> Estimate:
        """Estimate the pose from the key parameters of one image.

        Parameters
        ----------
        parameters
            Key parameters, shape ``(5,)``.

        Returns
        -------
        Estimate
            The nearest entry of the table.

        Raises
        ------
        NoPose
            For parameters that are not finite or hold no light, or when the nearest entry is
            farther than ``max_angle_rad``.
        """
        parameters = np.asarray(parameters, dtype=float)
        # Far beyond any image's, and yet safe to weigh.
        if parameters.shape != (5,) or not (np.abs(parameters) < 1e100).all():
            raise NoPose(f"not five finite numbers: {parameters.tolist()}")
        if parameters[0] <= 0:
            raise NoPose(f"no light: the peak is {parameters[0]:g} of full scale")
        angles, rows = self._index.nearest(self._vectors(parameters), self.neighbours)
        if angles[0] > self.max_angle_rad:
            raise NoPose(
                f"no match: the nearest signature is {angles[0]:.3f} rad away, "
                f"more than {self.max_angle_rad:g}; the pose lies outside the table "
                "or the scene differs from the sea"
            )
        poses = self.table.poses[rows]
        spread = poses - poses[0]
        covariance = spread.T @ spread / len(poses) + self._cell
        return Estimate(
            np.array(poses[0]), covariance, float(angles[0]), np.array(poses[1]), float(angles[1])
        )
