"""What photodiode, amplifier and converter do to a reading."""

import math
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np
from scipy.constants import elementary_charge, k, zero_Celsius

from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.forms import (
    Background,
    Converter,
    Demodulation,
    Noise,
    Saturation,
    Waveform,
)


def sensor_noise(
    array: DetectorArray,
    *,
    sigma_counts: Annotated[
        float, Quantity("standard deviation in the dark, before demodulation", "counts", 0, 1e6)
    ],
    relative: Annotated[
        float, Quantity("standard deviation of a second part, relative to the light", "", 0, 1)
    ] = 0.0,
) -> Noise:
    """Net noise of a detector and its amplifier, Gaussian (Eren et al. 2016, eq. 7).

    The relative part is that of a lamp or a gain that trembles from one reading to the next, of
    each detector by itself. `demodulation` changes the other part only.
    """
    return Noise(sigma_counts**2, square=relative**2)


def shot_noise(
    array: DetectorArray,
    *,
    electrons_per_count: Annotated[
        float, Quantity("number of photoelectrons of one count", "", 1e-3, 1e12)
    ],
) -> Noise:
    """Shot noise of the light, whose variance is its mean in electrons (Eren et al. 2016, eq. 7).

    Gaussian, as the paper assumes; ``2 q I B`` in counts.
    """
    return Noise(0.0, 1 / electrons_per_count)


class PhotodiodePart(NamedTuple):
    """Active area, responsivity at 525 nm, typical dark current and shunt resistance (`PARTS`)."""

    area_m2: float
    responsivity_a_per_w: float
    dark_current_a: float
    shunt_resistance_ohm: float


Part: TypeAlias = Literal["SM05PD1A", "SM05PD2A", "BPW34"]
# Thorlabs SM05PD1A holds an FDS100: area and dark current (20 V) from its specification sheet
# 0637-S01. SM05PD2A holds an FDS010, whose sheet we could not check: area and dark current (10 V)
# are as commonly quoted. Responsivities are those typical of silicon, to some 10 %. The sheets give
# no shunt resistance; 1 GOhm is the usual order, and a load of some MOhm hides it. BPW34: area and
# dark current (10 V) from Vishay's sheet 81521.
PARTS: dict[Part, PhotodiodePart] = {
    "SM05PD1A": PhotodiodePart(13e-6, 0.33, 1.0e-9, 1e9),
    "SM05PD2A": PhotodiodePart(0.8e-6, 0.27, 0.3e-9, 1e9),
    "BPW34": PhotodiodePart(7.5e-6, 0.32, 2e-9, 1e9),
}


def photodiode(
    array: DetectorArray,
    *,
    part: Part,
    bandwidth_hz: Annotated[float, Quantity("noise bandwidth", "Hz", 1e-3, 1e9)],
    load_ohm: Annotated[
        float, Quantity("resistance of the load or feedback resistor", "ohm", 1, 1e12)
    ],
    amplifier_a_per_rthz: Annotated[
        float, Quantity("current noise of the amplifier", "A/sqrt(Hz)", 0, 1)
    ] = 0.0,
    temperature_c: Annotated[
        float, Quantity("temperature of diode and resistor", "deg C", -40, 100)
    ] = 20.0,
    amps_per_count: Annotated[
        float | None, Quantity("photocurrent of one count", "A", 1e-18, 1)
    ] = None,
    watts_per_m2_per_count: Annotated[
        float | None, Quantity("irradiance of one count", "W/m^2", 1e-15, 1e6)
    ] = None,
) -> Noise:
    """Noise of a type of photodiode and of its amplifier (Eren et al. 2016, eq. 7).

    Gaussian shot noise ``2 q I B`` of the light and of the dark current, Johnson noise
    ``4 k T B / R`` of the load parallel to the shunt resistance, and the noise of the amplifier. At
    a given irradiance a larger or more responsive part gives more current and so less noise in
    counts. The converter's rounding is added by `adc`.
    """
    sheet = PARTS[part]
    if amps_per_count is None:
        assert watts_per_m2_per_count is not None  # checked with the scene
        amps_per_count = watts_per_m2_per_count * sheet.area_m2 * sheet.responsivity_a_per_w
    shot = 2 * elementary_charge * bandwidth_hz
    conductance = 1 / sheet.shunt_resistance_ohm + 1 / load_ohm
    johnson = 4 * k * (temperature_c + zero_Celsius) * bandwidth_hz * conductance
    dark = 2 * elementary_charge * sheet.dark_current_a * bandwidth_hz
    variance = dark + johnson + amplifier_a_per_rthz**2 * bandwidth_hz
    return Noise(variance / amps_per_count**2, shot / amps_per_count)


def saturation(
    array: DetectorArray,
    *,
    level_counts: Annotated[
        float,
        Quantity(
            "largest signal, before demodulation; the effect pedestal is in it", "counts", 1, 1e6
        ),
    ],
) -> Saturation:
    """Clip at the largest signal that photodiode and amplifier can give."""
    return Saturation(level_counts)


class Detection(NamedTuple):
    """Noise of a demodulated reading, and the lamp's peak.

    With a lamp of mean 1 and waveform m(t), the reading is the mean of the signal times a reference
    w(t), where the means of w and of w m are 0 and 1. The variance of white noise grows by the mean
    of w^2, that of the lamp's shot noise by the mean of w^2 m, for lamps as bright as each other of
    w^2 times the light of all over that of one. The peak is the light of all over the mean of one.
    """

    noise_factor: float
    light_factor: float
    peak_factor: float


def detection(waveform: Waveform, lamps: int) -> Detection:
    """Return how a waveform detects each of some lamps."""
    if waveform == "slots":
        # One lamp lit in each slot and none in the last, and the difference: w = 1, -1 and 0.
        return Detection(2 / (lamps + 1), 1.0, lamps + 1.0)
    # Each at a frequency of its own. A square wave, on for half of the period, with its fundamental
    # as the reference: w = pi / 2 sin; or m = 1 + sin, and w = 2 sin.
    factor = math.pi**2 / 8 if waveform == "square" else 2.0
    return Detection(factor, factor * lamps, 2.0 * lamps)


def demodulation(
    array: DetectorArray,
    *,
    waveform: Annotated[Waveform, Quantity("waveform of the modulated lamps")],
    pedestal_counts: Annotated[
        float,
        Quantity("reading in darkness, high enough that noise stays above 0", "counts", 0, 1e4),
    ] = 20.0,
) -> tuple[Demodulation, Background]:
    """Modulate the lamps and detect them synchronously, which takes daylight out of the readings.

    Counts are of a lamp's mean power, as without it. Daylight stays in the shot noise and in what
    saturates: ``saturation`` limits daylight and the peak of the lamps, as if all were as bright,
    together. So do lamps of other vehicles at frequencies of their own. Daylight has to be slow
    beside the modulation, as waves and clouds are at some kHz. Several lamps need frequencies of
    which none is an odd multiple of another, or slots, which do not separate vehicles.
    """
    return Demodulation(waveform), Background(np.ones(array.side**2), pedestal_counts)


def largest_demodulated(
    level_counts: float,
    daylight_counts: float,
    lamps: int,
    waveform: Waveform,
    pedestal_counts: float,
) -> float:
    """Return the reading, counts, where daylight and the lamps' peak together reach a level.

    ValueError where daylight alone reaches it.
    """
    if daylight_counts >= level_counts:
        raise ValueError(
            f"effects.saturation.level_counts: {level_counts:g}: daylight of {daylight_counts:g} "
            "counts alone reaches it; give more"
        )
    peak = detection(waveform, lamps).peak_factor
    return pedestal_counts + (level_counts - daylight_counts) / peak


def pedestal(
    array: DetectorArray,
    *,
    level_counts: Annotated[float, Quantity("reading in darkness", "counts", 0, 1e4)],
) -> Background:
    """Raise all readings by what the sender adds, so that noise in the dark stays above 0.

    It is no light: it has no shot noise, and no gain multiplies it. With `demodulation` leave it
    out, which has ``pedestal_counts``.
    """
    return Background(np.ones(array.side**2), level_counts)


def adc(
    array: DetectorArray,
    *,
    bits: Annotated[int, Quantity("resolution; the range is from 0 to 2^bits - 1", "", 1, 16)],
) -> Converter:
    """Round to whole counts and clip to the converter's range."""
    return Converter(2.0**bits - 1)
