"""How poses appear where lamp and array do not stand or point exactly as the scene says.

No image determines it: the same light belongs to another pose. So the aim is no constant that a fit
could learn, but a part of the pose's covariance that is the same in every frame. So is how far
behind its face a lamp's light seems to come from.
"""

import math

import numpy as np

from uuv_optical_array.core.geometry import Array, X, turned_about_lamp, turned_on_mount
from uuv_optical_array.forward.scene import Scene


def aim_count(scene: Scene) -> int:
    """Return how many aims there are: of array and lamp, and the depth of its source if unknown."""
    return 4 if scene.prior.lamp_behind_std_m == 0 else 5


def aim_slopes(scene: Scene, pose: Array, roll: float = 0.0) -> Array:
    """Return by how much a pose is off by one standard deviation of each aim, shape ``(5, k)``.

    Columns are pitch and yaw of the array on its mount, then of the lamp, and, where the scene's
    prior has it, ``lamp.behind_m``; the pose is in m and rad.
    """
    prior = scene.prior
    of_array, of_lamp = map(math.radians, (prior.aim_std_deg, prior.lamp_aim_std_deg))
    on_mount = turned_on_mount(pose, roll, scene.array.bow_m)
    slopes = np.zeros((5, aim_count(scene)))
    slopes[:, :2], slopes[:, 2:4] = of_array * on_mount, of_lamp * turned_about_lamp(pose)
    # What lies farther ahead looks as from farther astern.
    slopes[X, 4:] = -prior.lamp_behind_std_m
    return slopes


def apparent(scene: Scene, poses: Array, aims: Array) -> Array:
    """Return poses ``(n, 5)`` as they appear under aims ``(n, k)`` in standard deviations."""
    moved = [aim_slopes(scene, pose) @ aim for pose, aim in zip(poses, aims, strict=True)]
    return poses + np.array(moved).reshape(poses.shape)
