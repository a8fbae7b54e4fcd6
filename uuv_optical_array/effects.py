"""What water and electronics do to the ideal light: one function an effect, one scene key each.

An effect is a function with the scene key's name. Its keyword-only arguments are the key's
settings. It is called once, when a scene is planned, and returns the step that runs on every
image; what a scene does not name never runs. Effects run stage by stage and, within a stage,
in the order in which they stand in this file, which is the physical one.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any

import numpy as np

from uuv_optical_array.array import DetectorArray
from uuv_optical_array.light import Light, Rays
from uuv_optical_array.pose import Array
from uuv_optical_array.quantity import Quantity, check_all, unknown


class Stage(Enum):
    """Where an effect acts, in physical order, and the step that it returns."""

    LIGHT = "step(light, rays): the light on its way and on the array, changed in place"
    NOISE = "step(image) -> variance in counts^2 and its slope, independent of other noise"
    ANALOGUE = "step(image) -> image: electronics before the converter"
    DIGITAL = "step(image) -> image: the converter"


# Variance in counts^2 and its derivative by the image, each a number or in the image's shape.
Variance = tuple[float | Array, float | Array]

EFFECTS: dict[str, tuple[Stage, Callable[..., Callable[..., Any]]]] = {}


def effect(stage: Stage) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register a function as the effect of its name, at `stage`."""

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        EFFECTS[function.__name__] = stage, function
        return function

    return register


@effect(Stage.LIGHT)
def attenuation(
    array: DetectorArray,
    *,
    k_per_m: Annotated[float, Quantity("diffuse attenuation coefficient K", "1/m", 0, 10)],
) -> Callable[[Light, Rays], None]:
    """Dim by Beer's law along the slant path, ``exp(-K r)`` (Eren et al. 2016, eq. 5).

    0.05 /m is clear ocean, 0.1 /m tropical coastal water (500 to 550 nm).
    """

    def step(light: Light, rays: Rays) -> None:
        path = rays.range_m.reshape(light.image.shape)
        k = light.setting("attenuation.k_per_m", k_per_m)
        light.dim(np.exp(-k * path))
        light.slope_by("attenuation.k_per_m", lambda: -path * light.image)
        light.slope_by_position(
            lambda: (
                (-k * light.image / path)[..., None, :, :]
                * rays.to_lamp.reshape(*path.shape[:-2], 3, *path.shape[-2:])
            )
        )

    return step


@effect(Stage.LIGHT)
def ambient(
    array: DetectorArray,
    *,
    level_counts: Annotated[
        float, Quantity("reading of the sea without the lamp", "counts", 0, 1e6)
    ],
) -> Callable[[Light, Rays], None]:
    """Add daylight that reaches every detector alike (L_b of Eren et al. 2016, eq. 5)."""

    def step(light: Light, rays: Rays) -> None:
        light.image += light.setting("ambient.level_counts", level_counts)
        light.slope_by("ambient.level_counts", lambda: 1.0)

    return step


def hanning_blur(side: int, spacing_m: float, window_m: float) -> Array:
    """Build the matrix that blurs one axis of an image with a Hanning window.

    The window ``h(d) = 0.5 (1 + cos(2 pi d / window_m))`` for ``|d| < window_m / 2`` is
    sampled at the detectors and scaled to unit sum; readings are mirrored at the border,
    each outermost detector included (``d c b a | a b c d | d c b a``).

    Parameters
    ----------
    side
        Detectors along the axis.
    spacing_m
        Distance between them, m.
    window_m
        Full width of the window, m.

    Returns
    -------
    Array
        Shape ``(side, side)``, each row summing to 1.
    """
    reach = int(np.ceil(window_m / 2 / spacing_m)) - 1
    steps = np.arange(-reach, reach + 1)
    weights = 0.5 * (1 + np.cos(2 * np.pi * steps * spacing_m / window_m))
    weights /= weights.sum()
    source = (np.arange(side)[:, None] + steps) % (2 * side)
    source = np.where(source < side, source, 2 * side - 1 - source)
    matrix = np.zeros((side, side))
    np.add.at(matrix, (np.arange(side)[:, None], source), weights)
    return matrix


@effect(Stage.LIGHT)
def forward_scatter(
    array: DetectorArray,
    *,
    window_m: Annotated[float, Quantity("full width of the window on the array", "m", 1e-3, 10)],
) -> Callable[[Light, Rays], None]:
    """Blur the image with a two-dimensional Hanning window (Eren et al. 2016, eq. 6).

    The paper's window of 11 samples, its end points zero, at 0.02 m is 0.2 m wide.
    """
    blur = hanning_blur(array.side, array.spacing_m, window_m)

    def step(light: Light, rays: Rays) -> None:
        light.change(lambda image: blur @ image @ blur.T)

    return step


@effect(Stage.NOISE)
def sensor_noise(
    array: DetectorArray,
    *,
    sigma_counts: Annotated[float, Quantity("standard deviation of a reading", "counts", 0, 1e6)],
) -> Callable[[Array], Variance]:
    """Net noise of a detector and its amplifier, Gaussian (Eren et al. 2016, eq. 7)."""
    variance = sigma_counts**2

    def step(image: Array) -> Variance:
        return variance, 0.0

    return step


@effect(Stage.NOISE)
def shot_noise(
    array: DetectorArray,
    *,
    electrons_per_count: Annotated[float, Quantity("electrons of one count", "", 1e-3, 1e12)],
) -> Callable[[Array], Variance]:
    """Shot noise of the light, whose variance is its mean in electrons (Eren et al. 2016, eq. 7).

    Gaussian, as the paper assumes; ``2 q I B`` in counts.
    """

    def step(image: Array) -> Variance:
        return image / electrons_per_count, 1 / electrons_per_count

    return step


@effect(Stage.ANALOGUE)
def saturation(
    array: DetectorArray,
    *,
    level_counts: Annotated[float, Quantity("largest analogue reading", "counts", 1, 1e6)],
) -> Callable[[Array], Array]:
    """Clip at the largest signal that photodiode and amplifier can give."""

    def step(image: Array) -> Array:
        return np.minimum(image, level_counts)

    return step


@effect(Stage.DIGITAL)
def adc(
    array: DetectorArray,
    *,
    bits: Annotated[int, Quantity("resolution; readings run from 0 to 2^bits - 1", "", 1, 16)],
) -> Callable[[Array], Array]:
    """Round to whole counts and clip to the converter's range."""
    largest = 2**bits - 1

    def step(image: Array) -> Array:
        return np.clip(np.rint(image), 0, largest)

    return step


Settings = Mapping[str, Mapping[str, Any]]


def check_effects(settings: Any) -> dict[str, dict[str, Any]]:
    """Check a scene's ``effects`` and put them in physical order.

    Parameters
    ----------
    settings
        Mapping from the name of an effect to its settings; ``None`` is no effect.

    Returns
    -------
    dict
        The checked settings by name, in physical order.

    Raises
    ------
    ValueError
        For an unknown effect or a bad setting, by name.
    """
    settings = {} if settings is None else settings
    if not isinstance(settings, Mapping):
        raise ValueError(f"effects: {settings!r} is not a mapping of effects to their settings")
    for name in settings:
        if name not in EFFECTS:
            raise unknown(name, EFFECTS, "effects")
    stages = list(Stage)
    in_order = sorted(EFFECTS, key=lambda name: stages.index(EFFECTS[name][0]))
    return {
        name: check_all(EFFECTS[name][1], settings[name], f"effects.{name}")
        for name in in_order
        if name in settings
    }


@dataclass(frozen=True)
class Plan:
    """The steps that a scene names, and no others, by stage."""

    light: tuple[Callable[[Light, Rays], None], ...]
    noise: tuple[Callable[[Array], Variance], ...]
    analogue: tuple[Callable[[Array], Array], ...]
    digital: tuple[Callable[[Array], Array], ...]


def plan(settings: Settings, array: DetectorArray) -> Plan:
    """Plan the effects of a scene for an array, once.

    Parameters
    ----------
    settings
        What `check_effects` returned.
    array
        The scene's detectors.

    Returns
    -------
    Plan
        The steps, kernels built.
    """
    steps: dict[Stage, list[Callable[..., Any]]] = {stage: [] for stage in Stage}
    for name, values in settings.items():
        stage, function = EFFECTS[name]
        steps[stage].append(function(array, **values))
    return Plan(*(tuple(steps[stage]) for stage in Stage))
