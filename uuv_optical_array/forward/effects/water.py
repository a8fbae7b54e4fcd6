"""What happens to the light between lamp and detectors: lamp, water and the daylight in it."""

from typing import Annotated, Any

import numpy as np
from numpy import exp, expm1, minimum

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.elementwise import law
from uuv_optical_array.core.settings import Quantity, one_way
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.forms import Background, Blur, Transmission
from uuv_optical_array.forward.effects.jerlov import Water, diffuse_attenuation
from uuv_optical_array.forward.light import LampSettings

WavelengthNm = Annotated[float | None, Quantity("wavelength of the light", "nm", 400, 700)]
KPerM = Annotated[float | None, Quantity("diffuse attenuation coefficient K", "1/m", 0, 10)]


def resolved_attenuation(settings: dict[str, Any], name: str) -> dict[str, Any]:
    """Replace a water type by its K, which is all that the effects use."""
    if one_way(settings, name, ("k_per_m",), ("water", "wavelength_nm")):
        try:
            return {"k_per_m": diffuse_attenuation(settings["water"], settings["wavelength_nm"])}
        except ValueError as error:
            raise ValueError(f"{name}.{error}") from None
    return settings


@law
def beer(range_m: Any, half_square: Any, cosine: Any, k_per_m: Any, _b: Any, _c: Any) -> Any:
    """Beer's law, ``exp(-K r)``: a `Transmission` with K in 1/m."""
    return exp(-k_per_m * range_m), -k_per_m, 0.0, 0.0, -range_m


def attenuation(
    array: DetectorArray,
    *,
    k_per_m: KPerM = None,
    water: Water | None = None,
    wavelength_nm: WavelengthNm = None,
) -> Transmission:
    """Dim by Beer's law along the slant path, ``exp(-K r)`` (Eren et al. 2016, eq. 5).

    K is given as a number, or by a water type and a wavelength (Jerlov 1976): see `jerlov`.
    """
    assert k_per_m is not None  # resolved when the scene was checked
    return Transmission(beer, (k_per_m, 0.0, 0.0), "attenuation.k_per_m")


@law
def spread(
    range_m: Any,
    half_square: Any,
    cosine: Any,
    beam_sigma_deg: Any,
    scattering_per_m: Any,
    angle_squared: Any,
) -> Any:
    """Law of `beam_spread`: a `Transmission`.

    Its settings are the standard deviation of the beam, deg, the coefficient, 1/m, and the squared
    angle of one scattering, rad^2.
    """
    degree = np.pi / 180
    narrow = (beam_sigma_deg * degree) ** 2
    depth = scattering_per_m * range_m
    straight, scattered = exp(-depth), -expm1(-depth)
    wide = narrow + angle_squared * depth / (3 * scattered)
    # Bounded, so that it does not overflow where the ideal beam has underflowed.
    excess = minimum(half_square * (1 / narrow - 1 / wide), 600.0)
    wider = scattered * narrow / wide * exp(excess)
    factor = straight + wider
    widening = scattering_per_m * angle_squared / 3
    widening = widening * (scattered - depth * straight) / (scattered * scattered)
    by_range = scattering_per_m * straight * (wider / scattered - 1)
    by_range = by_range + wider * widening / wide * (half_square / wide - 1)
    precision_gained = 1 / narrow - 1 / wide
    by_half_square = wider * precision_gained
    by_narrow = wider * precision_gained * (1 - half_square * (1 / narrow + 1 / wide))
    by_sigma = by_narrow * 2 * beam_sigma_deg * degree * degree
    return factor, by_range / factor, by_half_square / factor, 0.0, by_sigma / factor


def beam_spread(
    array: DetectorArray,
    lamp: LampSettings,
    *,
    scattering_per_m: Annotated[float, Quantity("forward scattering coefficient", "1/m", 1e-6, 10)],
    scattering_angle_deg: Annotated[
        float, Quantity("standard deviation of one scattering, by axis", "deg", 0.01, 30)
    ],
) -> Transmission:
    """Widen the beam by forward scatter, in the small-angle approximation.

    The share ``exp(-b r)`` goes straight; the rest spreads as a Gaussian beam whose variance at
    the lamp, ``sigma^2 + v`` with ``v = b theta^2 r / (3 (1 - exp(-b r)))``, gives the whole the
    exact second moment ``b theta^2 r^3 / 3`` of a thin beam's spread on a plane across it (the
    small-angle scattering of Fermi and Eyges; for light in the sea Arnush 1972, J. Opt. Soc. Am.
    62, 1109, and Wells 1973, AGARD LS-61). Power is kept: what is lost belongs to `attenuation`.
    Single-scattering seas have b of 0.04 (clear), 0.2 (coastal) and 1.8 /m (harbour; Petzold 1972).
    """
    angle_squared = float(np.radians(scattering_angle_deg) ** 2)
    settings = (lamp.beam_sigma_deg, scattering_per_m, angle_squared)
    return Transmission(spread, settings, "lamp.beam_sigma_deg")


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
) -> Background:
    """Add daylight that reaches every detector alike (L_b of Eren et al. 2016, eq. 5).

    Its level is given, or the level at the surface, which falls with depth as ``exp(-K d)``
    (Jerlov 1976; K as in `attenuation`, of the downwelling light).
    """
    assert level_counts is not None  # resolved when the scene was checked
    return Background(np.ones(array.side**2), level_counts, "ambient.level_counts")


def hanning_blur(side: int, spacing_m: float, window_m: float) -> Array:
    """Return the matrix that blurs one axis of an image with a Hanning window, ``(side, side)``.

    The window ``h(d) = 0.5 (1 + cos(2 pi d / window_m))`` for ``|d| < window_m / 2`` is
    sampled at the detectors and scaled to unit sum; readings are mirrored at the border,
    each outermost detector included (``d c b a | a b c d | d c b a``).
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
) -> Blur:
    """Blur the image with a two-dimensional Hanning window (Eren et al. 2016, eq. 6).

    The paper's window of 11 samples, its end points zero, at 0.02 m is 0.2 m wide.
    """
    return Blur(hanning_blur(array.side, array.spacing_m, window_m))
