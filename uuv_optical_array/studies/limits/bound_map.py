"""The Cramer-Rao bound over the working volume, seen from above."""

from dataclasses import dataclass
from typing import get_args

import numpy as np

from uuv_optical_array.core.geometry import IN_DEGREES, Array, X, Y
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import RANGES_M

BEHIND_M = np.linspace(RANGES_M[0], RANGES_M[-1], 81, dtype=float)
ASIDE_M = np.linspace(-1, 1, 81, dtype=float)


@dataclass(frozen=True)
class BoundMap:
    """Bounds of level poses at the lamp's depth.

    Parameters
    ----------
    behind_m, aside_m
        Where they are, behind the lamp and to port, m, shapes ``(n,)`` and ``(m,)``.
    std
        Standard deviations by the shape of the array, m and deg, shape ``(n, m, 5)`` each; inf
        where a pose is unobservable.
    """

    behind_m: Array
    aside_m: Array
    std: dict[Shape, Array]


def bound_map(scene: Scene, behind_m: Array = BEHIND_M, aside_m: Array = ASIDE_M) -> BoundMap:
    """Map the bound of a scene, whose array gets each shape, and whose lamp is set anew for it."""
    poses = np.zeros((len(behind_m), len(aside_m), 5))
    poses[..., X], poses[..., Y] = -behind_m[:, None], aside_m
    std = {}
    for shape in get_args(Shape):
        model = ForwardModel(scene.with_shape(shape))
        std[shape] = np.stack([cramer_rao_bound(model, row).std for row in poses]) * IN_DEGREES
    return BoundMap(behind_m, aside_m, std)
