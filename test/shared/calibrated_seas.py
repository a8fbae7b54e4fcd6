"""Seas to calibrate in, drives through them, and their truth."""

import numpy as np
from scipy import stats

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

LOWEST = np.array([-8.0, -0.8, -0.8, -0.35, -0.35])
HIGHEST = np.array([-3.0, 0.8, 0.8, 0.35, 0.35])


def sea(start="reference", gains=(0.05, 9), **changes):
    """Return a scene with other values, by dotted name."""
    plain = load_scene(start).settings()
    plain["effects"]["ambient"] = {"level_counts": 12.0}
    if gains:
        plain["effects"]["responsivity"] = dict(zip(("spread", "seed"), gains, strict=True))
    named = {
        "lamp.beam_sigma_deg": 6.5,
        "lamp.reference_counts": 600.0,
        "attenuation.k_per_m": 0.17,
        **{name.replace("__", "."): value for name, value in changes.items()},
    }
    for name, value in named.items():
        group, key = name.split(".")
        home = plain if group in plain else plain["effects"]
        home[group] = {**home.get(group, {}), key: value}
    return scene_from_settings(plain, "sea")


def drive(rng, count, low=LOWEST, high=HIGHEST):
    return rng.uniform(low, high, (count, 5)), rng.uniform(-0.1, 0.1, count)


def recorded(scene, count, seed):
    """Return images, poses and rolls of a drive through a sea."""
    rng = np.random.default_rng(seed)
    poses, rolls = drive(rng, count)
    return ForwardModel(scene).expose(poses, rng, rolls), poses, rolls


def truth_of(scene):
    """Return power, sigma, K and background in the gauge of the fit, and the gains."""
    model = ForwardModel(scene)
    side = scene.array.detectors_per_side
    spec = scene.effects.get("responsivity")
    gains = np.ones((side, side))
    if spec:
        draws = np.random.default_rng(spec["seed"]).standard_normal((side, side))
        gains = 1 + spec["spread"] * draws
    common = stats.gmean(gains, axis=None)
    ambient = scene.effects.get("ambient", {"level_counts": 0.0})["level_counts"]
    lamp = np.array(
        [
            model.power * common,
            scene.lamp.beam_sigma_deg,
            scene.effects["attenuation"]["k_per_m"],
            ambient * common,
        ]
    )
    return lamp, gains / common
