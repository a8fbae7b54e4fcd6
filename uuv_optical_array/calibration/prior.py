"""How well the scene of a calibration is known: its standard errors, as the scene's prior."""

from collections.abc import Collection
from typing import Any, get_type_hints

import numpy as np

from uuv_optical_array.calibration.parameters import BACKGROUND, GAINS, POWER, SIGMA, K
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.scene import PRIORS, PriorSettings

KEYS = {
    POWER: "lamp_power_std",
    SIGMA: "beam_sigma_std_deg",
    K: "k_std_per_m",
    BACKGROUND: "ambient_std_counts",
    GAINS: "gain_std",
}


def prior_of(
    before: PriorSettings, values: Array, errors: Array, unknown: Collection[int], attenuates: bool
) -> dict[str, Any]:
    """Return the keys of the prior that a calibration tells.

    Parameters
    ----------
    before
        Prior of the starting scene. Of what is held it stays, and of what is not known; where it
        calls that exact, it becomes that of a rig as bought.
    values, errors
        Of the parameters in their units, the errors nan where held, shape ``(p,)``.
    unknown
        Which of the parameters are held because the images do not tell them.
    attenuates
        Whether the scene has an attenuation to be uncertain of.

    Returns
    -------
    dict
        Of `PriorSettings`, each within its bounds.
    """
    bounds = get_type_hints(PriorSettings, include_extras=True)
    found: dict[str, Any] = {"known": "calibrated"}
    for i, key in KEYS.items():
        these = range(i, i + 1) if i < GAINS else range(GAINS, len(values))
        stds = errors[these] / (values[these] if i in (POWER, GAINS) else 1.0)
        stds, std = stds[np.isfinite(stds)], getattr(before, key)
        if any(each in unknown for each in these):
            std = max([std or PRIORS["as_bought"][key], *stds])
        elif stds.size:
            std = float(np.sqrt((stds**2).mean()))
        (quantity,) = bounds[key].__metadata__
        found[key] = float(f"{min(std, quantity.high):.3g}")
    if not attenuates:
        found[KEYS[K]] = 0.0
    return found
