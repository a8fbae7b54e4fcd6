"""The forms of an effect: what it may do to light, reading or noise.

The forward model and the estimator's compiled loops know only these forms, no single effect.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from uuv_optical_array.core.geometry import Array

Waveform: TypeAlias = Literal["square", "sine", "slots"]  # of a modulated lamp


@dataclass(frozen=True)
class Transmission:
    """Attenuation on the way to a detector, by the geometry of the ray.

    - law: ``law(range_m, incidence, a, b, c)``, one of `forward.optics.LAWS`: the factor of the
      light, and the slopes of its logarithm by range, 1/m, cosine of incidence, and `a`.
    - settings: its ``a, b, c``.
    - nuisance: dotted name of the setting `a` where the prior may leave it uncertain; empty: none.
    """

    law: Callable[..., Any]
    settings: tuple[float, float, float] = (0.0, 0.0, 0.0)
    nuisance: str = ""


@dataclass(frozen=True)
class Scattering:
    """Water that scatters the lamp's light: `forward.scattering`. The prior may have it unknown."""

    scattering_per_m: float


@dataclass(frozen=True)
class Moving:
    """Attenuation at a time, in simulation only; an estimator does not know it.

    - factor: ``factor(time_s, rays, axis)``: shape ``(..., n)``, from the time, s, shape ``(...,
      1)``, the rays as `forward.light.ray` returns them, shape ``(13, ..., n)``, and the beam's
      axis in ``base_link``, shape ``(3, ..., 1)``.
    """

    factor: Callable[..., Array]


@dataclass(frozen=True)
class Step:
    """What happens to the light on the array, by values of its detectors, shape ``(n,)``.

    The nuisance is as in `Transmission`.
    """

    values: Array
    scale: float = 0.0
    nuisance: str = ""


class Background(Step):
    """Light beside that of the lamp: the values times the scale, counts, which is the nuisance."""


class Gain(Step):
    """Factors, >= 0; the scale is their relative change by the nuisance, 0 in the scene."""


class Shade(Step):
    """Uneven attenuation: the logarithm of the factor for a nuisance of 1; it is 0 in the scene."""


@dataclass(frozen=True)
class Blur:
    """Light that neighbours share: ``M image M'``, with M of shape ``(side, side)``."""

    matrix: Array


@dataclass(frozen=True)
class Noise:
    """Independent Gaussian noise of a reading; the variances of all sources add up.

    The variance is that in the dark, counts^2, `slope` its growth with the light, counts, and
    `square` with the square of the light.
    """

    variance: float
    slope: float = 0.0
    square: float = 0.0


@dataclass(frozen=True)
class Saturation:
    """Largest analogue reading, `level_counts`."""

    level_counts: float


@dataclass(frozen=True)
class Demodulation:
    """Synchronous detection of a modulated lamp: daylight is in the noise, not in the reading."""

    waveform: Waveform


@dataclass(frozen=True)
class Converter:
    """Whole counts from 0 to `largest`."""

    largest: float


Form: TypeAlias = (
    Transmission | Scattering | Moving | Step | Blur | Noise | Saturation | Demodulation | Converter
)
