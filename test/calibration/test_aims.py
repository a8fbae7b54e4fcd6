"""Aims of lamp and array: beside SciPy's rotations of the lamp and of every detector."""

import numpy as np
import pytest
import second_forward
from scipy.spatial.transform import Rotation

from uuv_optical_array.calibration.aims import appearing
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

AIMS = np.array([0.07, -0.04, -0.06, 0.09])


def detectors_seen(array, pose, roll, aims):
    """Return places and normals of a turned array's detectors in the frame of a turned lamp."""
    lamp, mount = (
        Rotation.from_euler("ZYX", [yaw, pitch, 0.0]) for pitch, yaw in aims.reshape(2, 2)
    )
    body, bow = Rotation.from_euler("ZYX", [pose[4], pose[3], roll]), [array["bow_m"], 0, 0]
    places, normals = map(np.array, zip(*second_forward.detectors(array), strict=True))
    places = pose[:3] + body.apply(bow + mount.apply(places - bow))
    return lamp.inv().apply(places), (lamp.inv() * body * mount).apply(normals)


def test_the_pose_that_appears_has_every_detector_where_the_turned_lamp_sees_it():
    array = load_scene("follow").settings()["array"]
    rng = np.random.default_rng(1)
    poses = rng.uniform([-8, -1, -1, -0.4, -0.4], [-3, 1, 1, 0.4, 0.4], (8, 5))
    rolls = rng.uniform(-0.3, 0.3, 8)
    seen, seen_rolls, _ = appearing(poses, rolls, AIMS, array["bow_m"])
    for i, (pose, roll) in enumerate(zip(poses, rolls, strict=True)):
        places, normals = detectors_seen(array, pose, roll, AIMS)
        rays = second_forward.rays(array, seen[i], seen_rolls[i])
        np.testing.assert_allclose([[r.x, r.y, r.z] for r in rays], places, atol=1e-12)
        np.testing.assert_allclose([r.looks for r in rays], normals, atol=1e-12)


@pytest.mark.parametrize("start", ["follow", "leading_lights"])
@pytest.mark.parametrize("aims", [AIMS, np.zeros(4)])
def test_slopes_are_those_of_the_light(aims, start):
    scene = load_scene(start)
    model, bow_m = ForwardModel(scene), scene.array.bow_m
    turned = {"follower.roll_rad": np.zeros(1)} if scene.lamps else {}

    def light(x):
        seen, rolls, slopes = appearing(x[None, :5], x[5:6], x[6:], bow_m)
        light, by_own = model.linearised(seen, rolls, turned)
        return light[0], (by_own @ slopes[:, : by_own.shape[-1]])[0]

    at = np.array([-4.0, 0.5, -0.4, 0.3, -0.35, 0.2, *aims])
    _, slopes = light(at)
    for i, step in enumerate(1e-6 * np.eye(10)):
        differences = (light(at + step)[0] - light(at - step)[0]) / 2e-6
        np.testing.assert_allclose(slopes[:, i], differences, atol=1e-4 * np.abs(slopes).max())
