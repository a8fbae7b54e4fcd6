"""Readings of a room, of one photodiode below several lamps: parts of ``study measured``.

The frame ``beacon`` has its x up, so that lamps under a ceiling shine along its -x, and the
photodiode looks up. Readings of some runs calibrate lamps and noise; the others are estimated.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.calibration.fit.noise_fit import noise_of
from uuv_optical_array.calibration.likelihood.parameters import AIM_NAMES
from uuv_optical_array.calibration.result import Calibration
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage import tables
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.layouts.detectors import (
    Detectors,
    Layout,
    layout_of,
    number_in,
)
from uuv_optical_array.recording.places import LEAST_STD

FILE, LAMPS = "places_rss.csv", 4
HEIGHT_M = 2.4  # of the lamps above the photodiode
FULL = 7000.0  # counts of a reading of 1: the brightest are a thousand
LEARN, CLEAR = (1,), (3, 5)  # runs without an obstacle, to calibrate and to estimate
SHADED = (0, 2, 4)  # and those with one
NOISE = {"sigma_counts": 10.0, "relative": 0.03}  # to begin with
FLOOR_STD, PLACE_STD_M = 100.0, 0.5  # of what is not known of a lamp
# Off the lamp, of places where patterns matter, and between those whose residuals are compared.
NEAR_M, PATTERN_M = 1.6, 1.0
PHOTODIODE = Detectors(("pd",), np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]), np.ones(1))
WIDTH_M, SIDE = 0.8, 5  # of a virtual array
ANGLES_DEG = (0, 15, 30, 45, 60)  # off the axis, of the residuals
# Lamps and photodiode are level, and their light is in air.
HELD = "attenuation.k_per_m", "field_of_view.cosine_power", *AIM_NAMES


class Room(NamedTuple):
    """Places of the photodiode, m, ``(m, 2)``, with readings of each lamp, counts, ``(m, 4)``."""

    runs: Array
    places: Array
    readings: Array

    def of(self, runs: Sequence[int]) -> "Room":
        """Return what was read in some runs."""
        kept = np.isin(self.runs, runs)
        return Room(*(each[kept] for each in self))


class Pattern(NamedTuple):
    """What residuals at places near each other have in common: light that walls return.

    Their correlation is the share, in [0, 1], times a Gaussian of the distance, of this length, m.
    """

    share: float
    length_m: float


class Lamp(NamedTuple):
    """A lamp by readings of one photodiode.

    - place: in the plane, m, ``(2,)``.
    - channel: its column of the readings.
    - found: its calibration, with floor and noise.
    - pattern: of what is called noise.
    - off: mean residuals by the angle off its axis, as a share of the reading.
    """

    place: Array
    channel: int
    found: Calibration
    pattern: Pattern
    off: list[float]

    @property
    def floor(self) -> float:
        """Counts that are read wherever the photodiode is: light from walls."""
        return self.found.scene.lamp.floor_counts

    @property
    def noise(self) -> tuple[float, float]:
        """Noise of readings, counts, and as a share of them."""
        sigma, relative = noise_of(self.found.scene).tolist()
        return sigma, relative


def read_room(path: Path) -> Room:
    """Read run, x and y in m, and single readings of four lamps, in the columns 1 to 7.

    Their names may be in the first row, or in a comment.
    """
    table = tables.rows(path)
    if table and not all(map(tables.number, table[0][1][: 3 + LAMPS])):
        del table[0]
    rows = [
        [number_in(cell, f"{path}: line {line}") for cell in cells[: 3 + LAMPS]]
        for line, cells in table
    ]
    if not rows or any(len(row) < 3 + LAMPS for row in rows):
        raise ValueError(f"{path}: give run, x, y and the readings of {LAMPS} lamps in each line")
    values = np.array(rows, dtype=float)
    return Room(values[:, 0], values[:, 1:3], FULL * values[:, 3 : 3 + LAMPS])


def scene_of(**changes: Any) -> Scene:
    """Return the scene of the room in air, with one lamp; groups are replaced by `changes`."""
    settings: dict[str, Any] = {
        "lamp": {"beam_sigma_deg": 50.0, "reference_counts": 900.0, "reference_range_m": HEIGHT_M},
        "array": {"shape": "planar", "detectors_per_side": SIDE, "width_m": WIDTH_M, "bow_m": 0.0},
        "effects": {
            "attenuation": {"k_per_m": 0.0},
            "sensor_noise": NOISE,
            "saturation": {"level_counts": 2 * FULL},
            "demodulation": {"waveform": "square", "pedestal_counts": 0.0},
        },
        "table": {
            "x_m": [-3.4, -1.4, 9],
            "y_m": [-1.4, 1.4, 13],
            "z_m": [-1.4, 1.4, 13],
            "pitch_deg": [-25.0, 25.0, 9],
            "yaw_deg": [-25.0, 25.0, 9],
        },
        "prior": {"known": "as_bought", "k_std_per_m": 0.0, "lamp_floor_std_counts": FLOOR_STD},
    }
    return scene_from_settings(settings | changes, "room")


def poses_below(places: Array, origin: Array) -> Array:
    """Return the poses of a level photodiode at places below an origin in the plane."""
    poses = np.zeros((len(places), 5))
    poses[:, 0], poses[:, 1:3] = -HEIGHT_M, places - origin
    return poses


def lamp_of(room: Room, i: int) -> Lamp:
    """Return a lamp by the runs that a room has.

    All poses share an error, which is that of the lamp's place.
    """
    readings = room.readings[:, i]
    start = room.places[readings.argmax()]
    poses, layout = poses_below(room.places, start), layout_of(scene_of(), PHOTODIODE)
    found = calibrate(
        layout.scene,
        layout.images(readings[:, None, None]),
        poses,
        hold=HELD,
        pose_std=[LEAST_STD, PLACE_STD_M, PLACE_STD_M, LEAST_STD, LEAST_STD],
        fit_noise=True,
        places=np.zeros(len(poses)),
        array=layout.array,
    )
    place = start - found.shifts[0, 1:3]
    light = (
        Layout(found.scene, PHOTODIODE, layout.array)
        .model()
        .light(poses_below(room.places, place))[:, 0, 0]
    )
    sigma, relative = noise_of(found.scene).tolist()
    near = np.linalg.norm(room.places - place, axis=1) < NEAR_M
    residuals = (readings - light) / np.hypot(sigma, relative * light)
    pattern = pattern_of(room.places[near], residuals[near])
    angles = np.degrees(np.arctan2(np.linalg.norm(room.places - place, axis=1), HEIGHT_M))
    bins, off = np.digitize(angles, ANGLES_DEG), (readings - light) / light
    means = [float(off[bins == k].mean()) for k in range(1, len(ANGLES_DEG))]
    return Lamp(place, i, found, pattern, means)


def pattern_of(places: Array, residuals: Array) -> Pattern:
    """Return what residuals, in standard deviations, have in common, by all pairs of places."""
    i, k = np.triu_indices(len(places), 1)
    apart = np.linalg.norm(places[i] - places[k], axis=1)
    near = apart < PATTERN_M
    products = (residuals[i] * residuals[k])[near] / np.mean(residuals**2)

    def off(at: Array) -> Array:
        return np.asarray(at[0] * np.exp(-0.5 * (apart[near] / at[1]) ** 2) - products)

    found = least_squares(off, (0.2, 0.5), bounds=((0.0, 0.1), (1.0, PATTERN_M))).x
    return Pattern(*found.tolist())
