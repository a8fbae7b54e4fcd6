"""The optical water types of Jerlov."""

from typing import Literal, TypeAlias

import numpy as np

Water: TypeAlias = Literal[
    "oceanic_i",
    "oceanic_ia",
    "oceanic_ib",
    "oceanic_ii",
    "oceanic_iii",
    "coastal_1c",
    "coastal_3c",
    "coastal_5c",
    "coastal_7c",
    "coastal_9c",
    "eren2016_clear",
    "eren2016_coastal",
]

WAVELENGTHS_NM = (500.0, 525.0, 550.0)
# Kd, the diffuse attenuation of downward irradiance, 1/m, not the (larger) beam attenuation c:
# N. G. Jerlov, Marine Optics, Elsevier 1976, table XXVII, p. 135. The last two are the values that
# Eren et al. (2016) use for their whole band.
KD_PER_M: dict[Water, tuple[float, float, float]] = {
    "oceanic_i": (0.027, 0.043, 0.063),
    "oceanic_ia": (0.032, 0.048, 0.067),
    "oceanic_ib": (0.042, 0.054, 0.072),
    "oceanic_ii": (0.070, 0.076, 0.089),
    "oceanic_iii": (0.115, 0.116, 0.120),
    "coastal_1c": (0.14, 0.13, 0.12),
    "coastal_3c": (0.22, 0.20, 0.19),
    "coastal_5c": (0.36, 0.31, 0.30),
    "coastal_7c": (0.58, 0.49, 0.46),
    "coastal_9c": (0.99, 0.78, 0.63),
    "eren2016_clear": (0.05, 0.05, 0.05),
    "eren2016_coastal": (0.1, 0.1, 0.1),
}


def diffuse_attenuation(water: Water, wavelength_nm: float) -> float:
    """Return Kd of a water type, interpolated linearly between the tabulated wavelengths.

    Parameters
    ----------
    water
        Water type.
    wavelength_nm
        From 500 to 550 nm.

    Returns
    -------
    float
        Diffuse attenuation coefficient, 1/m.
    """
    return float(np.interp(wavelength_nm, WAVELENGTHS_NM, KD_PER_M[water]))
