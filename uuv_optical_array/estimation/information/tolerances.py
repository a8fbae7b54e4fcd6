"""How errors of building change the pose, to first order."""

import dataclasses

import numpy as np

from uuv_optical_array.core.geometry import Array, turned_about_lamp, turned_on_mount
from uuv_optical_array.estimation.information.likelihood import information
from uuv_optical_array.forward.lamp.lamps import DEGREE
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import RADIUS
from uuv_optical_array.forward.scene import Scene

MILLIMETRE, PERCENT = 1e-3, 0.01


def tolerances(scene: Scene, pose: Array) -> dict[str, Array]:
    """Return the RMS error of the most probable pose by each error of building.

    The estimate follows the light with the weights of the maximum likelihood; what the scene's
    prior leaves uncertain takes its share. Errors of single detectors are independent. Those of the
    pose, shape ``(5,)``, m and rad, are by what is wrong.
    """
    model = ForwardModel(scene)
    stds = scene.nuisance_std()
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

    # A turn about its own normal changes nothing, so two of the three count.
    shifts = [change(MILLIMETRE * axis, np.zeros(3)) for axis in np.eye(3)]
    turns = [change(np.zeros(3), DEGREE * axis) for axis in np.eye(3)]
    errors = {
        "each detector off by 1 mm": follow[:, None] * shifts,
        "each detector tilted by 1 deg": follow[:, None] * turns,
        "each gain off by 1 %": follow * (PERCENT * (light - model.noise.black)),
        "the array turned by 1 deg": DEGREE * turned_on_mount(pose, 0.0, scene.array.bow_m),
        "the lamp turned by 1 deg": DEGREE * turned_about_lamp(pose),
    }
    if scene.array.radius_m:
        larger = np.asarray(np.log1p(MILLIMETRE / scene.array.radius_m))
        sphere = model.light(pose, offsets={RADIUS: larger}).ravel() - light
        errors["the sphere's radius off by 1 mm"] = follow @ sphere
    return {
        name: np.sqrt(np.square(each).reshape(5, -1).sum(axis=1)) for name, each in errors.items()
    }
