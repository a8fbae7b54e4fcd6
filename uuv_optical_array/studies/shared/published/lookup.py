"""The look-up of the dissertation that the 2016 paper grew from (F. Eren, UNH, 2015).

A table of poses is searched for candidates whose peak lies on the detector of the image's peak;
of these the one of least cost

    c1 |dSk_h| + c2 |dSk_v| + c3 |dSAM|

wins, with the differences in both skewnesses and in the spectral angle. The author dropped it
as slow; sorted by the peak's detector, the table is fast enough.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Span
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature.spectral_angle import unit_vectors
from uuv_optical_array.estimation.table.signature_table import SignatureTable
from uuv_optical_array.forward.scene import Scene, TableSettings

# 4 to 8 m by 1 m, 0.3 m across by 0.03 m, 30 deg by 3 deg: 972,405 poses.
GRID = TableSettings(
    x_m=Span(-8.0, -4.0, 5),
    y_m=Span(-0.3, 0.3, 21),
    z_m=Span(-0.3, 0.3, 21),
    pitch_deg=Span(-30.0, 30.0, 21),
    yaw_deg=Span(-30.0, 30.0, 21),
)


class Weights(NamedTuple):
    """Of the three terms of the cost; only their ratios matter. The author found them by trial."""

    skewness_horizontal: float = 1.0
    skewness_vertical: float = 1.0
    spectral_angle: float = 16.0


def lookup_scene(scene: Scene) -> Scene:
    """Return the scene with the dissertation's grid, and its peak at a whole detector."""
    return dataclasses.replace(
        scene,
        table=GRID,
        signature=dataclasses.replace(scene.signature, peak="detector"),
    )


class LookUp:
    """Estimate poses by looking them up.

    Parameters
    ----------
    table
        Table of a scene whose signature has its peak at a whole detector, such as
        ``cached_table(lookup_scene(scene))``.
    weights
        Of the cost.

    Raises
    ------
    ValueError
        For a table whose peaks lie between detectors.
    """

    def __init__(self, table: SignatureTable, weights: Weights | None = None) -> None:
        scene = table.scene
        if scene.signature.peak != "detector":
            raise ValueError(
                f"table: signature.peak is {scene.signature.peak!r}; the look-up needs 'detector'"
            )
        self.scene = scene
        self.weights = weights or Weights()
        self._side = scene.array.detectors_per_side
        cells = self._cells(table.parameters)
        order = np.argsort(cells, kind="stable")
        self._starts = np.searchsorted(cells[order], np.arange(self._side**2 + 1))
        self._poses = table.poses[order]
        self._features = self._compared(table.parameters[order])

    def _cells(self, parameters: Array) -> Array:
        """Return the number of the detector at the peak, row-major."""
        column, row = np.rint(parameters[..., 1:3] + (self._side - 1) / 2).T
        return row * self._side + column

    def _compared(self, parameters: Array) -> Array:
        """Return what the cost compares: both skewnesses and the spectral angle.

        The angle of an image is that between its five parameters and those of an array which
        looks straight at the lamp: (peak, 0, 0, 0, 0), whatever the range.
        """
        units = unit_vectors(parameters)
        angles = np.arctan2(np.linalg.norm(units[..., 1:], axis=-1), units[..., 0])
        return np.stack([parameters[..., 3], parameters[..., 4], angles], axis=-1)

    def pose(self, image: ArrayLike) -> Array:
        """Look up the pose of an image.

        Parameters
        ----------
        image
            Readings in counts, finite and >= 0, shape ``(side, side)``.

        Returns
        -------
        Array
            ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``: a
            row of the table, the first of equally good ones.

        Raises
        ------
        NoPose
            For an image of another shape, without light, or whose peak no pose of the table has.
        """
        image = np.asarray(image, dtype=float)
        if image.shape != (self._side, self._side) or not np.isfinite(image).all():
            raise NoPose(f"no image: the look-up needs {self._side} x {self._side} finite readings")
        if image.max() <= 0:
            raise NoPose(f"no light: the peak is {image.max():g} counts")
        parameters = key_parameters(image, self.scene.full_scale_counts, "detector")
        cell = int(self._cells(parameters))
        found = slice(*self._starts[cell : cell + 2])
        if found.start == found.stop:
            row, column = divmod(cell, self._side)
            raise NoPose(f"no match: no pose of the table peaks in row {row}, column {column}")
        apart = np.abs(self._features[found] - self._compared(parameters))
        return np.array(self._poses[found][np.argmin(apart @ np.array(self.weights))])
