"""What changes while the scene runs: the lamp's power, and clouds that pass through the beam.

These act at a moment, ``light.time_s``. Where nobody names one, as an estimator does not, they do
nothing: it knows neither the phase of a flicker nor where a cloud is, and believes the mean sea.
"""

from collections.abc import Callable
from typing import Annotated

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.light import Light, Rays

Seed = Annotated[int, Quantity("of the draw", "", 0, 2**31 - 1)]
WAVES = 16  # of which the slow drift is the sum
CLOUDS = 12  # in one period of the plume


def lamp_flicker(
    array: DetectorArray,
    *,
    depth: Annotated[float, Quantity("amplitude, of the lamp's power", "", 0, 0.99)],
    frequency_hz: Annotated[float, Quantity("of the light, twice the mains'", "Hz", 1e-3, 1e6)],
) -> Callable[[Light, Rays], None]:
    """Let the lamp flicker, ``1 + depth sin(2 pi f t)``, as a lamp on alternating current does."""

    def step(light: Light, rays: Rays) -> None:
        if light.time_s is not None:
            # Cycles first: a stamp of a billion seconds times 2 pi would have lost its phase.
            cycles = np.mod(light.time_s * frequency_hz, 1.0)
            light.dim(1 + depth * np.sin(2 * np.pi * cycles)[..., None, None])

    return step


def lamp_drift(
    array: DetectorArray,
    *,
    std: Annotated[float, Quantity("standard deviation of the power's logarithm", "", 0, 1)],
    time_scale_s: Annotated[float, Quantity("time in which it changes", "s", 0.1, 1e6)],
    seed: Seed,
) -> Callable[[Light, Rays], None]:
    """Let the lamp's power drift slowly, as by a battery or a warming lamp.

    The logarithm is a sum of waves of random phase and Gaussian frequencies (Shinozuka and Jan
    1972, J. Sound Vib. 25, 111): nearly a Gaussian process whose correlation is
    ``exp(-t^2 / (2 T^2))``.
    """
    rng = np.random.default_rng(seed)
    rates = rng.standard_normal(WAVES) / time_scale_s
    phases = rng.uniform(0, 2 * np.pi, WAVES)

    def step(light: Light, rays: Rays) -> None:
        if light.time_s is not None:
            waves = np.cos(np.multiply.outer(light.time_s, rates) + phases)
            power = np.exp(std * np.sqrt(2 / WAVES) * waves.sum(axis=-1))
            light.dim(power[..., None, None])

    return step


def plume(
    array: DetectorArray,
    *,
    depth: Annotated[float, Quantity("optical depth in the middle of a cloud", "", 0, 20)],
    size_m: Annotated[float, Quantity("standard deviation of a cloud", "m", 0.01, 10)],
    speed_m_per_s: Annotated[float, Quantity("drift of the clouds to port", "m/s", -5, 5)],
    distance_m: Annotated[float, Quantity("from the lamp, along the beam", "m", 0.01, 100)],
    seed: Seed,
    extent_m: Annotated[float, Quantity("length after which clouds recur", "m", 0.1, 1000)] = 10.0,
) -> Callable[[Light, Rays], None]:
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

    def step(light: Light, rays: Rays) -> None:
        if light.time_s is None:
            return
        # Level vehicles: beacon's y and z as base_link knows them, by way of the beam axis.
        axis = rays.beam_axis
        aside = np.stack([-axis[..., 1, :], axis[..., 0, :], np.zeros(axis[..., 0, :].shape)], -2)
        aside /= -np.linalg.norm(aside, axis=-2, keepdims=True)
        above = np.cross(-axis, aside, axis=-2)
        share = distance_m / np.maximum(rays.along_m, distance_m)
        across, up = (-(rays.to_lamp * unit).sum(axis=-2) * share for unit in (aside, above))
        drift = np.mod(np.asarray(light.time_s) * speed_m_per_s, extent_m)
        passed = np.exp(-thickness(across - drift[..., None], up))
        passed[rays.along_m < distance_m] = 1.0
        light.dim(passed.reshape(light.image.shape))

    return step
