"""What happens to the light between lamp and detectors: lamp, water and the daylight in it."""

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity, one_way
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.jerlov import Water, diffuse_attenuation
from uuv_optical_array.forward.light import LampSettings, Light, Rays, squared_angle_slopes

WavelengthNm = Annotated[float | None, Quantity("wavelength of the light", "nm", 500, 550)]
KPerM = Annotated[float | None, Quantity("diffuse attenuation coefficient K", "1/m", 0, 10)]


def resolved_attenuation(settings: dict[str, Any], name: str) -> dict[str, Any]:
    """Replace a water type by its K, so that everyone downstream finds a number."""
    if one_way(settings, name, ("k_per_m",), ("water", "wavelength_nm")):
        return {"k_per_m": diffuse_attenuation(settings["water"], settings["wavelength_nm"])}
    return settings


def attenuation(
    array: DetectorArray,
    *,
    k_per_m: KPerM = None,
    water: Water | None = None,
    wavelength_nm: WavelengthNm = None,
) -> Callable[[Light, Rays], None]:
    """Dim by Beer's law along the slant path, ``exp(-K r)`` (Eren et al. 2016, eq. 5).

    K is given as a number, or by a water type and a wavelength: see `jerlov`.
    """
    assert k_per_m is not None  # resolved when the scene was checked
    k_of_scene = k_per_m

    def step(light: Light, rays: Rays) -> None:
        path = rays.range_m.reshape(light.image.shape)
        k = light.setting("attenuation.k_per_m", k_of_scene)
        light.dim(np.exp(-k * path))
        light.slope_by("attenuation.k_per_m", lambda: -path * light.image)
        light.slope_by_position(
            lambda: (
                (-k * light.image / path)[..., None, :, :]
                * rays.to_lamp.reshape(*path.shape[:-2], 3, *path.shape[-2:])
            )
        )

    return step


def beam_spread(
    array: DetectorArray,
    lamp: LampSettings,
    *,
    scattering_per_m: Annotated[float, Quantity("forward scattering coefficient", "1/m", 1e-6, 10)],
    scattering_angle_deg: Annotated[
        float, Quantity("standard deviation of one scattering, by axis", "deg", 0.01, 30)
    ],
) -> Callable[[Light, Rays], None]:
    """Widen the beam by forward scatter, in the small-angle approximation.

    The share ``exp(-b r)`` goes straight; the rest spreads as a Gaussian beam whose variance at
    the lamp, ``sigma^2 + v`` with ``v = b theta^2 r / (3 (1 - exp(-b r)))``, gives the whole the
    exact second moment ``b theta^2 r^3 / 3`` of a thin beam's spread on a plane across it (the
    small-angle scattering of Fermi and Eyges; for light in the sea Arnush 1972, J. Opt. Soc. Am.
    62, 1109, and Wells 1973, AGARD LS-61). Power is kept: what is lost belongs to `attenuation`.
    Single-scattering seas have b of 0.04 (clear), 0.2 (coastal) and 1.8 /m (harbour; Petzold 1972).
    """
    b, theta_squared = scattering_per_m, np.radians(scattering_angle_deg) ** 2
    narrow = np.radians(lamp.beam_sigma_deg) ** 2

    def step(light: Light, rays: Rays) -> None:
        path, shape = rays.range_m, light.image.shape
        straight, scattered = np.exp(-b * path), -np.expm1(-b * path)
        wide = narrow + b * theta_squared * path / (3 * scattered)
        half_square = 0.5 * rays.off_axis_rad**2
        # Where the ideal beam has underflowed this must not overflow.
        excess = np.minimum(half_square * (1 / narrow - 1 / wide), 600.0)
        spread = narrow / wide * np.exp(excess)
        factor = straight + scattered * spread

        light.dim(factor.reshape(shape))
        if light.derivatives is None:
            return
        widening = b * theta_squared / 3 * (scattered - b * path * straight) / scattered**2
        by_range = b * straight * (spread - 1)
        by_range += scattered * spread * widening / wide * (half_square / wide - 1)
        by_half_square = scattered * spread * (1 / narrow - 1 / wide)
        before = light.image.reshape(path.shape) / factor
        by_position, by_axis = squared_angle_slopes(rays)
        planes = (*shape[:-2], 3, *shape[-2:])
        along = (before * by_range / path)[..., None, :] * rays.to_lamp
        weight = (before * by_half_square)[..., None, :]
        light.slope_by_position(lambda: (along + weight * by_position).reshape(planes))
        light.slope_by_axis(lambda: (weight * by_axis).reshape(planes))

    return step


def resolved_ambient(settings: dict[str, Any], name: str) -> dict[str, Any]:
    """Replace daylight at the surface by its level at the array's depth."""
    ways = ("level_counts",), ("surface_counts", "depth_m")
    water = {key: settings.pop(key) for key in ("k_per_m", "water", "wavelength_nm")}
    if one_way(settings, name, *ways):
        k_per_m = resolved_attenuation(water, name)["k_per_m"]
        level = settings["surface_counts"] * np.exp(-k_per_m * settings["depth_m"])
        if level > 1e6:
            raise ValueError(f"{name}: {level:.3g} counts at that depth; give at most 1e6")
        return {"level_counts": float(level)}
    if given := [key for key, value in water.items() if value is not None]:
        raise ValueError(f"{name}.{given[0]}: belongs to surface_counts and depth_m; leave it out")
    return settings


def ambient(
    array: DetectorArray,
    *,
    level_counts: Annotated[
        float | None, Quantity("reading of the sea without the lamp", "counts", 0, 1e6)
    ] = None,
    surface_counts: Annotated[
        float | None, Quantity("that reading at the surface", "counts", 0, 1e12)
    ] = None,
    depth_m: Annotated[float | None, Quantity("array below the surface", "m", 0, 11_000)] = None,
    k_per_m: KPerM = None,
    water: Water | None = None,
    wavelength_nm: WavelengthNm = None,
) -> Callable[[Light, Rays], None]:
    """Add daylight that reaches every detector alike (L_b of Eren et al. 2016, eq. 5).

    Its level is given, or the level at the surface, which falls with depth as ``exp(-K d)``
    (Jerlov 1976; K as in `attenuation`, of the downwelling light).
    """
    assert level_counts is not None  # resolved when the scene was checked
    level = level_counts

    def step(light: Light, rays: Rays) -> None:
        light.image += light.setting("ambient.level_counts", level)
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
