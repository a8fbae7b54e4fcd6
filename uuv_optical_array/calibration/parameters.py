"""What a calibration fits: the parameters in their order, with bounds and gauge.

In one row: the logarithm of the lamp's power, that of the beam's standard deviation, the
attenuation K, the background, and the logarithm of each detector's gain. Power and mean gain are
one product, so the geometric mean of the gains is 1: the gauge.
"""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from uuv_optical_array.core.geometry import Array

POWER, SIGMA, K, BACKGROUND, GAINS = range(5)
NAMES = ("lamp.power", "lamp.beam_sigma_deg", "attenuation.k_per_m", "ambient.level_counts")
UNITS = ("counts m^2", "deg", "1/m", "counts")
NOISE = "sensor_noise.sigma_counts"  # fitted to the residuals, where that is wanted
# Bounds of power, beam, K and background: logarithms, 1/m and counts; and of a gain's logarithm.
LOWEST, HIGHEST = (-50.0, np.log(0.1), 0.0, 0.0), (50.0, np.log(90), 10.0, 1e6)
GAIN_BOUND = np.log(1e3)


def is_logarithm(size: int) -> NDArray[np.bool_]:
    """Say which of the parameters are logarithms, shape ``(size,)``."""
    return ~np.isin(np.arange(size), [K, BACKGROUND])


def bounds(size: int) -> tuple[Array, Array]:
    """Return the lowest and the highest value of each parameter, shape ``(size,)`` each."""
    gains = np.full(size - GAINS, GAIN_BOUND)
    return np.append(LOWEST, -gains), np.append(HIGHEST, gains)


def directions(held: Collection[int], size: int) -> Array:
    """Return orthogonal directions in which the parameters are free, and the gauge kept.

    Parameters
    ----------
    held
        Parameters that do not move.
    size
        How many there are in all, p.

    Returns
    -------
    Array
        Shape ``(p, q)``, one direction a column.
    """
    lamp = [i for i in range(GAINS) if i not in held]
    gains = [i for i in range(GAINS, size) if i not in held]
    across = null_space(np.ones((1, len(gains)))) if gains else np.zeros((0, 0))
    basis = np.zeros((size, len(lamp) + across.shape[1]))
    basis[lamp, np.arange(len(lamp))] = 1.0
    basis[gains, len(lamp) :] = across
    return basis
