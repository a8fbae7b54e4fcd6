"""The lamp of a scene: its power and its beam, a sum of up to three concentric Gaussians.

No lamp that is sold shines like one Gaussian, and a sum of three comes within a few thousandths of
many: a narrow part on a wider one, or, with a negative weight, a flat top. Each is scattered by
itself, as light is linear in the beam. All widths are relative to ``beam_sigma_deg``, by which a
prior leaves the whole beam wider or narrower.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Numbers, Quantity

MOST_GAUSSIANS = 3
NARROWEST_DEG, WIDEST_DEG = 0.1, 90  # standard deviation of each Gaussian
WEIGHTS_OFF = 1e-3  # by which the sum of the weights may differ from 1, as rounded ones do
REACH = 12.0  # of a Gaussian, in its standard deviations: beyond it is nothing
WIDTHS_OF_THREE = 0.6, 1.0, 1.6  # of a beam whose shape is not known
UNIT: Array = np.ones((2, 1))  # a beam of one Gaussian


@dataclass(frozen=True)
class LampSettings:
    """The lamp of a scene: its beam, and its power by what the array reads of it.

    The beam is a Gaussian, or a sum of two or three concentric ones. Each has a width, relative to
    ``beam_sigma_deg``, and a weight, its share of the light on the axis, which is negative where
    the beam is flatter than a Gaussian there.
    """

    beam_sigma_deg: Annotated[
        float,
        Quantity(
            "standard deviation of a Gaussian beam, unless photometry gives it", "deg", 0.1, 90
        ),
    ]
    reference_counts: Annotated[
        float,
        Quantity(
            "largest reading of an aligned array by the beam of this lamp alone, at the reference "
            "range; of several lamps, as if one at the origin had their power",
            "counts",
            1,
            1e6,
        ),
    ]
    reference_range_m: Annotated[
        float, Quantity("distance of base_link behind the lamp for that reading", "m", 0.1, 1000)
    ]
    beam_widths: Annotated[
        Numbers | None,
        Quantity("widths of two or three Gaussians, relative to beam_sigma_deg", "", 0.01, 100),
    ] = None
    beam_weights: Annotated[
        Numbers | None,
        Quantity("share of each Gaussian in the light on the axis; their sum is 1", "", -10, 10),
    ] = None
    behind_m: Annotated[
        float,
        Quantity(
            "distance from the lamp's face back to the apparent source of its light", "m", -1, 1
        ),
    ] = 0.0
    floor_counts: Annotated[
        float,
        Quantity(
            "reading by the light of a modulated lamp that arrives from all directions",
            "counts",
            0,
            1e6,
        ),
    ] = 0.0
    photometry: Annotated[
        str | None, Quantity("path of an IES or EULUMDAT file, in place of all beam_ keys")
    ] = None  # in a scene that was read it is replaced by these

    def __post_init__(self) -> None:
        widths, weights = self.beam_widths, self.beam_weights
        if widths is None and weights is None:
            return
        count = len(widths or weights or ())
        if widths is None or weights is None or len(widths) != len(weights):
            given = len(widths or ()), len(weights or ())
            raise ValueError(
                f"beam_weights: {given[1]} weights, but {given[0]} beam_widths; give each Gaussian "
                "one of each"
            )
        if not 2 <= count <= MOST_GAUSSIANS:
            raise ValueError(
                f"beam_widths: {count} widths; give two or {MOST_GAUSSIANS}, or neither widths "
                "nor weights for one Gaussian"
            )
        for i, width in enumerate(widths):
            sigma_deg = width * self.beam_sigma_deg
            if not NARROWEST_DEG <= sigma_deg <= WIDEST_DEG:
                raise ValueError(
                    f"beam_widths[{i}]: {width:g} times {self.beam_sigma_deg:g} deg is "
                    f"{sigma_deg:g} deg; it must be from {NARROWEST_DEG:g} to {WIDEST_DEG:g} deg"
                )
        if abs(sum(weights) - 1) > WEIGHTS_OFF:
            raise ValueError(
                f"beam_weights: their sum is {sum(weights):g}; scale it to 1, as they are "
                "shares of the light on the axis"
            )
        if (dark := dark_angle(gaussians_of(self))) is not None:
            raise ValueError(
                f"beam_weights: {list(weights)} make the light negative "
                f"{dark * self.beam_sigma_deg:.3g} deg off the axis; weaken the negative ones"
            )


def of_three(lamp: LampSettings) -> LampSettings:
    """Return a lamp of one Gaussian as one of three, of which two have no weight yet.

    Two shares of a narrower and a wider one make many beams of it: see docs/explanation/light.md.
    """
    if lamp.beam_weights is not None:
        return lamp
    return replace(lamp, beam_widths=WIDTHS_OF_THREE, beam_weights=(0.0, 1.0, 0.0))


def gaussians_of(lamp: LampSettings) -> Array:
    """Return weights on the axis, and widths over ``beam_sigma_deg``, of a beam's Gaussians.

    The shape is ``(2, 1)`` of one and ``(2, 3)`` of more: of two, the third has the weight 0.
    """
    if lamp.beam_widths is None or lamp.beam_weights is None:
        return UNIT
    weights = np.array(lamp.beam_weights, dtype=float) / sum(lamp.beam_weights)
    rows = np.array([weights, lamp.beam_widths], dtype=float)
    missing = np.tile([[0.0], [1.0]], MOST_GAUSSIANS - len(weights))
    return np.ascontiguousarray(np.hstack([rows, missing]))


def radiance(gaussians: Array, angle: Array) -> Array:
    """Return a beam's radiance over that on its axis, at angles over ``beam_sigma``, any shape."""
    weights, widths = gaussians
    parts: Array = weights * np.exp(-0.5 * (np.asarray(angle)[..., None] / widths) ** 2)
    return np.asarray(parts.sum(axis=-1))


def dark_angle(gaussians: Array) -> float | None:
    """Return the least angle, over the beam's sigma, at which it has no light; ``None``: nowhere.

    It goes by the radiance over that of the widest Gaussian, which stays a number far off the axis.
    """
    weights, widths = gaussians[:, gaussians[0] != 0]
    # A narrower Gaussian is nowhere above a wider one, so it takes away less than its weight says.
    if (np.cumsum(weights[np.argsort(-widths)]) > 0).all():
        return None
    angles = np.linspace(0, REACH * widths, 801).ravel()
    narrower = widths**-2.0 - widths.max() ** -2.0
    dark = np.exp(-0.5 * np.outer(angles**2, narrower)) @ weights <= 0
    return float(angles[dark].min()) if dark.any() else None


def beam_solid_angle(sigma_rad: float, gaussians: Array = UNIT) -> float:
    """Flux of a beam over its intensity on the axis, sr.

    Of a Gaussian that is ``2 pi`` times the integral of ``exp(-eta^2 / (2 sigma^2)) sin eta`` from
    0 to pi; for a narrow beam ``2 pi sigma^2``.
    """
    parts = zip(*gaussians.tolist(), strict=True)
    return sum(weight * _solid_angle(width * sigma_rad) for weight, width in parts if weight)


def _solid_angle(sigma_rad: float) -> float:
    # Imported here because it takes a tenth of a second, which nodes need not spend.
    from scipy.integrate import quad

    end = min(math.pi, REACH * sigma_rad)  # quad would miss a narrow peak in a wide interval
    integral, _ = quad(lambda eta: math.exp(-((eta / sigma_rad) ** 2) / 2) * math.sin(eta), 0, end)
    return 2 * math.pi * float(integral)


def angle_of(gaussians: Array, stds: float) -> float:
    """Return where a beam is as dark as a Gaussian at so many of its standard deviations.

    It is the least such angle, over the beam's sigma.
    """
    if gaussians.shape[1] == 1:
        return stds * float(gaussians[1, 0])
    angles = np.linspace(0, REACH * gaussians[1].max(), 4001)
    dim = radiance(gaussians, angles) / math.exp(-0.5 * stds**2)
    first = int((dim <= 1).argmax())
    return float(np.interp(-1.0, -dim[first - 1 : first + 1], angles[first - 1 : first + 1]))
