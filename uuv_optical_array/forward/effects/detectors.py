"""How the detectors of an array differ from ideal ones, and from each other."""

from typing import Annotated, Any

import numpy as np
from numpy import log, sqrt

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.elementwise import choose, exp, law, maximum, minimum
from uuv_optical_array.core.settings import Cells, Grid, Quantity, one_way
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.forms import Background, Gain, Transmission


def resolved_field_of_view(settings: dict[str, Any], name: str) -> dict[str, Any]:
    """Require either a power or a half angle."""
    if not one_way(settings, name, ("cosine_power",), ("half_angle_deg",)):
        settings.pop("edge_deg")
    return settings


@law
def lens(range_m: Any, incidence: Any, power: Any, _b: Any, _c: Any) -> Any:
    """Power of the cosine beyond Lambert's: a `Transmission`."""
    lit = maximum(incidence, 1e-12)
    logarithm = log(lit)
    return exp(power * logarithm), 0.0, power / lit, logarithm


@law
def housing(range_m: Any, cosine: Any, cosine_half: Any, width: Any, _c: Any) -> Any:
    """Cut-off by the rim of a housing, in the cosine: a `Transmission`."""
    beyond = 2 * (cosine_half - cosine) / width
    # As (1 + tanh) / 2, but no digit is lost where next to nothing is left.
    small = exp(-abs(beyond))
    lost = choose(beyond > 0, 1.0, small) / (1 + small)
    return choose(beyond > 0, small, 1.0) / (1 + small), 0.0, 2 * lost / width, 0.0


def field_of_view(
    array: DetectorArray,
    *,
    cosine_power: Annotated[
        float | None,
        Quantity("exponent of the cosine of incidence, with Lambert's 1 included", "", 0.5, 1000),
    ] = None,
    half_angle_deg: Annotated[
        float | None,
        Quantity("angle of incidence at which the rim takes half of the light", "deg", 1, 90),
    ] = None,
    edge_deg: Annotated[
        float, Quantity("width of the cut-off around the half angle", "deg", 0.1, 60)
    ] = 5.0,
) -> Transmission:
    """Let the response to the lamp differ from Lambert's cosine.

    Either as ``cos^p`` of the incidence in all, a generalised Lambertian like that of a lensed
    diode, or by the rim of a housing: half is lost at the half angle and 88 % half an edge further
    out, as a hyperbolic tangent of the cosine, which is smooth.
    """
    if cosine_power is not None:
        return Transmission(lens, (cosine_power - 1, 0.0, 0.0), "field_of_view.cosine_power")
    assert half_angle_deg is not None  # checked with the scene
    half = np.radians(half_angle_deg)
    width = 0.5 * np.radians(edge_deg) * np.sin(half)
    return Transmission(housing, (float(np.cos(half)), float(width), 0.0))


@law
def interface(cosine: Any, before: Any, after: Any) -> tuple[Any, Any, Any, Any]:
    """Refract unpolarised light at a plane (Snell and Fresnel; Born and Wolf 1999, section 1.5).

    From the cosine of incidence, in (0, 1], and the refractive indices follow the transmitted share
    of the flux, 0 under total reflection, and its slope by the cosine; then the cosine behind the
    plane, at least 1e-6, and its slope.
    """
    ratio = before / after
    square = 1 - ratio * ratio * (1 - cosine * cosine)
    refracted = sqrt(maximum(square, 1e-12))
    bent = ratio * ratio * cosine / refracted
    across, along = before * cosine + after * refracted, after * cosine + before * refracted
    # Amplitudes of reflection across the plane of incidence and in it.
    r_across = (before * cosine - after * refracted) / across
    r_along = (after * cosine - before * refracted) / along
    slope_across = (before - after * bent - r_across * (before + after * bent)) / across
    slope_along = (after - before * bent - r_along * (after + before * bent)) / along
    passes = square > 0
    transmission = choose(passes, 1 - 0.5 * (r_across * r_across + r_along * r_along), 0.0)
    slope = choose(passes, -(r_across * slope_across + r_along * slope_along), 0.0)
    return transmission, slope, refracted, bent


@law
def port(range_m: Any, cosine: Any, pane: Any, behind: Any, water: Any) -> Any:
    """Transmission of a flat pane between water and what is behind it: a `Transmission`."""
    lit = minimum(maximum(cosine, 1e-6), 1.0)
    first, first_slope, inside, inside_slope = interface(lit, water, pane)
    second, second_slope, _, _ = interface(inside, pane, behind)
    slope = first_slope / maximum(first, 1e-300)
    slope = slope + second_slope * inside_slope / maximum(second, 1e-300)
    return first * second, 0.0, slope, 0.0


def window(
    array: DetectorArray,
    *,
    index: Annotated[
        float, Quantity("refractive index of the pane: acrylic 1.49, glass 1.52", "", 1.3, 2.5)
    ] = 1.49,
    behind_index: Annotated[
        float,
        Quantity("refractive index behind the pane: air 1, optical gel 1.4 to 1.5", "", 1, 2.5),
    ] = 1.0,
    water_index: Annotated[float, Quantity("refractive index of the water", "", 1.3, 1.4)] = 1.34,
) -> Transmission:
    """Put a flat port in front of each photodiode: Snell's refraction and Fresnel's transmission.

    Unpolarised light, reflected once at each face (Born and Wolf 1999, Principles of Optics).
    Behind a pane with air no light arrives from beyond the critical angle, 48 deg in sea water. The
    thickness of the pane, which shifts the ray by about a millimetre, is neglected.
    """
    return Transmission(port, (index, behind_index, water_index))


def responsivity(
    array: DetectorArray,
    *,
    spread: Annotated[
        float | None, Quantity("relative standard deviation of the gains", "", 0, 0.3)
    ] = None,
    seed: Annotated[
        int | None,
        Quantity("seed of the random gains; another seed gives another array", "", 0, 2**31 - 1),
    ] = None,
    gains: Annotated[
        Grid | None,
        Quantity("gain of each detector, rows from the top, columns from port", "", 0, 100),
    ] = None,
    drift_per_c: Annotated[
        float, Quantity("relative change of the gains with temperature", "1/deg C", -0.1, 0.1)
    ] = -2 / 576,
) -> Gain:
    """Give each detector a gain of its own, and all a drift with temperature.

    The gains are given, as by `uuv_array calibrate`, or drawn once. Eren et al. (2017) measured a
    spread of 0.8 % and -2 mV/C on 576 mV. The nuisance ``responsivity.temperature_c`` is the
    difference to the temperature of calibration, at which the lamp's reference reading holds.
    """
    values = detector_gains(array.side, spread, seed, gains)
    return Gain(values.ravel(), drift_per_c, "responsivity.temperature_c")


def detector_gains(
    side: int, spread: float | None = None, seed: int | None = None, gains: Grid | None = None
) -> Array:
    """Return the gains of `responsivity`, shape ``(side, side)``.

    ValueError where the gains given are not those of ``side * side`` detectors.
    """
    if gains is None:
        assert spread is not None  # checked with the scene
        draws = np.random.default_rng(seed).standard_normal((side, side))
        return np.maximum(1 + spread * draws, 0.0)
    if len(gains) != side:
        raise ValueError(
            f"effects.responsivity.gains: {len(gains)} x {len(gains)} gains, but the array has "
            f"{side} x {side} detectors; give one for each"
        )
    return np.array(gains, dtype=float)


def detector_faults(
    array: DetectorArray,
    *,
    dead: Annotated[
        Cells, Quantity("detectors that see no light, each as [row, column]", "", 0, 500)
    ] = (),
    stuck: Annotated[
        Cells, Quantity("detectors with a constant reading, each as [row, column]", "", 0, 500)
    ] = (),
    stuck_counts: Annotated[
        float, Quantity("reading of the stuck detectors, less any pedestal", "counts", 0, 1e6)
    ] = 0.0,
) -> tuple[Gain, Background]:
    """Let detectors fail: dead ones read darkness, stuck ones a level; row 0 is the top.

    They have no derivative, so an estimator leaves them out of its fit. Readout noise stays.
    """
    works, level = np.ones((array.side, array.side)), np.zeros((array.side, array.side))
    for row, column in (*dead, *stuck):
        if max(row, column) >= array.side:
            raise ValueError(
                f"effects.detector_faults: no detector [{row}, {column}]; "
                f"rows and columns run from 0 to {array.side - 1}"
            )
        works[row, column] = 0.0
    for row, column in stuck:
        level[row, column] = stuck_counts
    return Gain(works.ravel()), Background(level.ravel(), 1.0)
