"""Scenes that several tests use, and how well they let a pose be known."""

import dataclasses
import functools
from types import MappingProxyType

import numpy as np

from uuv_optical_array.core.geometry import wrapped
from uuv_optical_array.core.storage.files import shared_file
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.scene import Scene, load_scene, scene_from_settings

READY = sorted(path.stem for path in shared_file("config/scenes").glob("*.yaml"))
SHAPES = ("planar", "curved")
WATER = {"attenuation": {"k_per_m": 0.1}, "sensor_noise": {"sigma_counts": 1.0}}


@functools.cache
def ready(name):
    """Return a ready scene, read once: to parse its files takes longer than most of a test."""
    return load_scene(name)


def make_scene(shape="curved", side=5, effects=WATER, prior=None, **lamp):
    scene = ready("reference").settings()
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
    scene = scene if isinstance(scene, Scene) else ready(scene)
    plain = scene.settings() | ({"prior": {}} if "prior" in changes else {})
    return scene_from_settings(merged(plain, changes), "changed")


def nested(name, value):
    """Return settings with one value, by its dotted name."""
    return functools.reduce(lambda inner, key: {key: inner}, reversed(name.split(".")), value)


def with_prior(scene, **values):
    """Return a scene with other values in its prior."""
    return dataclasses.replace(scene, prior=dataclasses.replace(scene.prior, **values))


def coarse(scene, number=5):
    """Return a scene with `number` poses along each axis of its table."""
    scene = scene if isinstance(scene, Scene) else ready(scene)
    spans = scene.settings()["table"].items()
    return changed(scene, table={axis: [*span[:2], number] for axis, span in spans})


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
    off = wrapped(found.pose - pose)
    return off @ np.linalg.solve(found.covariance, off)


def seen_in(model, sea, pose, rng, offsets=MappingProxyType({})):
    """Expose an image in a drawn sea, but for its aims; offsets replace those of the sea."""
    light = model.light(pose, 0.0, {**sea.offsets, **offsets})
    return model.read(model.with_gains(light, sea.gains), rng)


def seen_in_each(model, seas, pose, rng, offsets=MappingProxyType({})):
    """Expose an image in each of several drawn seas, as `seen_in` does in one, all at once."""
    drawn = {name: [sea.offsets[name] for sea in seas] for name in seas[0].offsets}
    light = model.light(
        np.tile(pose, (len(seas), 1)),
        0.0,
        {name: np.resize(value, len(seas)) for name, value in {**drawn, **offsets}.items()},
    )
    return model.read(model.with_gains(light, np.array([sea.gains for sea in seas])), rng)
