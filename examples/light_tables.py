"""Simulate tables of light as people measure it: a rail in a tank, and a vehicle of six detectors.

Run: python3 light_tables.py FOLDER
The same command writes the same tables, as their noise has the seed 1: rail.csv, of one detector
that a rail moves; vehicle.csv and detectors.csv, of six detectors, five of which look aside, and
trajectory.csv, of the vehicle's poses by another clock; dive.csv, of a dive whose depth and heading
its own sensors tell.
"""

import csv
import dataclasses
import sys
from pathlib import Path

import numpy as np

from uuv_optical_array.forward.scene import load_scene, scene_from_settings
from uuv_optical_array.layouts.detectors import Detectors, layout_of, write_detectors

SEED, VOLTS_PER_COUNT = 1, 0.001
# What differs from the scene follow, and is to be found.
LAMP = {"beam_sigma_deg": 9.0, "reference_counts": 700.0}
EFFECTS = {
    "sea": {"absorption_per_m": 0.09, "scattering_per_m": 0.06},
    "sensor_noise": {"sigma_counts": 0.8},
    "adc": {"bits": 14},
    "saturation": {"level_counts": 16383.0},
}
GAINS = [1.0, 1.04, 0.97, 1.02, 0.95, 1.01]
LATE_S = 0.12  # the readings' clock is so late
NEAR_M, FAR_M, STOPS = 1.0, 6.0, 60


def head():
    """Return six detectors, five of which look 35 deg aside."""
    names = ["bow", "port", "starboard", "top", "bottom", "corner"]
    aside = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [0.7, 0.7]]) * np.tan(
        np.radians(35)
    )
    places = np.column_stack([np.full(6, 0.3), 0.05 * aside])
    normals = np.column_stack([np.ones(6), aside])
    return Detectors(
        tuple(names),
        places,
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        np.array(GAINS),
    )


def course(t):
    """Return poses of a vehicle that runs from 2 to 6 m and weaves, m and rad."""
    x = -4 + 2 * np.cos(2 * np.pi * t / 40)
    y, z = 0.5 * np.sin(0.4 * t), 0.45 * np.cos(0.5 * t)
    return np.column_stack([x, y, z, 0.2 * np.sin(0.6 * t), 0.25 * np.cos(0.8 * t)])


def write(name, columns, rows, digits=4):
    """Write a table."""
    with (folder / name).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([f"{value:.{digits}f}" for value in row] for row in rows)


folder = Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
rng = np.random.default_rng(SEED)
settings = load_scene("follow").settings()
settings["lamp"] |= LAMP
settings["effects"] |= EFFECTS
scene = scene_from_settings(settings, "tank")
IN_DEGREES = np.array([1, 1, 1, 180 / np.pi, 180 / np.pi])

# A rail along the axis, and another one 0.3 m aside; at each stop the mean of ten readings.
one = Detectors(("photodiode",), np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]), np.ones(1))
layout = layout_of(scene, one)
model = layout.model()
stops = np.zeros((STOPS, 5))
stops[:, 0] = -np.tile(np.geomspace(NEAR_M, FAR_M, STOPS // 2), 2)
stops[STOPS // 2 :, 1] = 0.3
rail = np.array([layout.readings(model.expose(np.tile(stop, (10, 1)), rng)) for stop in stops])
volts = VOLTS_PER_COUNT * rail.mean(axis=1)[:, 0]
write_detectors(folder / "photodiode.csv", one, "where it is on its carriage, and where it looks")
write("rail.csv", ["x_m", "y_m", "photodiode"], np.column_stack([stops[:, :2], volts]), 5)

# A vehicle, whose poses another system tells by its own clock.
layout = layout_of(scene, head())
model, names = layout.model(), layout.detectors.names
t = np.arange(0, 40, 0.1) + 1.0
volts = VOLTS_PER_COUNT * layout.readings(model.expose(course(t), rng))[:, 0]
write("vehicle.csv", ["time_s", *names], np.column_stack([t + LATE_S, volts]))
told = np.arange(0, 43, 0.05)
poses = course(told) * IN_DEGREES
columns = ["time_s", "x_m", "y_m", "z_m", "pitch_deg", "yaw_deg"]
write("trajectory.csv", columns, np.column_stack([told, poses]), 5)
even = dataclasses.replace(layout.detectors, gains=np.ones(len(names)))
write_detectors(folder / "detectors.csv", even, "as the drawing has them")

# A dive of which depth, heading and a level vehicle are known; x and y are the truth to compare.
t = np.arange(0, 20, 0.2)
dive = course(t + 50)
dive[:, 3] = 0.0
volts = VOLTS_PER_COUNT * layout.readings(model.expose(dive, rng))[:, 0]
columns = ["time_s", *names, "x_m", "y_m", "z_m", "yaw_deg"]
kept = (dive * IN_DEGREES)[:, [0, 1, 2, 4]]
write("dive.csv", columns, np.column_stack([t, volts, kept]), 5)
