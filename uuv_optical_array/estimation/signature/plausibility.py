"""What cannot be light of this lamp: the bounds of key parameters, their image, frozen frames.

The bounds follow from the definition of the key parameters (`features`): the peak is the brightest
detector over full scale, its place lies on the array, and the skewness is that of as many slopes as
a row has detectors. Of n numbers it is largest with n - 1 alike: ``(n - 2) / sqrt(n - 1)`` (J. E.
Wilkins, *A note on skewness and kurtosis*, Ann. Math. Statist. 15, 1944).
"""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.signature.features import FEATURE_NAMES, scene_parameters
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import reading_variance
from uuv_optical_array.forward.scene import Scene

# Relative: ten times that of a float32, in which features may have been passed on.
FEATURE_ROUNDING = 1e-6
FROZEN = 1e-9  # probability that valid frames repeat, below which a repeated one is frozen
REMEMBERED = 32  # frames: a driver that hangs may send its last buffer again and again


def bounds(scene: Scene) -> Array:
    """Return the largest absolute value of each key parameter that an array can give, ``(5,)``.

    Without saturation and converter the peak has no bound.
    """
    side, full = scene.array.detectors_per_side, scene.full_scale_counts
    peak = 1.0
    if "adc" in scene.effects:
        peak = max(1.0, round(full) / full)  # a saturated reading may be rounded up
    elif "saturation" not in scene.effects:
        peak = math.inf
    peak *= scene.lamp_count  # of the sum of the lamps' images
    place, skewness = (side - 1) / 2, (side - 2) / math.sqrt(side - 1)
    return np.array([peak, place, place, skewness, skewness])


def check_parameters(parameters: Array, largest: Array) -> None:
    """Refuse key parameters, shape ``(5,)``, beyond their `bounds`."""
    for name, value, high in zip(FEATURE_NAMES, parameters.tolist(), largest.tolist(), strict=True):
        low, slack = (0.0 if name == "peak" else -high), FEATURE_ROUNDING * max(1.0, high)
        if not low - slack <= value <= high + slack:
            raise NoPose(
                f"not of this array: {name} is {value:.9g}, but it must be from {low:.6g} to "
                f"{high:.6g}"
            )


def check_full_scale(brightest: float, scene: Scene) -> None:
    """Refuse an image whose brightest reading is one that the array of a scene cannot give."""
    if brightest > scene.full_scale_counts:
        raise NoPose(
            f"above full scale: {brightest:g} counts, but the scene reads at most "
            f"{scene.full_scale_counts:g}"
        )


def check_image(parameters: Array, image: Array, scene: Scene) -> None:
    """Refuse key parameters, shape ``(5,)``, that are not those of their image of a scene."""
    own = scene_parameters(image, scene)
    alike = np.abs(parameters - own) <= FEATURE_ROUNDING * np.maximum(1.0, np.abs(own))
    for i in np.flatnonzero(~alike)[:1]:
        check_parameters(parameters, bounds(scene))
        raise NoPose(
            f"another image: {FEATURE_NAMES[i]} is {parameters[i]:.9g} in the features, but "
            f"{own[i]:.9g} in the image of their stamp; send both of one exposure"
        )


class FrozenFrames:
    """Notice a stream that repeats a frame where noise makes that all but impossible.

    Two readings of the same light are the same count with a probability of at most the integral of
    their noise's squared density, ``1 / (2 sqrt(pi) sigma)``; a reading at 0 or at full scale may
    repeat for ever. The probabilities of all readings multiply, for any of the frames that are
    remembered, and so do those of frames that repeat one after the other. So a scene without noise,
    and a dark or saturated image, may repeat.
    """

    def __init__(self, model: ForwardModel) -> None:
        self._model = model
        self._before: deque[bytes] = deque(maxlen=REMEMBERED)
        self._log_chance = 0.0

    def check(self, frame: Array, readings: Callable[[], Array]) -> None:
        """Refuse a frame, image or key parameters, that repeats with a chance below `FROZEN`.

        The readings that it depends on, measured or expected, are asked where it repeats.
        """
        content = np.asarray(frame, dtype=float).tobytes()
        repeats = content in self._before
        self._before.append(content)
        if not repeats:
            self._log_chance = 0.0
            return
        any_of = math.log(len(set(self._before)))
        self._log_chance += min(0.0, self.log_chance(readings()) + any_of)
        if self._log_chance < math.log(FROZEN):
            raise NoPose(
                f"frozen: the frame is the same as one of the {REMEMBERED} before, whose noise "
                f"repeats with a chance of 1e{self._log_chance / math.log(10):.0f}"
            )

    def log_chance(self, readings: Array) -> float:
        """Return the logarithm of the largest probability that valid readings repeat."""
        noise = self._model.analogue_noise
        variance = reading_variance(readings, noise)
        chances = np.minimum(1.0, 0.5 / np.sqrt(math.pi * variance))
        free = (np.rint(readings) > noise.low) & (np.rint(readings) < np.rint(noise.high))
        return float(np.log(chances[free]).sum())

    def profiles(self, pose: Array, roll: float, parameters: Array) -> Array:
        """Return the readings that key parameters depend on, as expected at a pose.

        These are the row and the rest of the column through the peak, shape ``(2 side - 1,)``.
        """
        image = self._model.expected(pose, roll)
        last = len(image) - 1
        column, row = np.clip(np.rint(parameters[1:3] + last / 2), 0, last).astype(int)
        return np.concatenate([image[row], np.delete(image[:, column], row)])
