"""What to change in a scene when the sea turns out to differ from it."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from uuv_optical_array.estimation.tracking.track import Learnt
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import GRADIENTS, LOGARITHMS, POWER, RESPONSE
from uuv_optical_array.forward.scene import GROUPS

BEYOND = 3.0  # standard deviations of its prior by which a constant is off
SURE = 6.0  # or more than one, where it is this many of its present standard deviations
LEAST_CHANGE = 5e-3  # of the reference reading, which a scene gives no closer


class SceneChange(NamedTuple):
    """A line of the scene to change.

    - key: dotted key of the scene.
    - value: to write there, in the unit of the key.
    - text: the same for a reader, with the reason.
    """

    key: str
    value: float
    text: str


def scene_changes(
    model: ForwardModel, constants: Constants, learnt: Mapping[str, Learnt], beyond: float = BEYOND
) -> list[SceneChange]:
    """Return the changes that bring a scene to the sea, where that is not what its prior expects.

    A scene gives the lamp's power by the reading at a reference range, through its water, so that
    reading changes with the water even where the lamp is the same.

    - learnt: what is known of the constants by now, as `Track.constants` has it.
    - beyond: standard deviations of its prior by which a constant must be off to be named; one that
      is known to be off (`SURE`) is named before.
    """
    scene = model.scene
    off = {
        name: learnt[name].mean / std
        for name, std in zip(constants.names, constants.stds, strict=True)
        if name in learnt
        and abs(learnt[name].mean) > min(beyond * std, max(SURE * learnt[name].std, std))
    }
    changes = []
    for name in off:
        group, setting = name.split(".")
        written = scene.settings().get(group, scene.effects.get(group, {}))
        if name == POWER or name in GRADIENTS or "half_angle_deg" in written:
            continue  # no scene can hold it
        key = name if group in GROUPS else f"effects.{name}"
        value, by = written.get(setting, 1.0 if name == RESPONSE else 0.0), learnt[name].mean
        value = value * math.exp(by) if name in LOGARITHMS else max(value + by, 0.0)
        text = f"{_reason(name, off[name])}; write {key}: {value:.4g}"
        changes.append(SceneChange(key, value, text))
    if off:
        aligned = np.array([-scene.lamp.reference_range_m, 0.0, 0.0, 0.0, 0.0])
        offsets = {POWER: np.zeros(()), **{name: np.array(learnt[name].mean) for name in off}}
        _, slopes = model.linearised(aligned, offsets=offsets)
        counts = float(slopes[:, 5].max())
        reason = _reason(POWER, off[POWER]) if POWER in off else "with that the lamp is the same"
        if abs(counts / scene.lamp.reference_counts - 1) > LEAST_CHANGE:
            key = "lamp.reference_counts"
            changes.append(SceneChange(key, counts, f"{reason}; write {key}: {counts:.4g}"))
    return changes


def _reason(name: str, off: float) -> str:
    side = "above" if off > 0 else "below"
    return f"{name} is {abs(off):.1f} standard deviations of its prior {side} the scene"
