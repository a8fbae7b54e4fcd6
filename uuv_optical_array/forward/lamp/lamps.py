"""Several lamps on the leader that a modulation separates, each with a place and an axis.

The lamp of the scene says how much light they give together and how wide their beams are. An image
of several lamps holds the image of each by itself, one below the other.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from statistics import fmean
from typing import Annotated, Any

import numpy as np
from numpy import cos, sin

from uuv_optical_array.core.geometry import PITCH, YAW, Array, in_body, pitched, rotation
from uuv_optical_array.core.numerics.elementwise import law
from uuv_optical_array.core.settings import Quantity, check_all

MOST_LAMPS = 8
# Rows of the lamps in numbers, and of where their unknown settings are among the nuisances.
PLACE_X, PLACE_Y, PLACE_Z, AXIS_PITCH, AXIS_YAW, SHARE, SIGMA = range(7)
TURN = 5  # of all lamps together about the beacon's x: a roll of the follower, in effect
GEOMETRY = 6
DEGREE = math.pi / 180
# The least by which two lamps have to differ, m and deg, for their images to do so.
APART_M, APART_DEG = 0.01, 0.1


@dataclass(frozen=True)
class BeaconLamp:
    """One of several lamps: its frame in ``beacon``, whose -x is the beam's axis, and its share."""

    x_m: Annotated[float, Quantity("position ahead of the beacon's origin", "m", -10, 10)] = 0.0
    y_m: Annotated[float, Quantity("position to port of the beacon's origin", "m", -10, 10)] = 0.0
    z_m: Annotated[float, Quantity("position above the beacon's origin", "m", -10, 10)] = 0.0
    pitch_deg: Annotated[
        float, Quantity("pitch of the beam; a positive one turns it up", "deg", -45, 45)
    ] = 0.0
    yaw_deg: Annotated[
        float, Quantity("yaw of the beam; a positive one turns it to starboard", "deg", -45, 45)
    ] = 0.0
    power: Annotated[float, Quantity("power relative to the other lamps", "", 1e-3, 1e3)] = 1.0
    beam_sigma_deg: Annotated[
        float | None,
        Quantity("standard deviation of the beam; null: that of the scene's lamp", "deg", 0.1, 90),
    ] = None
    floor_counts: Annotated[
        float,
        Quantity(
            "reading by the light of this lamp that arrives from all directions", "counts", 0, 1e6
        ),
    ] = 0.0


def ring_of_lamps(
    *,
    lamps: Annotated[int, Quantity("number of lamps", "", 1, MOST_LAMPS)],
    spread_m: Annotated[float, Quantity("distance of each lamp from the centre", "m", 0, 10)],
    tilt_deg: Annotated[float, Quantity("tilt of each lamp's axis, outwards", "deg", 0, 45)],
) -> tuple[BeaconLamp, ...]:
    """Return lamps of equal power, evenly on a ring from its top on; none for one lamp."""
    if lamps == 1:
        return ()
    return tuple(
        BeaconLamp(
            y_m=spread_m * math.sin(turn),
            z_m=spread_m * math.cos(turn),
            pitch_deg=tilt_deg * math.cos(turn),
            yaw_deg=-tilt_deg * math.sin(turn),
        )
        for turn in np.linspace(0, 2 * math.pi, lamps, endpoint=False).tolist()
    )


def spread_and_tilt(lamps: Sequence[BeaconLamp]) -> tuple[float, float]:
    """Return how far lamps are from the centre, m, and tilted, deg, on the mean, to 1e-3."""
    offsets = [math.hypot(lamp.y_m, lamp.z_m) for lamp in lamps or (BeaconLamp(),)]
    tilts = [math.hypot(lamp.pitch_deg, lamp.yaw_deg) for lamp in lamps or (BeaconLamp(),)]
    return round(fmean(offsets), 3), round(fmean(tilts), 3)


def checked_lamps(values: Any) -> tuple[BeaconLamp, ...]:
    """Return the lamps of a scene's list, none for ``None`` or an empty list.

    ValueError for no list of 2 to 8 lamps, a bad setting, or two lamps that give the same image.
    """
    if values is None or values == []:
        return ()
    if not isinstance(values, list | tuple) or not 2 <= len(values) <= MOST_LAMPS:
        raise ValueError(
            f"lamps: {values!r:.80} is not a list of 2 to {MOST_LAMPS} lamps; for one lamp "
            "leave it out"
        )
    lamps = tuple(
        BeaconLamp(**check_all(BeaconLamp, value, f"lamps[{i}]")) for i, value in enumerate(values)
    )
    numbers = lamps_in_numbers(lamps, 0.0)
    for i, k in combinations(range(len(lamps)), 2):
        off = np.abs(numbers[:, i] - numbers[:, k])
        turned, wider = np.degrees(off[[AXIS_PITCH, AXIS_YAW, SIGMA]]).max(), off[:AXIS_PITCH].max()
        if wider < APART_M and turned < APART_DEG:
            raise ValueError(
                f"lamps[{k}]: within {APART_M:g} m and {APART_DEG:g} deg of lamps[{i}], so that "
                "both give the same image; move or turn one of them"
            )
    return lamps


def lamps_in_numbers(
    lamps: tuple[BeaconLamp, ...], sigma_rad: float, behind_m: float = 0.0
) -> Array:
    """Return lamps by rows: place, m, pitch and yaw, rad, share, and the beam's sigma, ``(7, L)``.

    Without lamps it is one, `behind_m` behind the origin on its axis, whose beam has the standard
    deviation `sigma_rad`.
    """
    if not lamps:
        return np.array([[behind_m], [0.0], [0.0], [0.0], [0.0], [1.0], [sigma_rad]])
    whole = sum(lamp.power for lamp in lamps)
    rows = [
        (
            *(lamp.x_m, lamp.y_m, lamp.z_m),
            *(math.radians(lamp.pitch_deg), math.radians(lamp.yaw_deg)),
            lamp.power / whole,
            sigma_rad if lamp.beam_sigma_deg is None else math.radians(lamp.beam_sigma_deg),
        )
        for lamp in lamps
    ]
    return np.ascontiguousarray(np.array(rows).T)


def together(images: Array) -> Array:
    """Return the sum of the images of all lamps, shape ``(..., side, side)``."""
    *shape, rows, side = images.shape
    return images.reshape(*shape, rows // side, side, side).sum(axis=-3)


@law
def offset_of(nuisances: Any, place: Any) -> Any:
    """Return the offset of a nuisance by its place; -1: it is known."""
    return nuisances[place] if place >= 0 else 0.0


@law
def turned_back(turn: Any, vector: Any) -> tuple[Any, Any, Any]:
    """Return a vector after a turn about x by minus an angle, rad."""
    x, y, z = vector
    return x, cos(turn) * y + sin(turn) * z, cos(turn) * z - sin(turn) * y


def one_of_lamps(
    lamps: Any,
    places: Any,
    i: int,
    attitude: Any,
    nuisances: Any,
    origin: Any,
    origin_slopes: Any,
    slopes: Any,
    by_geometry: Any,
) -> Any:
    """Return lamp i and its axis in ``base_link``, six components, and write their slopes.

    - lamps: as of `lamps_in_numbers`.
    - places: of the offsets of x, y, z, pitch and yaw of each lamp, m and deg, and of the turn of
      all, rad, among the nuisances, shape ``(6, L)``; -1: known.
    - attitude: pitch, yaw and roll of the follower, rad.
    - origin, origin_slopes: of a lamp at the beacon's origin, with slopes by p coordinates, of
      which the fourth and the fifth are pitch and yaw, shape ``(6, p, ...)``.
    - slopes, by_geometry: results, by the coordinates and by what `places` has, shapes ``(6, p,
      ...)`` and ``(6, 6, ...)``; none where p is 0.
    """
    pitch, yaw, roll = attitude
    rows = rotation(pitch, yaw, roll)
    x = lamps[PLACE_X, i] + offset_of(nuisances, places[PLACE_X, i])
    y = lamps[PLACE_Y, i] + offset_of(nuisances, places[PLACE_Y, i])
    z = lamps[PLACE_Z, i] + offset_of(nuisances, places[PLACE_Z, i])
    pitch = lamps[AXIS_PITCH, i] + DEGREE * offset_of(nuisances, places[AXIS_PITCH, i])
    yaw = lamps[AXIS_YAW, i] + DEGREE * offset_of(nuisances, places[AXIS_YAW, i])
    turn = offset_of(nuisances, places[TURN, i])
    sin_p, cos_p, sin_y, cos_y = sin(pitch), cos(pitch), sin(yaw), cos(yaw)
    place = turned_back(turn, (x, y, z))
    axis = turned_back(turn, (-cos_y * cos_p, -sin_y * cos_p, sin_p))
    here, along = in_body(rows, place), in_body(rows, axis)
    if slopes.shape[1] > 0:
        ahead, aside, _ = rows
        swung, leant = pitched(here, roll), pitched(along, roll)
        up = in_body(rows, turned_back(turn, (cos_y * sin_p, sin_y * sin_p, cos_p)))
        side = in_body(rows, turned_back(turn, (sin_y * cos_p, -cos_y * cos_p, 0.0)))
        by_y = in_body(rows, turned_back(turn, (0.0, 1.0, 0.0)))
        by_z = in_body(rows, turned_back(turn, (0.0, 0.0, 1.0)))
        moved = in_body(rows, (0.0, place[2], -place[1]))
        leaning = in_body(rows, (0.0, axis[2], -axis[1]))
        for k in range(3):
            for q in range(slopes.shape[1]):
                slopes[k, q] = origin_slopes[k, q]
            slopes[k, PITCH] += swung[k]
            slopes[3 + k, PITCH] = leant[k]
            # Yaw turns about the beacon's z.
            slopes[k, YAW] += ahead[k] * place[1] - aside[k] * place[0]
            slopes[3 + k, YAW] = ahead[k] * axis[1] - aside[k] * axis[0]
            by_geometry[k, PLACE_X], by_geometry[k, PLACE_Y] = ahead[k], by_y[k]
            by_geometry[k, PLACE_Z] = by_z[k]
            by_geometry[3 + k, AXIS_PITCH] = DEGREE * up[k]
            by_geometry[3 + k, AXIS_YAW] = DEGREE * side[k]
            by_geometry[k, TURN], by_geometry[3 + k, TURN] = moved[k], leaning[k]
    u, v, w = along
    return origin[0] + here[0], origin[1] + here[1], origin[2] + here[2], u, v, w
