"""Readings of a room, of one photodiode below several lamps: parts of ``study measured``.

The frame ``beacon`` has its x up, so that lamps under a ceiling shine along its -x, and the
photodiode looks up. Readings of some runs tell lamp, floor and noise; the others are estimated.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from uuv_optical_array.calibration.aims import appearing
from uuv_optical_array.calibration.calibrate import Calibration, calibrate
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage import tables
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.layouts.detectors import (
    Detectors,
    Layout,
    layout_of,
    number_in,
)

FILE, LAMPS = "places_rss.csv", 4
HEIGHT_M = 2.4  # of the lamps above the photodiode
FULL = 7000.0  # counts of a reading of 1: the brightest are a thousand
LEARN, CLEAR = (1,), (3, 5)  # runs without an obstacle, to calibrate and to estimate
SHADED = (0, 2, 4)  # and those with one
NOISE, SHARE = 10.0, 0.034  # counts, and of the reading, to begin with
NEAR_M = 2.5  # off the lamp, of places that calibrate it
PHOTODIODE = Detectors(("pd",), np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]), np.ones(1))
WIDTH_M, SIDE = 0.8, 5  # of a virtual array
ANGLES_DEG = (0, 15, 30, 45, 60)  # off the axis, of the residuals
HELD = (
    "attenuation.k_per_m",
    "field_of_view.cosine_power",
    "array.aim_pitch_rad",
    "array.aim_yaw_rad",
)


class Room(NamedTuple):
    """Places of the photodiode, m, ``(m, 2)``, with readings of each lamp, counts, ``(m, 4)``."""

    runs: Array
    places: Array
    readings: Array

    def of(self, runs: Sequence[int]) -> "Room":
        """Return what was read in some runs."""
        kept = np.isin(self.runs, runs)
        return Room(*(each[kept] for each in self))


class Lamp(NamedTuple):
    """A lamp by readings of one photodiode.

    - place: in the plane, m, ``(2,)``.
    - floor: counts that are read wherever the photodiode is: light from walls.
    - found: the calibration of its light above the floor.
    - noise: of readings, counts, and as a share of them, by the residuals.
    - off: mean residuals by the angle off its axis, as a share of the reading.
    """

    place: Array
    floor: float
    found: Calibration
    noise: tuple[float, float]
    off: list[float]


def read_room(path: Path) -> Room:
    """Read run, x and y in m, and single readings of four lamps, in the columns 1 to 7."""
    _, table = tables.read(path)
    rows = [
        [number_in(cell, f"{path}: line {line}") for cell in list(cells.values())[: 3 + LAMPS]]
        for line, cells in table
    ]
    values = np.array(rows, dtype=float)
    if values.ndim != 2 or values.shape[1] < 3 + LAMPS:
        raise ValueError(f"{path}: give run, x, y and the readings of {LAMPS} lamps in each line")
    return Room(values[:, 0], values[:, 1:3], FULL * values[:, 3 : 3 + LAMPS])


def scene_of(**changes: Any) -> Scene:
    """Return the scene of the room in air, with one lamp; groups are replaced by `changes`."""
    settings: dict[str, Any] = {
        "lamp": {"beam_sigma_deg": 50.0, "reference_counts": 900.0, "reference_range_m": HEIGHT_M},
        "array": {"shape": "planar", "detectors_per_side": SIDE, "width_m": WIDTH_M, "bow_m": 0.0},
        "effects": {
            "attenuation": {"k_per_m": 0.0},
            "sensor_noise": {"sigma_counts": NOISE},
            "saturation": {"level_counts": FULL},
        },
        "table": {
            "x_m": [-3.4, -1.4, 9],
            "y_m": [-1.4, 1.4, 13],
            "z_m": [-1.4, 1.4, 13],
            "pitch_deg": [-25.0, 25.0, 9],
            "yaw_deg": [-25.0, 25.0, 9],
        },
        "prior": {"known": "as_bought", "k_std_per_m": 0.0},
    }
    return scene_from_settings(settings | changes, "room")


def poses_below(places: Array, origin: Array) -> Array:
    """Return the poses of a level photodiode at places below an origin in the plane."""
    poses = np.zeros((len(places), 5))
    poses[:, 0], poses[:, 1:3] = -HEIGHT_M, places - origin
    return poses


def lamp_of(room: Room, i: int) -> Lamp:
    """Return a lamp by the runs that a room has.

    Place and floor, which no scene has, are fitted first, by the inverse square, Lambert's cosine
    and a Gaussian beam; what is left is calibrated as any other light.
    """
    readings = room.readings[:, i]

    def off(at: Array) -> Array:
        square = ((room.places - at[:2]) ** 2).sum(axis=1) + HEIGHT_M**2
        cosine = HEIGHT_M / np.sqrt(square)
        beam = np.exp(-0.5 * (np.arccos(cosine) / at[3]) ** 2)
        light = np.exp(at[2]) / square * cosine * beam + at[4]
        return np.asarray((light - readings) / (NOISE + SHARE * readings))

    start = [*room.places[readings.argmax()], 8.0, 0.8, 50.0]
    place_and_floor = least_squares(off, start, loss="soft_l1").x
    place, floor = place_and_floor[:2], float(place_and_floor[4])
    poses = poses_below(room.places, place)
    near = np.hypot(poses[:, 1], poses[:, 2]) < NEAR_M
    layout = layout_of(scene_of(), PHOTODIODE)
    images = layout.images((readings - floor)[:, None, None])
    # Without daylight in the scene the floor would be it, and little is known of both.
    found = calibrate(
        layout.scene,
        images[near],
        poses[near],
        hold=[*HELD, "ambient.level_counts"],
        fit_noise=True,
        array=layout.array,
    )
    scene = found.scene
    model = Layout(scene, PHOTODIODE, layout.array).model()
    aim = [p.value for p in found.parameters if p.name.startswith("lamp.aim")]
    light = model.light(_aimed(poses, aim))[:, 0, 0]
    residuals = readings - floor - light
    design = np.column_stack([np.ones_like(light), light**2])
    share = max(float(np.linalg.lstsq(design, residuals**2, rcond=None)[0][1]), 1e-6) ** 0.5
    dark = np.sqrt(np.maximum(np.mean(residuals**2) - share**2 * np.mean(light**2), 1.0))
    angles = np.degrees(np.arctan2(np.hypot(poses[:, 1], poses[:, 2]), HEIGHT_M))
    bins = np.digitize(angles, ANGLES_DEG)
    means = [
        float(np.mean(residuals[bins == k] / light[bins == k])) for k in range(1, len(ANGLES_DEG))
    ]
    return Lamp(place, floor, found, (float(dark), share), means)


def _aimed(poses: Array, aim: Sequence[float]) -> Array:
    seen, _, _ = appearing(poses, np.zeros(len(poses)), np.array([*aim, 0.0, 0.0]), 0.0)
    return seen
