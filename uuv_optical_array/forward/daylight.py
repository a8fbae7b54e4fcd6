"""Light that is there without the lamp: daylight, linear in what is unknown of it."""

from collections.abc import Sequence

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import power_offsets

ANYWHERE = np.array([-1.0, 0.0, 0.0, 0.0, 0.0])  # it is the same at each pose


def without_lamps(model: ForwardModel, names: Sequence[str]) -> tuple[Array, Array]:
    """Return the light of a scene whose lamps are out, and its slopes by settings of `DAYLIGHT`.

    Shapes ``(n,)`` and ``(k, n)``, in counts.
    """
    out = power_offsets([0.0], model.scene.lamp_count)
    light = model.light(ANYWHERE, 0.0, out).ravel()
    moved = [model.light(ANYWHERE, 0.0, {**out, name: np.array(1.0)}) for name in names]
    return light, np.array([each.ravel() - light for each in moved]).reshape(len(names), len(light))
