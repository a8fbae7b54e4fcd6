"""What a scene does not know of its sea and a tracker can learn: constants of the day."""

import math
from dataclasses import dataclass

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.unknowns.coordinates import CoordinateFrame, frame_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import shade_modes

REST_OF_SHADE = 0.02  # by which a shade of the scene may still dim frames that count as clear


@dataclass(frozen=True)
class Constants:
    """Settings of the scene that are not known, and how far they may be off.

    - names, stds: of `ForwardModel.nuisances`; standard deviations, > 0, of offsets of mean 0.
    - gain_std: relative error of a detector by its gain and the beam, white over the array.
    - detectors, lamps: how many there are, and how many each reads.
    - frame: of `coordinates`; ``None``: only where the light is linear in pose and constants.
    - unclear_lasts_s: correlation time of light that is not clear, s; 0: it is always clear.
    - uneven: share of frames that are lit unevenly.
    - names_shades: whether the scene names what does that, as a cloud; else it is unusual.
    """

    names: tuple[str, ...] = ()
    stds: tuple[float, ...] = ()
    gain_std: float = 0.0
    detectors: int = 0
    frame: CoordinateFrame | None = None
    unclear_lasts_s: float = 0.0
    uneven: float = 0.0
    lamps: int = 1
    names_shades: bool = False

    @property
    def by_detector(self) -> Array:
        """Which detector each reading is of, shape ``(lamps * detectors, detectors)``."""
        return np.tile(np.eye(self.detectors), (self.lamps, 1))

    @property
    def shade_rest(self) -> Array:
        """How shades dim readings of frames that count as clear, shape ``(lamps * detectors, 5)``.

        A share of the light by each smooth mode; shape ``(lamps * detectors, 0)`` without shades.
        """
        if not (self.names_shades and self.detectors):
            return np.zeros((self.lamps * self.detectors, 0))
        return REST_OF_SHADE * self.by_detector @ shade_modes(round(self.detectors**0.5)).T


def constants_of(model: ForwardModel) -> Constants:
    """Return what the prior of a model's scene leaves unknown."""
    scene = model.scene
    prior, stds = scene.prior, scene.constants_std()
    clear, *_ = prior.lights(scene.daylight_scale_counts, len(scene.lamps))
    return Constants(
        tuple(stds),
        tuple(stds.values()),
        prior.spread,
        model.array.side**2,
        frame_of(model),
        prior.unclear_lasts_s,
        1 - clear.share,
        scene.lamp_count,
        prior.shade_probability > 0,
    )


def drift(hold_s: float, step_s: float) -> float:
    """Return what is left after a step, s, of what was known of constants, in (0, 1].

    Constants drift as an Ornstein-Uhlenbeck process, in `hold_s`: their mean goes to 0, their
    variance to that of the prior and never beyond. A step before the start counts as 0.
    """
    return math.exp(-max(step_s, 0.0) / hold_s)
