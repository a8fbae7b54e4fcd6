"""What a calibration fits: the parameters in their order, their bounds, gauge and prior.

In one row: the logarithm of the lamp's power, that of the beam's standard deviation, what dims the
light with the range (K, or the absorption of a sea), the logarithm of the scattering, the power of
the detectors' cosine, the logarithm of the sphere's radius, pitch and yaw of the lamp on the leader
and of the array on its mount, the background, and the logarithm of each detector's gain. Power and
mean gain are one product, so the geometric mean of the gains is 1: the gauge. What a scene does not
have is held.
"""

from collections.abc import Collection
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.prior import (
    ABSORPTION,
    AMBIENT,
    ATTENUATION,
    BEAM_SIGMA,
    PRIORS,
    RADIUS,
    RESPONSE,
    SCATTERING,
    PriorSettings,
)
from uuv_optical_array.forward.prior import POWER as LAMP_POWER
from uuv_optical_array.forward.scene import Scene

POWER, SIGMA, K, SCATTER, COSINE_POWER, SIZE = range(6)
LAMP_AIM, ARRAY_AIM = [6, 7], [8, 9]  # pitch and yaw
AIMS = [*LAMP_AIM, *ARRAY_AIM]
BACKGROUND, GAINS = 10, 11
AIM_NAMES = tuple(
    f"{part}.aim_{angle}_rad" for part in ("lamp", "array") for angle in ("pitch", "yaw")
)
WATERS = ATTENUATION, ABSORPTION  # of which a scene has one
# Every name that a scene may have before its gains.
NAMES = (LAMP_POWER, BEAM_SIGMA, *WATERS, SCATTERING, RESPONSE, RADIUS, *AIM_NAMES, AMBIENT)
UNITS = ("counts m^2", "deg", "1/m", "1/m", "", "m", *["rad"] * len(AIMS), "counts")
NOISE = "sensor_noise.sigma_counts"  # fitted to the residuals on request
# Bounds in the order above, and of a gain's logarithm.
LOWEST = (-50.0, np.log(0.1), 0.0, np.log(1e-6), 0.5, np.log(0.01), *[-0.3] * 4, 0.0)
HIGHEST = (50.0, np.log(90), 10.0, np.log(10), 1000.0, np.log(100), *[0.3] * 4, 1e6)
GAIN_BOUND = np.log(1e3)
PRIOR_KEYS = {
    POWER: "lamp_power_std",
    SIGMA: "beam_sigma_std_deg",
    K: "",  # by the scene's water
    SCATTER: "scattering_std",
    COSINE_POWER: "cosine_power_std",
    SIZE: "radius_std",
    LAMP_AIM[0]: "lamp_aim_std_deg",
    ARRAY_AIM[0]: "aim_std_deg",
    BACKGROUND: "ambient_std_counts",
    GAINS: "gain_std",
}


def names_in(scene: Scene) -> tuple[str, ...]:
    """Return the names of the parameters of a scene before its gains, dotted as in scenes."""
    water, _ = scene.attenuation
    return tuple(name for name in NAMES if name == water or name not in WATERS)


def lacking(scene: Scene) -> frozenset[int]:
    """Return the parameters that a scene does not have."""
    housed = "half_angle_deg" in scene.effects.get("field_of_view", {})
    has = {
        SCATTER: "sea" in scene.effects,
        COSINE_POWER: not housed,
        SIZE: scene.array.radius_m is not None,
        BACKGROUND: "demodulation" not in scene.effects,
    }
    return frozenset(i for i, there in has.items() if not there)


def is_logarithm(size: int) -> NDArray[np.bool_]:
    """Say which of the parameters are logarithms, shape ``(size,)``."""
    return ~np.isin(np.arange(size), [K, COSINE_POWER, *AIMS, BACKGROUND])


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
    start: PriorSettings, values: Array, errors: Array, unknown: Collection[int], sea: bool
) -> dict[str, Any]:
    """Return the standard errors of a calibration as keys of `PriorSettings`, within their bounds.

    Parameters that were held, whose errors are nan, keep the prior of the starting scene. So do the
    `unknown` ones, or they get that of a rig as bought where the start is exact. `sea` says whether
    the scene has one. A scene takes lamp and array to point along their frames, so how far they do
    not stays uncertain.
    """
    hints = get_type_hints(PriorSettings, include_extras=True)
    prior: dict[str, Any] = {"known": "calibrated"}
    relative = np.where(is_logarithm(len(values)), values, 1.0)
    relative[SIGMA] = 1.0
    sizes = errors / relative
    sizes[AIMS] = np.degrees(np.hypot(errors[AIMS], values[AIMS]))
    keys = {**PRIOR_KEYS, K: "absorption_std_per_m" if sea else "k_std_per_m"}
    for i, key in keys.items():
        count = len(values) - GAINS if i == GAINS else 2 if i in AIMS else 1
        rows = range(i, i + count)
        stds = sizes[rows]
        stds, std = stds[np.isfinite(stds)], getattr(start, key)
        if any(row in unknown for row in rows):
            std = max([std or PRIORS["as_bought"][key], *stds])
        elif stds.size:
            std = float(np.sqrt((stds**2).mean()))
        (quantity,) = hints[key].__metadata__
        prior[key] = float(f"{min(std, quantity.high):.3g}")
    return prior
