"""How the detectors of an array differ from ideal ones, and from each other."""

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Cells, Grid, Quantity, one_way
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.light import Light, Rays


def resolved_field_of_view(settings: dict[str, Any], name: str) -> dict[str, Any]:
    """Require one of the two forms."""
    if not one_way(settings, name, ("cosine_power",), ("half_angle_deg",)):
        settings.pop("edge_deg")
    return settings


def field_of_view(
    array: DetectorArray,
    *,
    cosine_power: Annotated[
        float | None, Quantity("power of the cosine of incidence in all", "", 1, 1000)
    ] = None,
    half_angle_deg: Annotated[
        float | None, Quantity("incidence at which half is lost", "deg", 1, 90)
    ] = None,
    edge_deg: Annotated[float, Quantity("width of the cut-off", "deg", 0.1, 60)] = 5.0,
) -> Callable[[Light, Rays], None]:
    """Narrow the response to the lamp beyond Lambert's cosine.

    Either as ``cos^p`` of the incidence in all, a generalised Lambertian as of a lensed diode, or
    by the rim of a housing: half is lost at the half angle, and nearly all (88 %) half an edge
    further out, by a hyperbolic tangent of the cosine, so that the light keeps a derivative.
    """

    def response(cosine: Array) -> tuple[Array, Array]:
        if cosine_power is not None:
            lit = np.maximum(cosine, 1e-12)
            value = lit ** (cosine_power - 1)
            return value, (cosine_power - 1) * value / lit
        assert half_angle_deg is not None  # checked with the scene
        half = np.radians(half_angle_deg)
        width = 0.5 * np.radians(edge_deg) * np.sin(half)
        inside = np.tanh((cosine - np.cos(half)) / width)
        return 0.5 * (1 + inside), 0.5 * (1 - inside**2) / width

    def step(light: Light, rays: Rays) -> None:
        shape, cosine = light.image.shape, rays.cos_incidence
        value, slope = response(cosine)
        before = light.image.reshape(cosine.shape).copy() if light.derivatives is not None else None
        light.dim(value.reshape(shape))
        if before is not None:
            towards = array.normals.T - (cosine / rays.range_m)[..., None, :] * rays.to_lamp
            by_position = (before * slope / rays.range_m)[..., None, :] * towards
            light.slope_by_position(lambda: by_position.reshape(*shape[:-2], 3, *shape[-2:]))

    return step


def resolved_responsivity(settings: dict[str, Any], name: str) -> dict[str, Any]:
    """Require one of the two forms."""
    one_way(settings, name, ("spread", "seed"), ("gains",))
    return settings


def responsivity(
    array: DetectorArray,
    *,
    spread: Annotated[
        float | None, Quantity("relative standard deviation by detector", "", 0, 0.3)
    ] = None,
    seed: Annotated[
        int | None, Quantity("of the draw: another seed, another array", "", 0, 2**31 - 1)
    ] = None,
    gains: Annotated[
        Grid | None, Quantity("of each detector, rows from the top, columns from port", "", 0, 100)
    ] = None,
    drift_per_c: Annotated[
        float, Quantity("relative change with temperature", "1/deg C", -0.1, 0.1)
    ] = -2 / 576,
) -> Callable[[Light, Rays], None]:
    """Give each detector a gain of its own, and all a drift with temperature.

    The gains are given, as `uuv_array calibrate` finds them, or drawn once. Eren et al. (2017)
    measured a spread of 0.8 % and -2 mV/C on 576 mV. The lamp's reference reading is that of the
    temperature of calibration; the nuisance ``responsivity.temperature_c`` is how much warmer it
    is.
    """
    each = detector_gains(array.side, spread, seed, gains)

    def step(light: Light, rays: Rays) -> None:
        drift = 1 + drift_per_c * light.setting("responsivity.temperature_c", 0.0)
        light.dim(each * drift)
        light.slope_by("responsivity.temperature_c", lambda: light.image * (drift_per_c / drift))

    return step


def detector_gains(
    side: int,
    spread: float | None = None,
    seed: int | None = None,
    gains: Grid | None = None,
) -> Array:
    """Return the gain of each detector as `responsivity` has it, shape ``(side, side)``.

    Parameters
    ----------
    side
        Detectors in a row.
    spread, seed, gains
        As in `responsivity`.

    Raises
    ------
    ValueError
        Where the gains are not those of ``side * side`` detectors.
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
    dead: Annotated[Cells, Quantity("detectors that see no light, [row, column]", "", 0, 500)] = (),
    stuck: Annotated[Cells, Quantity("detectors with one reading, [row, column]", "", 0, 500)] = (),
    stuck_counts: Annotated[float, Quantity("that reading", "counts", 0, 1e6)] = 0.0,
) -> Callable[[Light, Rays], None]:
    """Let detectors fail: dead ones read darkness, stuck ones a level; row 0 is the top.

    An estimator that believes the scene leaves them out of its fit: they have no derivative. The
    noise of the readout stays.
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

    def step(light: Light, rays: Rays) -> None:
        light.dim(works)
        light.image += level

    return step
