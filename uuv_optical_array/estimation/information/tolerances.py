"""What errors of building cost in the pose, to first order."""

import dataclasses

import numpy as np

from uuv_optical_array.core.geometry import Array, turned_about_lamp, turned_on_mount
from uuv_optical_array.estimation.information.likelihood import information
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import RADIUS
from uuv_optical_array.forward.scene import Scene

MILLIMETRE, DEGREE, PERCENT = 1e-3, np.radians(1.0), 0.01


def tolerances(scene: Scene, pose: Array) -> dict[str, Array]:
    """Return the RMS error of the most probable pose by each error of building.

    The light changes as the array or the lamp does, the estimate follows it with the weights of
    the maximum likelihood; what the scene's prior leaves uncertain takes its share. Errors of
    single detectors are independent. The error grows in proportion to its cause.

    - scene: as the estimator has it.
    - pose: shape ``(5,)``, m and rad.
    - returned: errors in x, y, z, pitch and yaw, m and rad, shape ``(5,)``, by what is wrong.
    """
    model = ForwardModel(scene)
    stds = scene.prior.nuisance_std()
    light, jacobian = model.linearised(pose, offsets={name: np.zeros(()) for name in stds})
    weighted = jacobian.T * information(light, model.noise)
    precision = np.diag([*np.zeros(5), *(std**-2.0 for std in stds.values())])
    follow = np.linalg.solve(weighted @ jacobian + precision, weighted)[:5]
    built = model.array

    def change(shift: Array, turn: Array) -> Array:
        """Return how the light changes where detectors shift, m, and turn, rad, ``(3,)`` each."""
        normals = built.normals + np.cross(turn, built.normals)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        model.array = dataclasses.replace(built, positions=built.positions + shift, normals=normals)
        changed = np.asarray(model.light(pose)).ravel() - light
        model.array = built
        return changed

    none, axes = np.zeros(3), np.eye(3)
    independent = {
        "each detector off by 1 mm": [change(MILLIMETRE * axis, none) for axis in axes],
        # A turn about its own normal changes nothing, so two of the three count.
        "each detector tilted by 1 deg": [change(none, DEGREE * axis) for axis in axes],
        "each gain off by 1 %": [PERCENT * light],
    }
    errors = {
        name: np.sqrt(sum(((follow * each) ** 2).sum(axis=1) for each in changes))
        for name, changes in independent.items()
    }
    if scene.array.radius_m:
        larger = np.log1p(MILLIMETRE / scene.array.radius_m)
        sphere = model.light(pose, offsets={RADIUS: np.asarray(larger)})
        errors["the sphere's radius off by 1 mm"] = np.abs(follow @ (sphere.ravel() - light))
    for name, slopes in (
        ("the array turned by 1 deg", turned_on_mount(pose, 0.0, scene.array.bow_m)),
        ("the lamp turned by 1 deg", turned_about_lamp(pose)),
    ):
        errors[name] = DEGREE * np.sqrt((np.asarray(slopes) ** 2).sum(axis=1))
    return errors
