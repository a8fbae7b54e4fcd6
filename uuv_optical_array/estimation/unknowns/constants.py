"""What a scene does not know of its sea and a tracker can learn: constants of the day."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.unknowns.coordinates import CoordinateFrame, frame_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import shade_modes

REST_OF_SHADE = 0.02  # by which a shade of the scene may still dim frames that pass for clear


class Expected(NamedTuple):
    """What is known of a frame before its image.

    - mean, covariance: of the offsets of the q unknown constants, ``(q,)`` and ``(q, q)``.
    - uneven: probability that it is one of the uneven frames of `Constants`; ``None``: their share.
    """

    mean: Array
    covariance: Array
    uneven: float | None = None


@dataclass(frozen=True)
class Constants:
    """Settings of the scene that are not known, and how far they may be off.

    - names, stds: of `ForwardModel.nuisances`; standard deviations, > 0, of offsets of mean 0.
    - gain_std: relative gain error of a detector, white over the array; 0: none.
    - detectors, lamps: how many there are, and how many each reads.
    - frame: of `coordinates`; ``None``: only where the light is linear in pose and constants.
    - unclear_lasts_s: correlation time of light that is not clear, s; 0: it is always clear.
    - uneven: share of frames that are lit unevenly in a way that the scene does not name.
    """

    names: tuple[str, ...] = ()
    stds: tuple[float, ...] = ()
    gain_std: float = 0.0
    detectors: int = 0
    frame: CoordinateFrame | None = None
    unclear_lasts_s: float = 0.0
    uneven: float = 0.0
    lamps: int = 1

    @property
    def names_shades(self) -> bool:
        """Whether the scene names shades, which last for `unclear_lasts_s`."""
        return self.unclear_lasts_s > 0 and not self.uneven

    @property
    def by_detector(self) -> Array:
        """Which detector each reading is of, shape ``(lamps * detectors, detectors)``."""
        return np.tile(np.eye(self.detectors), (self.lamps, 1))

    @property
    def shade_rest(self) -> Array:
        """How shades dim readings of frames that pass for clear, shape ``(lamps * detectors, 5)``.

        A share of the light by each smooth mode; shape ``(lamps * detectors, 0)`` without shades.
        """
        if not (self.names_shades and self.detectors):
            return np.zeros((self.lamps * self.detectors, 0))
        return REST_OF_SHADE * self.by_detector @ shade_modes(round(self.detectors**0.5)).T


def constants_of(model: ForwardModel) -> Constants:
    """Return what the prior of a model's scene leaves unknown."""
    prior, stds = model.scene.prior, model.scene.constants_std()
    return Constants(
        tuple(stds),
        tuple(stds.values()),
        prior.gain_std,
        model.array.side**2,
        frame_of(model),
        prior.unclear_lasts_s,
        prior.uneven_share,
        model.scene.lamp_count,
    )


def drift(hold_s: ArrayLike, step_s: float) -> Array:
    """Return what is left after a step, s, of what was known of constants, in (0, 1].

    Constants drift as an Ornstein-Uhlenbeck process, each in its `hold_s`: its mean goes to 0, its
    variance to that of the prior and never beyond. A step before the start counts as 0.
    """
    return np.exp(-max(step_s, 0.0) / np.asarray(hold_s, dtype=float))
