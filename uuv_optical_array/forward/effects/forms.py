"""What an effect may do to light, reading or noise: the forms that an effect's function returns.

The forward model and the estimator's compiled loops know these forms and no single effect.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

from uuv_optical_array.core.geometry import Array


@dataclass(frozen=True)
class Transmission:
    """What dims the light on its way to a detector, by the ray's geometry.

    Parameters
    ----------
    law
        ``law(range_m, half_square, cosine, a, b, c)`` of numbers or arrays, marked by
        `core.numerics.elementwise.law`: the factor of the light, the slopes of its logarithm by
        range, 1/m, half the squared off-axis angle, 1/rad^2, and cosine of incidence, and that by
        `a`.
    settings
        Its ``a, b, c``.
    nuisance
        Dotted name of the setting of the scene that `a` is, where the prior may leave it
        uncertain; empty: none.
    """

    law: Callable[..., Any]
    settings: tuple[float, float, float] = (0.0, 0.0, 0.0)
    nuisance: str = ""


@dataclass(frozen=True)
class Moving:
    """What dims the light at a moment, in simulation; an estimator knows nothing of it.

    Parameters
    ----------
    factor
        ``factor(time_s, rays, axis)``: of shape ``(..., n)``, from the moment, s, shape
        ``(..., 1)``, the rays as `forward.light.ray` returns them, shape ``(8, ..., n)``, and the
        beam's axis in ``base_link``, shape ``(3, ..., 1)``.
    """

    factor: Callable[..., Array]


@dataclass(frozen=True)
class Background:
    """Light that is added to that of the lamp.

    Parameters
    ----------
    pattern
        On each detector, for a level of 1, shape ``(n,)``.
    level
        Counts.
    nuisance
        As in `Transmission`, of the level.
    """

    pattern: Array
    level: float
    nuisance: str = ""


@dataclass(frozen=True)
class Gain:
    """What each detector makes of the light.

    Parameters
    ----------
    gains
        By detector, >= 0, shape ``(n,)``.
    slope
        Relative change of all gains by the nuisance, whose value in the scene is 0.
    nuisance
        As in `Transmission`.
    """

    gains: Array
    slope: float = 0.0
    nuisance: str = ""


@dataclass(frozen=True)
class Shade:
    """What dims the lamp's light unevenly over the array, by a depth that is unknown.

    Parameters
    ----------
    pattern
        Logarithm of the factor on each detector, for a depth of 1, shape ``(n,)``.
    nuisance
        As in `Transmission`, of the depth, whose value in the scene is 0.
    """

    pattern: Array
    nuisance: str


@dataclass(frozen=True)
class Blur:
    """Light that neighbours share.

    Parameters
    ----------
    matrix
        Of one axis of the image, shape ``(side, side)``: the image becomes ``M image M'``.
    """

    matrix: Array


@dataclass(frozen=True)
class Noise:
    """Independent Gaussian noise of a reading; the variances of all sources add up.

    Parameters
    ----------
    variance
        In the dark, counts^2, >= 0.
    slope
        Its growth with the light, counts, >= 0.
    """

    variance: float
    slope: float = 0.0


@dataclass(frozen=True)
class Saturation:
    """Largest analogue reading, `level_counts`."""

    level_counts: float


@dataclass(frozen=True)
class Converter:
    """Whole counts from 0 to `largest`."""

    largest: float


Form: TypeAlias = (
    Transmission | Moving | Background | Gain | Shade | Blur | Noise | Saturation | Converter
)
