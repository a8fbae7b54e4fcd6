"""What a calibration fits: the parameters in their order, their bounds, gauge and prior.

In one row: the logarithm of the lamp's power, that of the beam's standard deviation, the
attenuation K, the background, and the logarithm of each detector's gain. Power and mean gain are
one product, so the geometric mean of the gains is 1: the gauge.
"""

from collections.abc import Collection
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.prior import PRIORS, PriorSettings

POWER, SIGMA, K, BACKGROUND, GAINS = range(5)
NAMES = ("lamp.power", "lamp.beam_sigma_deg", "attenuation.k_per_m", "ambient.level_counts")
UNITS = ("counts m^2", "deg", "1/m", "counts")
NOISE = "sensor_noise.sigma_counts"  # fitted to the residuals on request
# Bounds of power, beam, K and background: logarithms, 1/m and counts; and of a gain's logarithm.
LOWEST, HIGHEST = (-50.0, np.log(0.1), 0.0, 0.0), (50.0, np.log(90), 10.0, 1e6)
GAIN_BOUND = np.log(1e3)
PRIOR_KEYS = {
    POWER: "lamp_power_std",
    SIGMA: "beam_sigma_std_deg",
    K: "k_std_per_m",
    BACKGROUND: "ambient_std_counts",
    GAINS: "gain_std",
}


def is_logarithm(size: int) -> NDArray[np.bool_]:
    """Say which of the parameters are logarithms, shape ``(size,)``."""
    return ~np.isin(np.arange(size), [K, BACKGROUND])


def bounds(size: int) -> tuple[Array, Array]:
    """Return the lowest and the highest value of each parameter, shape ``(size,)`` each."""
    gains = np.full(size - GAINS, GAIN_BOUND)
    return np.append(LOWEST, -gains), np.append(HIGHEST, gains)


def free_directions(held: Collection[int], size: int) -> Array:
    """Return orthogonal directions of the `size` parameters that keep the gauge, as columns.

    Parameters that are `held` do not move; the gains that do keep their geometric mean.
    """
    lamp = [i for i in range(GAINS) if i not in held]
    gains = [i for i in range(GAINS, size) if i not in held]
    across = null_space(np.ones((1, len(gains)))) if gains else np.zeros((0, 0))
    basis = np.zeros((size, len(lamp) + across.shape[1]))
    basis[lamp, np.arange(len(lamp))] = 1.0
    basis[gains, len(lamp) :] = across
    return basis


def calibrated_prior(
    start: PriorSettings, values: Array, errors: Array, unknown: Collection[int], attenuates: bool
) -> dict[str, Any]:
    """Return the standard errors of a calibration as keys of `PriorSettings`, within their bounds.

    Parameters that were held, whose errors are nan, keep the prior of the starting scene. So do the
    `unknown` ones, or they get that of a rig as bought where the start is exact. `attenuates` says
    whether the scene has an attenuation.
    """
    hints = get_type_hints(PriorSettings, include_extras=True)
    prior: dict[str, Any] = {"known": "calibrated"}
    for i, key in PRIOR_KEYS.items():
        rows = range(i, i + 1) if i < GAINS else range(GAINS, len(values))
        stds = errors[rows] / (values[rows] if i in (POWER, GAINS) else 1.0)
        stds, std = stds[np.isfinite(stds)], getattr(start, key)
        if any(row in unknown for row in rows):
            std = max([std or PRIORS["as_bought"][key], *stds])
        elif stds.size:
            std = float(np.sqrt((stds**2).mean()))
        (quantity,) = hints[key].__metadata__
        prior[key] = float(f"{min(std, quantity.high):.3g}")
    if not attenuates:
        prior[PRIOR_KEYS[K]] = 0.0
    return prior
