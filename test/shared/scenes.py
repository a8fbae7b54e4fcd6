"""Scenes that several tests use, and how well they let a pose be known."""

import numpy as np

from uuv_optical_array.core.storage.files import shared_file
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

READY = sorted(path.stem for path in shared_file("config/scenes").glob("*.yaml"))
SHAPES = ("planar", "curved")
WATER = {"attenuation": {"k_per_m": 0.1}, "sensor_noise": {"sigma_counts": 1.0}}


def make_scene(shape="curved", side=5, effects=WATER, prior=None, **lamp):
    scene = load_scene("reference").settings()
    scene["array"].update(shape=shape, detectors_per_side=side)
    if shape == "planar":
        del scene["array"]["radius_m"]
    scene["lamp"].update(lamp)
    return scene_from_settings({**scene, "effects": effects, "prior": prior}, "test")


def merged(settings, changes):
    if not isinstance(changes, dict):
        return changes
    values = {key: merged(settings.get(key) or {}, value) for key, value in changes.items()}
    return {key: value for key, value in {**settings, **values}.items() if value is not None}


def changed(scene, **changes):
    """Return a scene with other settings: groups are merged, and None takes away.

    A prior is replaced, as its settings hold all that `known` stands for.
    """
    scene = load_scene(scene) if isinstance(scene, str) else scene
    plain = scene.settings() | ({"prior": {}} if "prior" in changes else {})
    return scene_from_settings(merged(plain, changes), "changed")


def coarse(scene, number=5):
    """Return a scene with `number` poses along each axis of its table."""
    return scene_from_settings(coarse_settings(load_scene(scene), number), "coarse")


def coarse_settings(scene, number=5):
    """Return the settings of a scene with `number` poses along each axis of its table."""
    settings = scene.settings()
    settings["table"] = {key: [*span[:2], number] for key, span in settings["table"].items()}
    return settings


def std_m_deg(model, poses):
    return cramer_rao_bound(model, poses).std * [1, 1, 1, *np.degrees([1, 1])]


def assert_same_estimate(found, expected):
    """Compare poses and covariances by the standard deviations."""
    std = np.sqrt(expected.covariance.diagonal())
    np.testing.assert_allclose(found.pose / std, expected.pose / std, rtol=0, atol=1e-5)
    scale = np.outer(std, std)
    np.testing.assert_allclose(
        found.covariance / scale, expected.covariance / scale, rtol=0, atol=1e-7
    )


def squared_error(found, pose):
    """Return the squared error of an estimate, normalised by its covariance."""
    off = found.pose - pose
    return off @ np.linalg.solve(found.covariance, off)
