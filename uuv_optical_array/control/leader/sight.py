"""From where a lamp is seen, and how bright it would be."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity

# Attenuation lengths within the sight of a lamp: the demonstration's clear sea at night has 3.5.
WATER = 3.5
NEAREST_M = 0.5  # nearer a lamp is as bright as there


@dataclass(frozen=True)
class SightSettings:
    """From where a lamp is seen."""

    sight_m: Annotated[
        float, Quantity("largest range at which the lamp is seen on its axis", "m", 1, 200)
    ] = 15.0
    sight_deg: Annotated[
        float,
        Quantity(
            "largest angle off the lamp's axis at which it is seen at half of sight_m", "deg", 1, 90
        ),
    ] = 20.0

    def on_axis(self, range_m: ArrayLike) -> Array:
        """Return the logarithm of a lamp's light over the least that is seen, at ranges, m.

        It falls with the square of the range and by what the water takes.
        """
        share = np.maximum(range_m, NEAREST_M) / self.sight_m
        light: Array = -2 * np.log(share) + WATER * (1 - share)
        return light

    def light(self, at: Array, places: Array, headings: Array) -> Array:
        """Return the same at a place, m, ``(3,)``, by each lamp, ``(n,)``.

        It falls with the square of the angle off a lamp's axis, as in a beam that is Gaussian.
        What comes before these axes broadcasts.

        - places, headings: of the lamps, m, ``(n, 3)``, pitch and yaw, rad, ``(n, 2)``.
        """
        off = at - places
        range_m = np.maximum(np.linalg.norm(off, axis=-1), NEAREST_M)
        behind = -np.einsum("...i,...i->...", off, bows_of(headings))
        share = np.arccos(np.clip(behind / range_m, -1.0, 1.0)) / math.radians(self.sight_deg)
        light: Array = self.on_axis(range_m) - self.on_axis(self.sight_m / 2) * share**2
        return light

    def sees(self, at: Array, places: Array, headings: Array) -> NDArray[np.bool_]:
        """Say which lamps are seen from a place, ``(n,)``; arguments are those of `light`."""
        return self.light(at, places, headings) > 0


def bows_of(headings: Array) -> Array:
    """Return unit vectors along the bows of headings, ``(..., 3)``: of pitch and yaw, ``(..., 2)``.

    They are the first columns of `rotation_matrix`.
    """
    pitch, yaw = headings[..., 0], headings[..., 1]
    bows, level = np.empty((*pitch.shape, 3)), np.cos(pitch)
    bows[..., 0], bows[..., 1] = np.cos(yaw) * level, np.sin(yaw) * level
    bows[..., 2] = -np.sin(pitch)
    return bows
