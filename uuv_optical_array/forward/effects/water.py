"""What happens to the light between lamp and detectors: lamp, water and the daylight in it."""

from typing import Annotated, Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.elementwise import exp, law
from uuv_optical_array.core.settings import Quantity, one_way
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.forms import Background, Blur, Scattering, Transmission
from uuv_optical_array.forward.effects.waters import (
    PETZOLD_PER_M,
    Measured,
    Water,
    diffuse_attenuation,
)

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
def beer_exponent(range_m: Any, k_per_m: Any) -> Any:
    """Return the logarithm of what Beer's law leaves of the light."""
    return -k_per_m * range_m


@law
def beer(range_m: Any, cosine: Any, k_per_m: Any, _b: Any, _c: Any) -> Any:
    """Beer's law, ``exp(-K r)``: a `Transmission` with K in 1/m."""
    return exp(beer_exponent(range_m, k_per_m)), -k_per_m, 0.0, -range_m


def attenuation(
    array: DetectorArray,
    *,
    k_per_m: KPerM = None,
    water: Water | None = None,
    wavelength_nm: WavelengthNm = None,
) -> Transmission:
    """Dim by Beer's law along the slant path, ``exp(-K r)`` (Eren et al. 2016, eq. 5).

    K is given as a number, or by a water type and a wavelength (Jerlov 1976).
    """
    assert k_per_m is not None  # resolved when the scene was checked
    return Transmission(beer, (k_per_m, 0.0, 0.0), "attenuation.k_per_m")


def resolved_sea(settings: dict[str, Any], name: str) -> dict[str, Any]:
    """Replace a measured water by its absorption and scattering."""
    if one_way(settings, name, ("absorption_per_m", "scattering_per_m"), ("water",)):
        absorption, scattering = PETZOLD_PER_M[settings["water"]]
        return {"absorption_per_m": absorption, "scattering_per_m": scattering}
    return settings


def sea(
    array: DetectorArray,
    *,
    absorption_per_m: Annotated[
        float | None, Quantity("absorption coefficient a", "1/m", 0, 10)
    ] = None,
    scattering_per_m: Annotated[
        float | None, Quantity("scattering coefficient b", "1/m", 1e-6, 10)
    ] = None,
    water: Measured | None = None,
) -> tuple[Scattering, Transmission]:
    """Let the light through water that absorbs and scatters.

    Scattering widens the beam, tilts the light away from its axis and loses a little of it; the law
    and its constants are those of `forward.scattering`. Both coefficients are given, or a water
    that Petzold measured. Scattering is known to a prior by its logarithm.
    """
    assert absorption_per_m is not None  # resolved when the scene was checked
    assert scattering_per_m is not None
    absorption = Transmission(beer, (absorption_per_m, 0.0, 0.0), "sea.absorption_per_m")
    return Scattering(scattering_per_m), absorption


def resolved_ambient(settings: dict[str, Any], name: str) -> dict[str, Any]:
    """Replace daylight at the surface by its level at the array's depth."""
    ways = ("level_counts",), ("surface_counts", "depth_m")
    water = {key: settings.pop(key) for key in ("k_per_m", "water", "wavelength_nm")}
    if one_way(settings, name, *ways):
        k_per_m = resolved_attenuation(water, name)["k_per_m"]
        level = settings["surface_counts"] * np.exp(-k_per_m * settings["depth_m"])
        if level > 1e6:
            raise ValueError(
                f"{name}: daylight of {level:.3g} counts at that depth; give at most 1e6"
            )
        return {"level_counts": float(level)}
    if given := [key for key, value in water.items() if value is not None]:
        raise ValueError(f"{name}.{given[0]}: belongs to surface_counts and depth_m; leave it out")
    return settings


def ambient(
    array: DetectorArray,
    *,
    level_counts: Annotated[
        float | None, Quantity("reading by daylight alone, without demodulation", "counts", 0, 1e6)
    ] = None,
    surface_counts: Annotated[
        float | None,
        Quantity(
            "reading by daylight alone at the surface, without demodulation", "counts", 0, 1e12
        ),
    ] = None,
    depth_m: Annotated[
        float | None, Quantity("depth of the array below the surface", "m", 0, 11_000)
    ] = None,
    k_per_m: KPerM = None,
    water: Water | None = None,
    wavelength_nm: WavelengthNm = None,
) -> Background:
    """Let daylight reach every detector alike (L_b of Eren et al. 2016, eq. 5).

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
    mirrored = np.pad(np.eye(side), ((reach, reach), (0, 0)), mode="symmetric")
    return np.asarray(sum(w * mirrored[i : i + side] for i, w in enumerate(weights)))


def forward_scatter(
    array: DetectorArray,
    *,
    window_m: Annotated[
        float, Quantity("full width of the Hanning window on the array", "m", 1e-3, 10)
    ],
) -> Blur:
    """Blur the image with a two-dimensional Hanning window (Eren et al. 2016, eq. 6).

    The paper's window of 11 samples, its end points zero, at 0.02 m is 0.2 m wide.
    """
    return Blur(hanning_blur(array.side, array.spacing_m, window_m))
