"""The light at very many poses, without slopes, as a signature table needs it.

Its loops run over the poses, one detector after the other: to NumPy each is a few operations on
long rows, and Numba makes vectors of it (see `core.numerics.elementwise`).
"""

from typing import Any

import numpy as np
from numpy import cos, sin

from uuv_optical_array.core.geometry import PITCH, YAW, Array, X, Y, Z, in_body, rotation
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.elementwise import indices, law
from uuv_optical_array.forward.lamps import (
    AXIS_PITCH,
    AXIS_YAW,
    PLACE_X,
    PLACE_Y,
    PLACE_Z,
    SHARE,
    SIGMA,
)
from uuv_optical_array.forward.light import (
    INCIDENCE,
    RANGE,
    lambert,
    lamp_light,
    lamp_light_of_three,
    ray,
)
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.optics import Optics, transmit
from uuv_optical_array.forward.scattering import scattered_light, scattered_light_of_three

RAYS = INCIDENCE + 1  # rows of the rays that the laws of transmission read


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


@law
def ray_from(lamps: Any, i: Any, place: Any, normal: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """Follow the light from where follower i sees the lamp to a detector, as `ray`."""
    x, y, z = place
    to = lamps[0, i] - x, lamps[1, i] - y, lamps[2, i] - z
    return ray(to, normal, (lamps[3, i], lamps[4, i], lamps[5, i]))


def shine_clear(
    place: Any, normal: Any, lamps: Any, lamp: Any, gaussians: Any, rays: Any, light: Any
) -> None:
    """Write range, incidence and light of a lamp's rays to a detector in water without scattering.

    The lamp is its power and the beam's sigma, rad; the light has shape ``(1, m)``.
    """
    power, sigma_rad = lamp
    if gaussians.shape[1] == 1:
        for i in indices(lamps.shape[1]):
            range_m, half_square, cosine, _, _, _ = ray_from(lamps, i, place, normal)
            light[0, i], _, _, _, _ = lamp_light(range_m, half_square, cosine, power, sigma_rad)
            rays[RANGE, i], rays[INCIDENCE, i] = range_m, cosine
    else:
        for i in indices(lamps.shape[1]):
            range_m, half_square, cosine, _, _, _ = ray_from(lamps, i, place, normal)
            light[0, i], _, _, _, _ = lamp_light_of_three(
                range_m, half_square, cosine, power, sigma_rad, gaussians
            )
            rays[RANGE, i], rays[INCIDENCE, i] = range_m, cosine


def shine_scattered(
    place: Any,
    normal: Any,
    lamps: Any,
    lamp: Any,
    gaussians: Any,
    scattering_per_m: Any,
    rays: Any,
    light: Any,
) -> None:
    """Write the same as `shine_clear` in water that scatters."""
    power, sigma_rad = lamp
    if gaussians.shape[1] == 1:
        for i in indices(lamps.shape[1]):
            range_m, half_square, cosine, axial, along_m, _ = ray_from(lamps, i, place, normal)
            angle = half_square, along_m / range_m, 1.0  # the last is for slopes alone
            (flux, _, _, _, _), (incidence, _, _, _, _, _) = scattered_light(
                range_m, angle, cosine, axial, power, sigma_rad, scattering_per_m
            )
            facing, _ = lambert(incidence)
            light[0, i] = flux * facing
            rays[RANGE, i], rays[INCIDENCE, i] = range_m, incidence
    else:
        for i in indices(lamps.shape[1]):
            range_m, half_square, cosine, axial, along_m, _ = ray_from(lamps, i, place, normal)
            angle = half_square, along_m / range_m, 1.0
            (flux, _, _, _, _), (incidence, _, _, _, _, _) = scattered_light_of_three(
                range_m, angle, cosine, axial, power, sigma_rad, gaussians, scattering_per_m
            )
            facing, _ = lambert(incidence)
            light[0, i] = flux * facing
            rays[RANGE, i], rays[INCIDENCE, i] = range_m, incidence


def write_arriving(optics: Optics, poses: Any, light: Any) -> None:
    """Write the light of each lamp at each detector, before what the array does to it.

    - optics: of the scene, without nuisances.
    - poses: of level followers, components first, m and rad, shape ``(5, m)``.
    - light: result, counts, shape ``(L n, m)``.
    """
    detectors, n, m = optics.detectors, optics.detectors.shape[1], poses.shape[1]
    lamps, rays = np.empty((6, m)), np.empty((RAYS, m))
    settings = optics.law_settings
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
            if optics.scattering_per_m > 0:
                given = place, normal, lamps, lamp, optics.gaussians, optics.scattering_per_m
                shine_scattered(*given, rays, own)
            else:
                shine_clear(place, normal, lamps, lamp, optics.gaussians, rays, own)
            for q in range(len(optics.laws)):
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
