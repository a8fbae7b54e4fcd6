"""Effects that change with time: the lamp's power, and clouds that pass through the beam.

They act only where the time of an image is given. An estimator gives none: it knows neither the
phase of a flicker nor where a cloud is.
"""

from typing import Annotated

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.forms import Moving
from uuv_optical_array.forward.light import ALONG, TO_X, TO_Z

Seed = Annotated[int, Quantity("seed of the random numbers", "", 0, 2**31 - 1)]
WAVES = 16  # of which the slow drift is the sum
CLOUDS = 12  # in one period of the plume


def lamp_flicker(
    array: DetectorArray,
    *,
    depth: Annotated[float, Quantity("amplitude, relative to the lamp's mean power", "", 0, 0.99)],
    frequency_hz: Annotated[
        float,
        Quantity("frequency of the light; by mains power twice that of the mains", "Hz", 1e-3, 1e6),
    ],
) -> Moving:
    """Let the lamp flicker, ``1 + depth sin(2 pi f t)``, like one on alternating current."""

    def factor(time_s: Array, rays: Array, axis: Array) -> Array:
        # Whole cycles are removed first, or a stamp of a billion seconds would lose its phase.
        cycles = np.mod(time_s * frequency_hz, 1.0)
        return 1 + depth * np.sin(2 * np.pi * cycles)

    return Moving(factor)


def lamp_drift(
    array: DetectorArray,
    *,
    std: Annotated[float, Quantity("standard deviation of the logarithm of the power", "", 0, 1)],
    time_scale_s: Annotated[float, Quantity("correlation time of the power", "s", 0.1, 1e6)],
    seed: Seed,
) -> Moving:
    """Let the lamp's power drift slowly, as by a battery or a warming lamp.

    The logarithm is a sum of waves of random phase and Gaussian frequencies (Shinozuka and Jan
    1972, J. Sound Vib. 25, 111), nearly a Gaussian process of correlation ``exp(-t^2 / (2 T^2))``.
    """
    rng = np.random.default_rng(seed)
    rates = rng.standard_normal(WAVES) / time_scale_s
    phases = rng.uniform(0, 2 * np.pi, WAVES)

    def factor(time_s: Array, rays: Array, axis: Array) -> Array:
        waves = np.cos(np.multiply.outer(time_s, rates) + phases)
        return np.exp(std * np.sqrt(2 / WAVES) * waves.sum(axis=-1))

    return Moving(factor)


def plume(
    array: DetectorArray,
    *,
    depth: Annotated[float, Quantity("optical depth in the middle of a cloud", "", 0, 20)],
    size_m: Annotated[
        float, Quantity("standard deviation of the Gaussian profile of a cloud", "m", 0.01, 10)
    ],
    speed_m_per_s: Annotated[
        float, Quantity("speed of the clouds, positive to port", "m/s", -5, 5)
    ],
    distance_m: Annotated[
        float, Quantity("distance of the clouds from the lamp, along the beam", "m", 0.01, 100)
    ],
    seed: Seed,
    extent_m: Annotated[
        float, Quantity("distance after which the pattern of clouds recurs", "m", 0.1, 1000)
    ] = 10.0,
) -> Moving:
    """Dim part of the beam by drifting clouds of sediment or bubbles.

    Clouds are Gaussian in a plane across the beam, drawn once and carried past the lamp by the
    current; each ray loses ``exp(-tau)`` where it pierces that plane (Beer's law; the clouds'
    place and shape are our choice). Rays whose detector lies nearer than the plane lose nothing.
    """
    rng = np.random.default_rng(seed)
    along = rng.uniform(0, extent_m, CLOUDS)
    height = rng.normal(0, size_m, CLOUDS)

    def thickness(across: Array, up: Array) -> Array:
        total = np.zeros(across.shape)
        for place, level in zip(along, height, strict=True):
            # The nearest of the cloud's copies, one every extent.
            gap = np.mod(across - place + extent_m / 2, extent_m) - extent_m / 2
            total += np.exp(-(gap**2 + (up - level) ** 2) / (2 * size_m**2))
        return depth * total

    def factor(time_s: Array, rays: Array, axis: Array) -> Array:
        # The beacon's y and z in base_link, from the beam axis: without roll, the beacon's z has no
        # component along base_link's y, and points up.
        above = np.stack([axis[2], np.zeros(axis[2].shape), -axis[0]])
        above /= np.copysign(np.linalg.norm(above, axis=0), -axis[0])
        aside = np.cross(above, -axis, axis=0)
        along_m, to_lamp = rays[ALONG], rays[TO_X : TO_Z + 1]
        share = distance_m / np.maximum(along_m, distance_m)
        across, up = (-(to_lamp * unit).sum(axis=0) * share for unit in (aside, above))
        drift = np.mod(time_s * speed_m_per_s, extent_m)
        passed = np.exp(-thickness(across - drift, up))
        passed[along_m < distance_m] = 1.0
        return passed

    return Moving(factor)
