"""A sea that differs from its scene as the scene's prior allows, in all that stays while one dives.

Lamp, water, response, daylight, gains and aims are drawn once. The roll is the follower's own, and
light that changes from frame to frame, such as clouds, is the scene's.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.aim import aim_count
from uuv_optical_array.forward.prior import LOGARITHMS, OWN_POWER, ROLL
from uuv_optical_array.forward.scene import Scene


@dataclass(frozen=True, eq=False)
class DrawnSea:
    """By what a sea differs from its scene.

    - offsets: of settings, by the names of `Scene.nuisance_std`, each of shape ``()``.
    - roll: of the follower, rad, where the scene has several lamps and its prior an uncertain one.
    - aims: pitch and yaw of the array, of the lamp, and ``lamp.behind_m`` where the prior has it,
      in standard deviations, ``(k,)``, as `aim.aim_slopes` has them.
    - gains: of the detectors, around 1, ``(side, side)``.
    """

    offsets: Mapping[str, Array]
    roll: float
    aims: Array
    gains: Array

    def in_words(self, scene: Scene) -> str:
        """Return what differs and by how much, in the scene's units; an empty text: nothing."""
        told = []
        for name, offset in self.offsets.items():
            of_power = name.startswith("lamps.") and name.endswith(f".{OWN_POWER}")
            if name in LOGARITHMS or of_power:
                told.append(f"{name} x{np.exp(offset):.3f}")
            else:
                told.append(f"{name} {float(offset):+.3g}")
        prior = scene.prior
        stds = (prior.aim_std_deg,) * 2 + (prior.lamp_aim_std_deg,) * 2
        names = "array pitch", "array yaw", "lamp pitch", "lamp yaw"
        for name, std, aim in zip(names, stds, self.aims[:4], strict=True):
            if std:
                told.append(f"{name} {std * aim:+.2f} deg")
        told += [f"lamp.behind_m {prior.lamp_behind_std_m * aim:+.3f}" for aim in self.aims[4:]]
        if prior.gain_std:
            told.append(f"gains {100 * np.std(self.gains):.2g} % apart")
        return ", ".join(told)


def draw_sea(scene: Scene, rng: np.random.Generator) -> DrawnSea:
    """Draw a sea from the prior of a scene; water never amplifies light."""
    stds, side = scene.nuisance_std(), scene.array.detectors_per_side
    offsets = {name: np.array(std * rng.standard_normal()) for name, std in stds.items()}
    roll = float(offsets.pop(ROLL, 0.0))
    water, per_m = scene.attenuation
    if water in offsets:
        offsets[water] = np.maximum(offsets[water], -per_m)
    aims = rng.standard_normal(aim_count(scene))
    gains = 1 + scene.prior.gain_std * rng.standard_normal((side, side))
    return DrawnSea(offsets, roll, aims, gains)
