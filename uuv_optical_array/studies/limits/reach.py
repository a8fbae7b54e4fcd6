"""How far a scene's lamp is of use: where one image can keep the specification at all."""

import numpy as np

from uuv_optical_array.core.geometry import IN_DEGREES, X
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import SPECIFICATION

RANGES_M = np.linspace(0.5, 25.0, 246)


def reach(scene: Scene) -> tuple[float, float] | None:
    """Return from where to where the Cramer-Rao bound of an aligned pose meets the specification.

    Parameters
    ----------
    scene
        The scene; what its prior leaves uncertain counts as unknown.

    Returns
    -------
    tuple of float or None
        Nearest and farthest range about the lamp's reference range, m, within `RANGES_M` and to
        its step; ``None`` where the bound is larger even at the reference range.
    """
    poses = np.zeros((len(RANGES_M), 5))
    poses[:, X] = -RANGES_M
    std = cramer_rao_bound(ForwardModel(scene), poses).std * IN_DEGREES
    beyond = np.flatnonzero(~(std <= SPECIFICATION).all(axis=1))
    own = int(np.abs(RANGES_M - scene.lamp.reference_range_m).argmin())
    if own in beyond:
        return None
    first = beyond[beyond < own].max(initial=-1) + 1
    last = beyond[beyond > own].min(initial=len(RANGES_M)) - 1
    return float(RANGES_M[first]), float(RANGES_M[last])
