"""Coordinates of pose and constants together in which many images stay linear.

Range, the lamp's power, the water and the beam's width all change the brightness, which an image
determines: it leaves a narrow, bent valley of range and constants. A filter that corrects them in
metres mistakes the bend for information, a little in every frame, and becomes sure of a wrong
scene. In the fit's coordinates (`coordinates`), with the constants in the attenuation,
``ln r + K r / 2 + eta^2 / (4 sigma^2) - ln(P) / 2``, the valley is straight: an image fixes this
number and next to nothing else of the constants.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation, wrapped
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.elementwise import exp, zeros
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.estimation.unknowns.coordinates import (
    AZIMUTH,
    LOG_ATTENUATION,
    CoordinateFrame,
    beam_loss,
    from_centre,
    from_pose,
    to_lamp,
    write_slopes,
)
from uuv_optical_array.forward.lamp.lamps import DEGREE
from uuv_optical_array.forward.prior import ABSORPTION, ATTENUATION, BEAM_SIGMA, POWER, SCATTERING

LEAST_WIDTH = 0.1  # of the beam, relative to the scene's: no constant makes it narrower


class Joint(NamedTuple):
    """What the coordinates depend on.

    - frame: of the scene, as `coordinates.frame_of` returns it.
    - power, water, width, scattering: places of these constants, from 5 on; -1: known.
    """

    frame: CoordinateFrame
    power: int
    water: int
    width: int
    scattering: int


def frame_with(joint: Joint, at: Any) -> CoordinateFrame:
    """Return the frame of the pose's coordinates under constants, shape ``(5 + q,)``."""
    frame = joint.frame
    k_per_m, sigma = frame.k_per_m, frame.beam_sigma_rad
    if joint.scattering >= 0:
        k_per_m = k_per_m + frame.scattered_per_m * (exp(at[joint.scattering]) - 1)
    if joint.water >= 0:
        k_per_m = max(k_per_m + at[joint.water], 0.0)
    if joint.width >= 0:
        sigma = max(sigma + DEGREE * at[joint.width], LEAST_WIDTH * sigma)
    x, y, z, scattered = frame.centre_x, frame.centre_y, frame.centre_z, frame.scattered_per_m
    share, gaussians = frame.share, frame.gaussians
    return CoordinateFrame(x, y, z, sigma, k_per_m, share, scattered, gaussians)


def write_coordinates(joint: Joint, at: Any, coordinates: Any, slopes: Any) -> None:
    """Write the coordinates of pose and constants to a copy of these, and their slopes by them."""
    own = from_pose(frame_with(joint, at), (at[0], at[1], at[2], at[3], at[4]), 0.0)
    for i in range(5):
        coordinates[i] = own[i]
    if joint.power >= 0:
        coordinates[LOG_ATTENUATION] -= 0.5 * at[joint.power]
    write_place(joint, coordinates, at.copy(), slopes)


def write_place(joint: Joint, coordinates: Any, at: Any, slopes: Any) -> None:
    """Write pose and constants at coordinates, and their slopes by them."""
    frame, own = frame_with(joint, coordinates), coordinates.copy()
    if joint.power >= 0:
        own[LOG_ATTENUATION] += 0.5 * coordinates[joint.power]
    lamp, pose, _ = to_lamp(frame, own, 0.0)
    lamp_slopes, by_pose = zeros(6, 5, own[0]), zeros(5, 5, own[0])
    write_slopes(frame, own, 0.0, lamp, lamp_slopes, by_pose)
    x, y, z, range_m = from_centre(frame, lamp)
    ahead, _, _ = rotation(own[PITCH], own[YAW], 0.0)
    sight = x / range_m, y / range_m, z / range_m
    _, _, swell = beam_loss(frame, sight, ahead)
    for i in range(5):
        at[i] = pose[i]
        for q in range(5):
            slopes[i, q] = by_pose[i, q]
        # If a constant grows and the brightness stays, the range changes.
        gives_way = -by_pose[i, LOG_ATTENUATION]
        if joint.power >= 0:
            slopes[i, joint.power] = -0.5 * gives_way
        if joint.water >= 0:
            slopes[i, joint.water] = 0.5 * range_m * gives_way
        if joint.scattering >= 0:
            scattered = frame.scattered_per_m * exp(coordinates[joint.scattering])
            slopes[i, joint.scattering] = 0.5 * range_m * scattered * gives_way
        if joint.width >= 0:
            slopes[i, joint.width] = -DEGREE * swell / frame.beam_sigma_rad * gives_way


def prepare(constants: Constants) -> None:
    """Compile what `JointCoordinates` run from then on in this process."""
    if constants.frame is None:
        return
    joint, at = Joint(constants.frame, -1, -1, -1, -1), np.ones(5 + len(constants.names))
    for write in (write_place, write_coordinates):
        compilation.prepare(write, joint, at, at.copy(), np.eye(len(at)))


class JointCoordinates:
    """From pose and constants to coordinates and back; the constants stay as they are.

    - frame: as of `Joint`; ``None``: pose and constants themselves, for light linear in them.
    - names: dotted names of the constants; those that do not change the attenuation are left alone.
    """

    def __init__(self, frame: CoordinateFrame | None, names: Sequence[str]) -> None:
        def place(name: str) -> int:
            return 5 + names.index(name) if name in names else -1

        water = max(place(ATTENUATION), place(ABSORPTION))
        places = place(POWER), water, place(BEAM_SIGMA), place(SCATTERING)
        self._joint = Joint(frame, *places) if frame else None
        self._slopes = np.eye(5 + len(names))  # of constants, and of a pose without a frame

    def of(self, at: Array) -> tuple[Array, Array]:
        """Return the coordinates of pose and constants, and the slopes that `place` returns."""
        coordinates, slopes = at.copy(), self._slopes.copy()
        if self._joint is not None:
            compilation.loaded(write_coordinates)(self._joint, at, coordinates, slopes)
        return coordinates, slopes

    def place(self, coordinates: Array) -> tuple[Array, Array]:
        """Return pose and constants, ``(5 + q,)``, and their slopes, ``(5 + q, 5 + q)``."""
        at, slopes = coordinates.copy(), self._slopes.copy()
        if self._joint is not None:
            compilation.loaded(write_place)(self._joint, coordinates, at, slopes)
        return at, slopes

    def difference(self, coordinates: Array, others: Array) -> Array:
        """Return by how much coordinates differ, angles in [-pi, pi], shape ``(5 + q,)``."""
        off = wrapped(coordinates - others, YAW)
        return off if self._joint is None else wrapped(off, AZIMUTH)
