"""The light at very many poses, without slopes, as a signature table needs it.

Its loops run over the poses, one detector after the other: to NumPy each is a few operations on
long rows, and Numba makes vectors of it (see `core.numerics.elementwise`).
"""

import math
from typing import Any

import numpy as np
from numpy import sqrt

from uuv_optical_array.core.geometry import PITCH, YAW, Array, X, Y, Z, dot, in_body, rotation
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.elementwise import choose, cos, indices, law, sin, total
from uuv_optical_array.forward.effects.water import beer_exponent
from uuv_optical_array.forward.lamp.lamps import (
    AXIS_PITCH,
    AXIS_YAW,
    PLACE_X,
    PLACE_Y,
    PLACE_Z,
    SHARE,
    SIGMA,
)
from uuv_optical_array.forward.light import (
    ALONG,
    HALF_SQUARE,
    INCIDENCE,
    INVERSE,
    RANGE,
    gaussian,
    lambert,
    lamp_light,
    ray,
    to_nearer_end,
)
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.optics import BEER, Optics, transmit
from uuv_optical_array.forward.scattering import joined, scattered_light, weighed

RAYS = ALONG + 1  # rows of the rays


def see_lamp(place: Any, axis: Any, poses: Any, lamps: Any) -> None:
    """Write where level followers see a lamp and its axis, six components, shape ``(6, m)``.

    Place and axis are three numbers each, in ``beacon``; the poses are ``(5, m)``.
    """
    x, y, z = place
    for i in indices(poses.shape[1]):
        rows = rotation(poses[PITCH, i], poses[YAW, i], 0.0)
        to = x - poses[X, i], y - poses[Y, i], z - poses[Z, i]
        lamps[0, i], lamps[1, i], lamps[2, i] = in_body(rows, to)
        lamps[3, i], lamps[4, i], lamps[5, i] = in_body(rows, axis)


def follow_light(place: Any, normal: Any, lamps: Any, rays: Any) -> None:
    """Write the `ray` from where each follower sees the lamp to a detector."""
    x, y, z = place
    for i in indices(lamps.shape[1]):
        to = lamps[0, i] - x, lamps[1, i] - y, lamps[2, i] - z
        axis = lamps[3, i], lamps[4, i], lamps[5, i]
        range_m, inverse, half_sine_squared, cosine, _, along_m = ray(to, normal, axis)
        rays[RANGE, i], rays[INVERSE, i], rays[INCIDENCE, i] = range_m, inverse, cosine
        relation, squared = to_nearer_end(half_sine_squared)
        rays[ALONG, i], rays[HALF_SQUARE, i] = along_m, 0.5 * squared * relation * relation
    behind = 0.0
    for i in indices(lamps.shape[1]):
        behind += total(choose(rays[ALONG, i] < 0, 1.0, 0.0))
    if behind > 0:  # few poses of a table are, and a root takes as long as 24 products
        for i in indices(lamps.shape[1]):
            half_square = rays[HALF_SQUARE, i]
            other = math.pi - sqrt(2 * half_square)
            rays[HALF_SQUARE, i] = choose(rays[ALONG, i] < 0, 0.5 * other * other, half_square)


def shine_clear(
    rays: Any, power: Any, sigma_rad: Any, gaussians: Any, k_per_m: float, light: Any
) -> None:
    """Write the light of rays, shape ``(1, m)``, in water that does not scatter, by Beer's law."""
    weights, widths = gaussians[0], gaussians[1]
    for i in indices(rays.shape[1]):
        beam = rays[HALF_SQUARE, i], sigma_rad, weights[0], widths[0]
        light[0, i], _ = gaussian(*beam, beer_exponent(rays[RANGE, i], k_per_m))
    for k in range(1, len(weights)):
        weight, width = weights[k], widths[k]
        for i in indices(rays.shape[1]):
            exponent = beer_exponent(rays[RANGE, i], k_per_m)
            part, _ = gaussian(rays[HALF_SQUARE, i], sigma_rad, weight, width, exponent)
            light[0, i] += part
    for i in indices(rays.shape[1]):
        to_lamp = rays[INVERSE, i], rays[HALF_SQUARE, i], rays[INCIDENCE, i]
        light[0, i], _, _, _ = lamp_light(*to_lamp, power, sigma_rad, light[0, i], 0.0)


def shine_scattered(
    rays: Any,
    normal: Any,
    lamps: Any,
    power: Any,
    sigma_rad: Any,
    gaussians: Any,
    scattering_per_m: Any,
    light: Any,
) -> None:
    """Write the same in water that scatters, and the incidence there."""
    weights, widths, advances = gaussians[0], gaussians[1], rays[RAYS]
    for i in indices(rays.shape[1]):
        angle, depth = angle_at(rays, i), scattering_per_m * rays[RANGE, i]
        source = weighed(angle, sigma_rad, depth, weights[0], widths[0])
        light[0, i], advances[i] = source[0], source[4]
    for k in range(1, len(weights)):
        weight, width = weights[k], widths[k]
        for i in indices(rays.shape[1]):
            angle, depth = angle_at(rays, i), scattering_per_m * rays[RANGE, i]
            further = weighed(angle, sigma_rad, depth, weight, width)
            source = joined(source_of(light[0, i], advances[i]), further)
            light[0, i], advances[i] = source[0], source[4]
    for i in indices(rays.shape[1]):
        range_m, angle = rays[RANGE, i], angle_at(rays, i)
        source = source_of(light[0, i], advances[i])
        axial = dot((lamps[3, i], lamps[4, i], lamps[5, i]), normal)
        to_lamp = range_m, rays[INVERSE, i], angle, rays[INCIDENCE, i], axial
        (flux, _, _, _, _), (incidence, _, _, _, _, _) = scattered_light(
            *to_lamp, power, sigma_rad, scattering_per_m, source
        )
        facing, _ = lambert(incidence)
        light[0, i], rays[INCIDENCE, i] = flux * facing, incidence


@law
def angle_at(rays: Any, i: Any) -> tuple[Any, Any, Any]:
    """Return the angle off the axis of ray i, as of `scattered_light`, for light without slopes."""
    return rays[HALF_SQUARE, i], rays[ALONG, i] * rays[INVERSE, i], 1.0


@law
def source_of(strength: Any, advance: Any) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
    """Return where light seems to come from, as of `scattering.core_and_halo`, without slopes."""
    return strength, 0.0, 0.0, 0.0, advance, 0.0, 0.0, 0.0


def write_arriving(optics: Optics, poses: Any, light: Any) -> None:
    """Write the light of each lamp at each detector, before what the array does to it.

    - optics: of the scene, without nuisances.
    - poses: of level followers, components first, m and rad, shape ``(5, m)``.
    - light: result, counts, shape ``(L n, m)``.
    """
    detectors, n, m = optics.detectors, optics.detectors.shape[1], poses.shape[1]
    lamps, rays = np.empty((6, m)), np.empty((RAYS + 1, m))
    settings, k_per_m = optics.law_settings, 0.0
    for q in range(len(optics.laws)):
        if optics.laws[q] == BEER:
            k_per_m += settings[q, 0]
    for i in range(optics.lamps.shape[1]):
        at = optics.lamps[:, i]
        pitch, yaw = at[AXIS_PITCH], at[AXIS_YAW]
        axis = -cos(yaw) * cos(pitch), -sin(yaw) * cos(pitch), sin(pitch)
        see_lamp((at[PLACE_X], at[PLACE_Y], at[PLACE_Z]), axis, poses, lamps)
        lamp = optics.power * at[SHARE], at[SIGMA]
        for k in range(n):
            place = detectors[0, k], detectors[1, k], detectors[2, k]
            normal = detectors[3, k], detectors[4, k], detectors[5, k]
            own = light[i * n + k : i * n + k + 1]
            follow_light(place, normal, lamps, rays)
            if optics.scattering_per_m > 0:
                shine_scattered(
                    rays, normal, lamps, *lamp, optics.gaussians, optics.scattering_per_m, own
                )
            else:
                shine_clear(rays, *lamp, optics.gaussians, k_per_m, own)
            for q in range(len(optics.laws)):
                if optics.laws[q] != BEER or optics.scattering_per_m > 0:
                    a, b, c = settings[q, 0], settings[q, 1], settings[q, 2]
                    transmit(optics.laws[q], rays, a, b, c, own, 0, False)


def expected_readings(model: ForwardModel, optics: Optics, poses: Array) -> Array:
    """Return the `ForwardModel.expected` images of level poses ``(m, 5)``, as ``(L n, m)``.

    The optics are those of the model, without nuisances. It runs as compiled where `prepare` was
    called in this process, with the same result to rounding.
    """
    rows = optics.lamps.shape[1] * optics.detectors.shape[1]
    readings: Array = np.empty((rows, len(poses)))
    with np.errstate(under="ignore"):  # light too dim for a float64 counts as none
        write = compilation.loaded(write_arriving)
        write(optics, np.ascontiguousarray(poses.T), readings)
    if len(optics.step_kinds):
        images = model.on_array(readings.T.reshape(-1, *model.image_shape))
        readings = np.ascontiguousarray(images.reshape(len(poses), -1).T)
    return np.minimum(readings, model.saturation_counts, out=readings)


def prepare(model: ForwardModel) -> None:
    """Compile, or load, what `expected_readings` runs from then on in this process."""
    poses, light = np.zeros((5, 1)), np.empty((model.image_shape[0] * model.image_shape[1], 1))
    compilation.prepare(write_arriving, model.optics(), poses, light)
