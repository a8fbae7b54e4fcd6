"""The working volume of Eren et al. (2016), its specification, and poses drawn from it."""

import math
from collections.abc import Callable

import numpy as np

from uuv_optical_array.core.geometry import IN_DEGREES, Array
from uuv_optical_array.core.settings import Span
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import TableSettings

RANGES_M = (4.0, 5.0, 6.0, 7.0, 8.0)  # behind the lamp
# Largest errors of position, m, and of angle, deg; in words; and in x, y, z, pitch and yaw.
SPECIFIED = 0.2, 10.0
SPECIFIED_TEXT = "{:g} m and {:g} deg".format(*SPECIFIED)
SPECIFICATION = np.repeat(SPECIFIED, (3, 2))
# Corners of the volume, m and rad: 4 to 8 m, 0.9 m to each side, 20 deg.
HIGH = np.array([-4.0, 0.9, 0.9, *np.radians([20.0, 20.0])])
LOW = np.array([-8.0, *-HIGH[1:]])
# Variance of a pose that is uniform in the volume.
VARIANCE = (HIGH - LOW) ** 2 / 12
# RMS errors of always guessing its middle, m and deg.
GUESSED = math.sqrt(VARIANCE[:3].sum()), math.degrees(math.sqrt(VARIANCE[3:].sum()))
MIN_PEAK_COUNTS = 20.0
BLOCK_POSES = 4096  # drawn at a time
DAY_S = 86_400.0  # from which random times are drawn


def uniform_poses(count: int, rng: np.random.Generator) -> Array:
    """Draw poses uniformly from the volume, m and rad, shape ``(count, 5)``."""
    return rng.uniform(LOW, HIGH, (count, 5))


def lit_poses(
    model: ForwardModel,
    count: int,
    rng: np.random.Generator,
    draw: Callable[[int, np.random.Generator], Array] = uniform_poses,
) -> Array:
    """Draw poses whose noiseless image peaks above `MIN_PEAK_COUNTS`, m and rad, ``(count, 5)``.

    `draw` draws candidates, as `uniform_poses`. ValueError where a whole block has no such peak.
    """
    poses = np.empty((0, 5))
    while len(poses) < count:
        block = draw(BLOCK_POSES, rng)
        lit = model.expected(block).max(axis=(-2, -1)) > MIN_PEAK_COUNTS
        if not lit.any():
            raise ValueError(
                f"scene {model.scene.name}: none of {BLOCK_POSES} random poses peaks above "
                f"{MIN_PEAK_COUNTS:g} counts; strengthen the lamp"
            )
        poses = np.concatenate([poses, block[lit]])
    return poses[:count]


def known_volume_std(information: Array) -> Array:
    """Bound the errors of an image whose pose is known to lie in the volume, m and rad.

    The volume enters as a Gaussian prior of its variance beside the Fisher information of the
    image, shape ``(..., 5, 5)``. Where the image says more, the result is the Cramer-Rao bound;
    where it says nothing, the standard deviation of the volume.
    """
    covariance = np.linalg.inv(information + np.diag(1 / VARIANCE))
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))


def volume_table(steps: int) -> TableSettings:
    """Return a grid over the volume with `steps` values along each axis."""
    low, high = ((corner * IN_DEGREES).round(9) for corner in (LOW, HIGH))
    return TableSettings(*(Span(float(a), float(b), steps) for a, b in zip(low, high, strict=True)))
