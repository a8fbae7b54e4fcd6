"""Waters by name: the optical types of Jerlov, and the seas that Petzold measured."""

from typing import Literal, TypeAlias

import numpy as np

Oceanic: TypeAlias = Literal["oceanic_i", "oceanic_ia", "oceanic_ib", "oceanic_ii", "oceanic_iii"]
Coastal: TypeAlias = Literal["coastal_1c", "coastal_3c", "coastal_5c", "coastal_7c", "coastal_9c"]
Water: TypeAlias = Literal[Oceanic, Coastal, "eren2016_clear", "eren2016_coastal"]

# Kd, the diffuse attenuation of downward irradiance, 1/km, not the (larger) beam attenuation c:
# N. G. Jerlov, Marine Optics, Elsevier 1976, table XXVII, p. 135.
WAVELENGTHS_NM = np.linspace(400.0, 700.0, 13)
KD_PER_KM: dict[str, tuple[int, ...]] = {
    "oceanic_i": (28, 22, 19, 18, 27, 43, 63, 89, 235, 305, 360, 420, 560),
    "oceanic_ia": (38, 31, 26, 25, 32, 48, 67, 94, 240, 310, 370, 430, 570),
    "oceanic_ib": (51, 42, 36, 33, 42, 54, 72, 99, 245, 315, 375, 435, 580),
    "oceanic_ii": (96, 81, 68, 62, 70, 76, 89, 115, 260, 335, 400, 465, 610),
    "oceanic_iii": (185, 160, 135, 116, 115, 116, 120, 148, 295, 375, 445, 520, 660),
    "coastal_1c": (510, 360, 250, 170, 140, 130, 120, 150, 300, 370, 450, 510, 650),
    "coastal_3c": (780, 540, 390, 290, 220, 200, 190, 210, 330, 400, 460, 560, 710),
    "coastal_5c": (1100, 780, 560, 430, 360, 310, 300, 330, 400, 480, 540, 650, 800),
    "coastal_7c": (1600, 1200, 890, 710, 580, 490, 460, 460, 480, 540, 630, 780, 920),
    "coastal_9c": (2400, 1900, 1600, 1230, 990, 780, 630, 580, 600, 650, 760, 920, 1100),
}
Measured: TypeAlias = Literal["petzold_clear", "petzold_coastal", "petzold_harbour"]
# Absorption and scattering at 514 nm, 1/m: T. J. Petzold, Volume Scattering Functions for Selected
# Ocean Waters, SIO Ref. 72-78, 1972.
PETZOLD_PER_M: dict[str, tuple[float, float]] = {
    "petzold_clear": (0.114, 0.037),
    "petzold_coastal": (0.179, 0.219),
    "petzold_harbour": (0.366, 1.824),
}
# What Eren et al. (2016) use for their whole band, nm.
EREN_BAND_NM = 500.0, 550.0
EREN_KD_PER_M = {"eren2016_clear": 0.05, "eren2016_coastal": 0.1}


def diffuse_attenuation(water: Water, wavelength_nm: float) -> float:
    """Return Kd of a water type, 1/m, interpolated linearly between the tabulated wavelengths.

    ValueError for a wavelength outside the band for which Eren et al. give theirs.
    """
    if water in KD_PER_KM:
        kd_per_m = np.divide(KD_PER_KM[water], 1000)
        return float(np.interp(wavelength_nm, WAVELENGTHS_NM, kd_per_m))
    low, high = EREN_BAND_NM
    if not low <= wavelength_nm <= high:
        raise ValueError(
            f"wavelength_nm: {wavelength_nm:g}, but {water} is known from {low:g} to {high:g} nm; "
            "take a type of Jerlov"
        )
    return EREN_KD_PER_M[water]
