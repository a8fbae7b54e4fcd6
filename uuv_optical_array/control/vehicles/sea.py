"""How the demonstration's sea moves: a steady current and linear waves on deep water.

A wave of height H, period T and wave number k travels along a direction d; z is up, 0 at the still
surface. Where the water below is deeper than half a wave length,

    omega = 2 pi / T,   k = omega^2 / g,   phase = k d . (x - current t) - omega t
    velocity = H / 2 omega exp(k z) (d cos(phase) + up sin(phase))

(Dean and Dalrymple, Water Wave Mechanics for Engineers and Scientists, 1991, chapters 3 and 4). The
current carries the wave along, so its period is that which a drifting body sees.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity

CURRENT = Quantity("velocity of the current in the world", "m/s", -2, 2)
GRAVITY_M_PER_S2 = 9.82  # as in von Benzon et al., 2022


@dataclass(frozen=True)
class WaveSettings:
    """A regular wave, and how deep below it the world's origin lies.

    Within the bounds no wave is so steep that it breaks: 0.142 of its length (Miche, 1944).
    """

    wave_height_m: Annotated[
        float, Quantity("height of the waves from trough to crest; 0: no waves", "m", 0, 3)
    ] = 0.0
    wave_period_s: Annotated[float, Quantity("period of the waves", "s", 4, 15)] = 8.0
    wave_direction_deg: Annotated[
        float,
        Quantity("direction in which the waves travel: 0 along x, 90 along y", "deg", -360, 360),
    ] = 0.0
    depth_m: Annotated[
        float, Quantity("depth of the world's origin below the still surface", "m", 0, 1000)
    ] = 10.0


class Sea:
    """Velocity and acceleration of the water, by waves and a finite current in the world (z up)."""

    def __init__(
        self,
        current_m_per_s: Sequence[float] = (0.0, 0.0, 0.0),
        waves: WaveSettings = WaveSettings(),
    ) -> None:
        self.current: Array = np.array(current_m_per_s, dtype=float)
        self._omega = 2 * math.pi / waves.wave_period_s
        self._wave_number = self._omega**2 / GRAVITY_M_PER_S2
        heading = math.radians(waves.wave_direction_deg)
        self._along = np.array([math.cos(heading), math.sin(heading), 0.0])
        self._speed = waves.wave_height_m / 2 * self._omega  # of the water at the surface, m/s
        self._depth_m = waves.depth_m

    def velocity(self, position: Array, t_s: float) -> Array:
        """Return the water's velocity in the world, m/s, ``(3,)``; above the surface as at it."""
        speed, cos, sin = self._orbit(position, t_s)
        return self.current + speed * np.array([cos * self._along[0], cos * self._along[1], sin])

    def acceleration(self, position: Array, t_s: float) -> Array:
        """Return the acceleration of the water in the world, m/s^2, shape ``(3,)``.

        It is that of a body that drifts with a level current, to first order in the waves' height.
        """
        speed, cos, sin = self._orbit(position, t_s)
        change = speed * self._omega
        return change * np.array([sin * self._along[0], sin * self._along[1], -cos])

    def _orbit(self, position: Array, t_s: float) -> tuple[float, float, float]:
        """Return the orbital speed there, m/s, and cosine and sine of the phase."""
        drifted = float(self._along @ (position - self.current * t_s))
        phase = self._wave_number * drifted - self._omega * t_s
        depth_m = max(self._depth_m - float(position[2]), 0.0)
        speed = self._speed * math.exp(-self._wave_number * depth_m)
        return speed, math.cos(phase), math.sin(phase)


STILL_SEA = Sea()
