"""The course of a drive, on which studies measure tracks."""

import argparse

import numpy as np

from uuv_optical_array.cli import options
from uuv_optical_array.core.geometry import Array, X
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.working_volume import HIGH, LOW

SWAY = 0.4  # of the working volume's half width, across and in angle
SWAY_RAD_PER_S = (0.1, 0.25)


def course(times_s: Array, duration_s: float, rng: np.random.Generator) -> Array:
    """Return poses ``(n, 5)`` at times since the start: through the volume and back, swaying."""
    poses = np.empty((len(times_s), 5))
    middle, half = (LOW[X] + HIGH[X]) / 2, (HIGH[X] - LOW[X]) / 2
    poses[:, X] = middle - half * np.cos(2 * np.pi * times_s / duration_s)
    phases = np.outer(times_s, rng.uniform(*SWAY_RAD_PER_S, 4)) + rng.uniform(0, 2 * np.pi, 4)
    poses[:, 1:] = SWAY * HIGH[1:] * np.sin(phases)
    return poses


def add_drives(parser: argparse.ArgumentParser, about: str, count: int) -> None:
    """Add the options of how many drives there are, how long, and how often an image is taken."""
    options.add_number(parser, "drives", Quantity(about, "", 1, 1e5), count)
    options.add_number(parser, "seconds", Quantity("duration of a drive", "s", 10, 3600), 60.0)
    options.add_number(parser, "rate", Quantity("rate of the images", "Hz", 0.5, 1000), 10.0)
