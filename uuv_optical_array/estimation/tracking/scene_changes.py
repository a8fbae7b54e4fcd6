"""What to change in a scene when the sea turns out to differ from it."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.estimation.tracking.track import Learnt
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import (
    GRADIENTS,
    LOGARITHMS,
    OWN_POWER,
    POWER,
    RESPONSE,
    ROLL,
    of_lamp,
)
from uuv_optical_array.forward.scene import GROUPS, Scene

BEYOND = 3.0  # standard deviations of its prior by which a constant is off
SURE = 6.0  # or more than one, where it is this many of its present standard deviations
LEAST_CHANGE = 5e-3  # of the reference reading, which a scene gives no closer


class SceneChange(NamedTuple):
    """A line of the scene to change.

    - key: dotted key of the scene, of a lamp of several as ``lamps[0].power``.
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
        key, value = _written(scene, name)
        if value is None:
            continue
        by = learnt[name].mean
        if name in LOGARITHMS or name.endswith(f".{OWN_POWER}"):
            value *= math.exp(by)
        else:
            value = value + by if key.startswith("lamps") else max(value + by, 0.0)
        text = f"{_reason(name, off[name])}; write {key}: {value:.4g}"
        changes.append(SceneChange(key, value, text))
    if off:
        counts = _reference_counts(model, {name: learnt[name].mean for name in off})
        reason = _reason(POWER, off[POWER]) if POWER in off else "with that the lamp is the same"
        if abs(counts / scene.lamp.reference_counts - 1) > LEAST_CHANGE:
            key = "lamp.reference_counts"
            changes.append(SceneChange(key, counts, f"{reason}; write {key}: {counts:.4g}"))
    return changes


def _written(scene: Scene, name: str) -> tuple[str, Any]:
    """Return where a scene has a constant, and what it has there; ``None``: it cannot hold it."""
    *group, setting = name.split(".")
    if group[0] == "lamps" and len(group) > 1:
        return f"lamps[{group[1]}].{setting}", getattr(scene.lamps[int(group[1])], setting)
    written = scene.settings().get(group[0], scene.effects.get(group[0], {}))
    key = name if group[0] in GROUPS else f"effects.{name}"
    if name in (POWER, ROLL, *GRADIENTS) or "half_angle_deg" in written:
        return key, None
    return key, written.get(setting, 1.0 if name == RESPONSE else 0.0)


def _reference_counts(model: ForwardModel, offsets: Mapping[str, float]) -> float:
    """Return the reading of the lamp at its reference range, where constants are off, counts.

    Several lamps have the power of one at the beacon's origin.
    """
    scene = model.scene
    one = ForwardModel(replace(scene, lamps=())) if scene.lamps else model
    aligned = np.array([-scene.lamp.reference_range_m, 0.0, 0.0, 0.0, 0.0])
    known = {name: np.array(by) for name, by in offsets.items() if name in one.nuisances}
    _, slopes = one.linearised(aligned, offsets={POWER: np.zeros(()), **known})
    share = [lamp.power for lamp in scene.lamps] or [1.0]
    by_lamp = [math.exp(offsets.get(of_lamp(i, OWN_POWER), 0.0)) for i in range(len(share))]
    return float(slopes[:, 5].max() * np.average(by_lamp, weights=share))


def _reason(name: str, off: float) -> str:
    side = "above" if off > 0 else "below"
    return f"{name} is {abs(off):.1f} standard deviations of its prior {side} the scene"
