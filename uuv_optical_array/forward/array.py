"""Detector arrays: where each photodiode sits and where it looks."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Order, Quantity

Shape: TypeAlias = Literal["planar", "curved"]


@dataclass(frozen=True)
class ArraySettings:
    """The array of a scene; defaults are the vehicle of Eren et al. (2016)."""

    shape: Shape
    detectors_per_side: Annotated[
        int, Quantity("number of detectors in a row, and number of rows", "", 2, 501)
    ]
    width_m: Annotated[
        float, Quantity("distance between the outermost detectors of a row", "m", 0.01, 10)
    ] = 0.4
    bow_m: Annotated[
        float, Quantity("distance of the array's frame ahead of base_link", "m", -50, 50)
    ] = 0.4
    radius_m: Annotated[
        float | None, Quantity("radius of the sphere, which a curved array needs", "m", 0.01, 100)
    ] = None
    wiring: Annotated[
        Order | None,
        Quantity("index of each detector in the image of a message, by rows", "", 0, 501**2 - 1),
    ] = None

    def __post_init__(self) -> None:
        if self.wiring is not None and len(self.wiring) != self.detectors_per_side**2:
            raise ValueError(
                f"wiring: {len(self.wiring)} places, but the array has "
                f"{self.detectors_per_side**2} detectors; find them with uuv_array commission"
            )
        if self.shape == "planar":
            if self.radius_m is not None:
                raise ValueError(
                    f"radius_m: {self.radius_m:g} m, but a planar array has none; leave it out, "
                    "or write null where an extended scene gives it"
                )
            return
        if self.radius_m is None:
            raise ValueError("radius_m: missing; a curved array needs the radius of its sphere")
        corner = self.width_m / math.sqrt(2)
        if self.radius_m <= corner:
            raise ValueError(
                f"radius_m: {self.radius_m:g} m is too small; the corner detectors lie "
                f"{corner:.4g} m off the axis, so the radius must be larger"
            )

    def with_shape(self, shape: Shape) -> "ArraySettings":
        """Return the settings with another shape; a new sphere is as curved as the paper's."""
        if shape == self.shape:
            return self
        radius_m = 0.32 * (self.width_m / 0.4) if shape == "curved" else None
        return dataclasses.replace(self, shape=shape, radius_m=radius_m)


@dataclass(frozen=True)
class DetectorArray:
    """Detectors in the follower's ``base_link``, row-major from the top port corner.

    - positions, normals: centres, m, and outward unit normals, shape ``(side * side, 3)``.
    - side: detectors in a row; an image has shape ``(side, side)``.
    - spacing_m: distance between neighbours, projected on the plane of the array, m.
    """

    positions: Array
    normals: Array
    side: int
    spacing_m: float


def build_array(settings: ArraySettings) -> DetectorArray:
    """Place the detectors of checked settings (Eren et al. 2016, eqs 9 to 12).

    Planar detectors lie in ``x = bow_m`` and look along +x; curved ones lie on a sphere
    centred at ``(bow_m, 0, 0)`` and look along its radius. Row 0 is the top (largest z),
    column 0 the port edge (largest y).
    """
    side = settings.detectors_per_side
    offsets = np.linspace(settings.width_m / 2, -settings.width_m / 2, side)
    z, y = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    bow = np.array([settings.bow_m, 0.0, 0.0])
    if settings.radius_m is None:
        positions = bow + np.stack([np.zeros_like(y), y, z], axis=-1)
        normals = np.broadcast_to([1.0, 0.0, 0.0], positions.shape).copy()
    else:
        # Rounding may leave a corner just outside the sphere.
        depth = np.sqrt(np.maximum(settings.radius_m**2 - y**2 - z**2, 0.0))
        normals = np.stack([depth, y, z], axis=-1)
        positions = bow + normals
        normals /= settings.radius_m
    return DetectorArray(positions, normals, side, settings.width_m / (side - 1))
