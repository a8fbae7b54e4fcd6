"""Coordinates of the pose in which an image is nearly linear.

In ``(x, y, z, pitch, yaw)`` the poses that explain an image lie along a bent valley, far narrower
than the bend: the array knows where it sees the lamp, and how bright, much better than where in the
beam it floats. So the coordinates are the lamp's azimuth and elevation from the array's centre,
pitch, yaw and the attenuation ``ln r + K r / 2 + eta^2 / (4 sigma^2)``, half the logarithm of what
distance, water and beam take from the light there. In them an image is nearly quadratic: fits
converge in few steps, and a Gaussian is their posterior. A beam of three Gaussians takes from the
logarithm of the light what it does in the table's middle, and sigma is where that is 1/2.

A planar array cannot separate the direction to the lamp from that of its beam. It sees how the
light falls off across it: near the axis ``s (a - b) + 3 a`` in units of the range, with the
azimuths a of the lamp and b of the beam's source direction and ``s = 1 / sigma^2``. So its azimuth
is ``a - b s / (s + 3)``, its elevation likewise, and its attenuation includes Lambert's cosine.

All functions take numbers, or components of many poses at once.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy import arctan2, cos, hypot, log, sin, sqrt

from uuv_optical_array.core.geometry import PITCH, YAW, Array, dot, lamp_in_body, pitched, rotation
from uuv_optical_array.core.numerics.elementwise import (
    choose,
    exp,
    law,
    maximum,
    minimum,
    stack,
)
from uuv_optical_array.forward.lamp.beam import UNIT, angle_of
from uuv_optical_array.forward.lamp.lamps import SIGMA
from uuv_optical_array.forward.light import off_axis, radiance
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scattering import scattered_light, weighed

AZIMUTH, ELEVATION, LOG_ATTENUATION = range(3)  # then pitch and yaw, as in the pose
LEAST_BEAM = 1e-290  # radiance over that on the axis, whose logarithm is still a number
LEAST_FACING = 1e-3  # cosine of incidence of a lamp almost beside a planar array


class CoordinateFrame(NamedTuple):
    """What the coordinates depend on: the array's centre in ``base_link``, m, beam and water.

    `share` is ``s / (s + 3)`` if planar, else 0; `scattered_per_m` is the part of K by scattering.
    """

    centre_x: float
    centre_y: float
    centre_z: float
    beam_sigma_rad: float
    k_per_m: float
    share: float
    scattered_per_m: float = 0.0
    gaussians: Array = UNIT


def frame_of(model: ForwardModel) -> CoordinateFrame:
    """Return the frame of the coordinates of a model's scene.

    In water that scatters, attenuation and width are those of the light in the table's middle.
    """
    scene, optics = model.scene, model.optics()
    sigma, (_, absorption) = float(optics.lamps[SIGMA].mean()), scene.attenuation
    parts = [(weight, 0.0, width * sigma) for weight, width in optics.gaussians.T.tolist()]
    if optics.scattering_per_m > 0:
        range_m = max(abs(scene.table.x_m.start + scene.table.x_m.stop) / 2, 1.0)
        per_m, on_axis = optics.scattering_per_m, (0.0, 1.0, 1.0)
        fluxes = []
        for _, _, width in parts:
            source = weighed(on_axis, width, per_m * range_m, 1.0, 1.0)
            to_lamp = range_m, 1 / range_m, on_axis, 1.0, -1.0
            light, _ = scattered_light(*to_lamp, 1.0, width, per_m, source)
            fluxes.append(light)
        parts = [
            (part[0] * float(flux[0]), -float(flux[1] + 2 / range_m), float((-flux[2]) ** -0.5))
            for part, flux in zip(parts, fluxes, strict=True)
        ]
    whole = sum(light for light, _, _ in parts)
    scattered = sum(light / whole * lost for light, lost, _ in parts)
    gaussians = np.array([[light / whole, width] for light, _, width in parts]).T.copy()
    sigma = angle_of(gaussians, 1.0)
    gaussians[1] /= sigma
    planar = model.scene.array.shape == "planar"
    x, y, z = model.array.positions.mean(axis=0).tolist()
    share = 1 / (1 + 3 * sigma**2) if planar else 0.0
    k_per_m = absorption + scattered
    return CoordinateFrame(x, y, z, sigma, k_per_m, share, scattered, gaussians)


@law
def attenuated_range(log_attenuation: Any, k_per_m: float) -> Any:
    """Solve ``ln r + K r / 2 = log_attenuation`` for r, m, from a millimetre to 100 km.

    With ``w = K r / 2`` this is Wright's omega function, ``w + ln w = known`` (F. Fritsch,
    R. Shafer and W. Crowley, 1973, Comm. ACM 16, 123, whose iteration this is).
    """
    half_k = maximum(0.5 * k_per_m, 1e-12)
    target = minimum(maximum(log_attenuation, -7.0), 12.0) + log(half_k)
    above = target - log(maximum(target, 1.0))
    w = choose(target > 2.0, above, 0.5671 + 0.3620 * target)
    w = choose(target < -1.0, exp(target), w)
    for _ in range(3):
        left = target - w - log(w)
        ahead = 1 + w
        wide = 2 * ahead * (ahead + 2 / 3 * left)
        w = w * (1 + left / ahead * (wide - left) / (wide - 2 * left))
    return w / half_k


@law
def directions(x: Any, y: Any, z: Any) -> tuple[Any, Any]:
    """Return azimuth and elevation of a vector, rad."""
    return arctan2(y, x), arctan2(z, hypot(x, y))


def sight_angles(frame: CoordinateFrame, at: Any, source: Any) -> tuple[Any, Any]:
    """Return azimuth and elevation of the lamp seen from the array's centre, rad."""
    azimuth, elevation = at[AZIMUTH], at[ELEVATION]
    if frame.share > 0:
        source_azimuth, source_elevation = directions(*source)
        azimuth = azimuth + frame.share * source_azimuth
        elevation = elevation + frame.share * source_elevation
    return azimuth, elevation


@law
def off_beam(sight: Any, source: Any) -> tuple[Any, Any]:
    """Return half the squared angle off the axis of unit vectors, and the angle over its sine."""
    cosine = dot(sight, source)
    off_x, off_y = sight[0] - cosine * source[0], sight[1] - cosine * source[1]
    off = off_x, off_y, sight[2] - cosine * source[2]
    return off_axis(cosine, 0.5 * dot(off, off) / (1 + abs(cosine)), 1.0)


def from_centre(frame: CoordinateFrame, lamp: Any) -> tuple[Any, Any, Any, Any]:
    """Return where a lamp is from the array's centre, three components, and its range, m."""
    x, y, z = lamp[0] - frame.centre_x, lamp[1] - frame.centre_y, lamp[2] - frame.centre_z
    return x, y, z, maximum(sqrt(x * x + y * y + z * z), 1e-9)


def beam_loss(frame: CoordinateFrame, sight: Any, source: Any) -> tuple[Any, Any, Any]:
    """Return half of what the beam takes from the logarithm of the light, of unit vectors.

    It is ``eta^2 / (4 sigma^2)`` of one Gaussian. Then come its slopes by -cos(eta) and ln(eta).
    """
    half_square, turn = off_beam(sight, source)
    slope = 0.5 / (frame.beam_sigma_rad * frame.beam_sigma_rad)
    loss = slope * half_square
    if frame.gaussians.shape[1] > 1:
        beam, by_half_square = radiance(half_square, frame.beam_sigma_rad, frame.gaussians)
        loss, slope = -0.5 * log(maximum(beam, LEAST_BEAM)), -0.5 * by_half_square
    return loss, slope * turn, 2 * slope * half_square


def from_pose(frame: CoordinateFrame, pose: Any, roll: Any) -> Any:
    """Return the coordinates, shape ``(5, ...)``, of a pose with a roll, rad."""
    lamp = lamp_in_body(pose, roll)
    x, y, z, range_m = from_centre(frame, lamp)
    sight = (x / range_m, y / range_m, z / range_m)
    source = (-lamp[3], -lamp[4], -lamp[5])
    loss, _, _ = beam_loss(frame, sight, source)
    azimuth, elevation = directions(*sight)
    log_attenuation = log(range_m) + 0.5 * frame.k_per_m * range_m + loss
    if frame.share > 0:
        source_azimuth, source_elevation = directions(*source)
        azimuth = azimuth - frame.share * source_azimuth
        elevation = elevation - frame.share * source_elevation
        log_attenuation = log_attenuation - 0.5 * log(maximum(sight[0], LEAST_FACING))
    return stack(azimuth, elevation, log_attenuation, pose[3], pose[4])


def to_lamp(frame: CoordinateFrame, at: Any, roll: Any) -> tuple[Any, Any, Any]:
    """Return lamp and pose at coordinates, six and five components.

    The third is the logarithm of the volume of poses, m and rad, over that of the coordinates.
    """
    ahead, aside, above = rotation(at[PITCH], at[YAW], roll)
    azimuth, elevation = sight_angles(frame, at, ahead)
    cos_e = cos(elevation)
    sight = (cos_e * cos(azimuth), cos_e * sin(azimuth), sin(elevation))
    loss, _, _ = beam_loss(frame, sight, ahead)
    log_attenuation = at[LOG_ATTENUATION] - loss
    if frame.share > 0:
        log_attenuation = log_attenuation + 0.5 * log(maximum(sight[0], LEAST_FACING))
    range_m = attenuated_range(log_attenuation, frame.k_per_m)
    x = range_m * sight[0] + frame.centre_x
    y = range_m * sight[1] + frame.centre_y
    z = range_m * sight[2] + frame.centre_z
    to = x, y, z
    pose = -dot(ahead, to), -dot(aside, to), -dot(above, to), at[PITCH], at[YAW]
    level = maximum(abs(cos_e), 1e-9)
    log_volume = log(range_m * range_m * level / (1 / range_m + 0.5 * frame.k_per_m))
    return (x, y, z, -ahead[0], -ahead[1], -ahead[2]), pose, log_volume


def write_slopes(
    frame: CoordinateFrame, at: Any, roll: Any, lamp: Any, slopes: Any, pose_slopes: Any
) -> None:
    """Write slopes of `to_lamp`'s lamp and pose into zeros, ``(6, 5, ...)`` and ``(5, 5, ...)``."""
    rows = rotation(at[PITCH], at[YAW], roll)
    ahead, aside, _ = rows
    x, y, z, range_m = from_centre(frame, lamp)
    sight = (x / range_m, y / range_m, z / range_m)
    by_pitch = pitched((lamp[3], lamp[4], lamp[5]), roll)
    for i in range(3):
        slopes[3 + i, PITCH], slopes[3 + i, YAW] = by_pitch[i], aside[i]
    azimuth, elevation = sight_angles(frame, at, ahead)
    slopes[0, AZIMUTH], slopes[1, AZIMUTH] = -sight[1], sight[0]
    slopes[0, ELEVATION] = -sight[2] * cos(azimuth)
    slopes[1, ELEVATION] = -sight[2] * sin(azimuth)
    slopes[2, ELEVATION] = cos(elevation)
    if frame.share > 0:
        # How the direction of the beam's source, and so that of the lamp, turns.
        level = maximum(hypot(ahead[0], ahead[1]), 1e-6)
        for q in (PITCH, YAW):
            u, v, w = -slopes[3, q], -slopes[4, q], -slopes[5, q]
            swing = frame.share * (ahead[0] * v - ahead[1] * u) / (level * level)
            rise = level * w - ahead[2] / level * (ahead[0] * u + ahead[1] * v)
            rise = frame.share * rise
            for i in range(3):
                slopes[i, q] = slopes[i, AZIMUTH] * swing + slopes[i, ELEVATION] * rise
    _, ratio, _ = beam_loss(frame, sight, ahead)
    facing = 0.0 * range_m
    if frame.share > 0:
        facing = choose(sight[0] > LEAST_FACING, 0.5 / maximum(sight[0], LEAST_FACING), 0.0)
    stretched = 1 / (1 / range_m + 0.5 * frame.k_per_m)
    for q in range(5):
        stretch = facing * slopes[0, q]
        for i in range(3):
            turned = ahead[i] * slopes[i, q] - sight[i] * slopes[3 + i, q]
            stretch = stretch + ratio * turned
        if q == LOG_ATTENUATION:
            stretch = stretch + 1.0
        stretch = stretch * stretched
        for i in range(3):
            slopes[i, q] = range_m * slopes[i, q] + sight[i] * stretch
    # Pitch turns what the body sees, yaw turns about the beacon's z.
    seen = pitched((lamp[0], lamp[1], lamp[2]), roll)
    for i in range(3):
        row = rows[i]
        for q in range(5):
            moved = row[0] * slopes[0, q] + row[1] * slopes[1, q] + row[2] * slopes[2, q]
            if q == PITCH:
                moved = moved - dot(row, seen)
            pose_slopes[i, q] = -moved
    pose_slopes[0, YAW] += dot(aside, lamp)
    pose_slopes[1, YAW] -= dot(ahead, lamp)
    pose_slopes[PITCH, PITCH] += 1.0
    pose_slopes[YAW, YAW] += 1.0
