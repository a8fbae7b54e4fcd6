"""Seas to calibrate in, drives through them, and their truth."""

import dataclasses

import numpy as np
from scenes import ready
from scipy import stats
from scipy.spatial.transform import Rotation

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import scene_from_settings

LOWEST = np.array([-8.0, -0.8, -0.8, -0.35, -0.35])
HIGHEST = np.array([-3.0, 0.8, 0.8, 0.35, 0.35])
# Pitch and yaw of the lamp, and of the array on its mount, rad.
STRAIGHT, TURNED = np.zeros(4), np.array([0.03, -0.02, -0.025, 0.015])
AIMS = "lamp.aim_pitch_rad", "lamp.aim_yaw_rad", "array.aim_pitch_rad", "array.aim_yaw_rad"


def sea(start="reference", gains=(0.05, 9), **changes):
    """Return a scene with other values, by dotted name."""
    plain = ready(start).settings()
    plain["effects"]["ambient"] = {"level_counts": 12.0}
    if gains:
        plain["effects"]["responsivity"] = dict(zip(("spread", "seed"), gains, strict=True))
    water = {"attenuation.k_per_m": 0.17}
    if "sea" in plain["effects"]:
        water = {"sea.absorption_per_m": 0.17, "sea.scattering_per_m": 0.16}
    named = {
        "lamp.beam_sigma_deg": 6.5,
        "lamp.reference_counts": 600.0,
        "field_of_view.cosine_power": 1.15,
        "array.radius_m": 0.33,
        **water,
        **{name.replace("__", "."): value for name, value in changes.items()},
    }
    for name, value in named.items():
        group, key = name.split(".")
        home = plain if group in plain else plain["effects"]
        home[group] = {**home.get(group, {}), key: value}
    return scene_from_settings(plain, "sea")


def lights(rng):
    """Return a sea with three lamps that are not quite as `leading_lights` has them."""
    scene = sea("leading_lights", gains=(0.03, 4))
    lamps = tuple(
        dataclasses.replace(
            lamp,
            **{key: getattr(lamp, key) + 0.01 * rng.normal() for key in ("x_m", "y_m", "z_m")},
            pitch_deg=lamp.pitch_deg + 0.4 * rng.normal(),
            yaw_deg=lamp.yaw_deg + 0.4 * rng.normal(),
            power=np.exp(0.3 * rng.normal()),
        )
        for lamp in scene.lamps
    )
    return dataclasses.replace(scene, lamps=lamps)


def drive(rng, count, low=LOWEST, high=HIGHEST):
    return rng.uniform(low, high, (count, 5)), rng.uniform(-0.1, 0.1, count)


def seen(poses, rolls, aims, bow_m):
    """Return poses and rolls as they appear to a turned lamp and a turned array, by SciPy."""
    lamp, mount = Rotation.from_euler("yz", np.reshape(aims, (2, 2)))
    body = Rotation.from_euler("ZYX", np.column_stack([poses[:, 4], poses[:, 3], rolls]))
    bow = np.array([bow_m, 0.0, 0.0])
    places = poses[:, :3] + body.apply(bow) - (body * mount).apply(bow)
    yaw, pitch, roll = (lamp.inv() * body * mount).as_euler("ZYX").T
    return np.column_stack([lamp.inv().apply(places), pitch, yaw]), roll


def exposed(scene, poses, rng, rolls=0.0, aims=STRAIGHT):
    """Return the images of a lamp and an array that may be turned."""
    rolls = np.broadcast_to(rolls, len(poses))
    poses, rolls = seen(poses, rolls, aims, scene.array.bow_m)
    return ForwardModel(scene).expose(poses, rng, rolls)


def recorded(scene, count, seed, aims=STRAIGHT):
    """Return images, poses and rolls of a drive through a sea."""
    rng = np.random.default_rng(seed)
    poses, rolls = drive(rng, count)
    return exposed(scene, poses, rng, rolls, aims), poses, rolls


def truth_of(scene, aims=STRAIGHT):
    """Return what a fit should find by name, in its gauge, and the gains."""
    side, effects = scene.array.detectors_per_side, scene.effects
    gains = np.ones((side, side))
    if spec := effects.get("responsivity"):
        draws = np.random.default_rng(spec["seed"]).standard_normal((side, side))
        gains = 1 + spec["spread"] * draws
    common = stats.gmean(gains, axis=None)
    values = {
        "lamp.power": ForwardModel(scene).power * common,
        "lamp.beam_sigma_deg": scene.lamp.beam_sigma_deg,
        "lamp.reference_counts": scene.lamp.reference_counts,
        "field_of_view.cosine_power": effects.get("field_of_view", {}).get("cosine_power", 1.0),
        "array.radius_m": scene.array.radius_m,
        **dict(zip(AIMS, aims, strict=True)),
        "ambient.level_counts": effects.get("ambient", {"level_counts": 0})["level_counts"]
        * common,
    }
    whole = stats.gmean([lamp.power for lamp in scene.lamps]) if scene.lamps else 1.0
    for i, lamp in enumerate(scene.lamps):
        own = {**dataclasses.asdict(lamp), "power": lamp.power / whole}
        values |= {f"lamps.{i}.{key}": value for key, value in own.items()}
    for water in ("attenuation", "sea"):
        values |= {f"{water}.{key}": value for key, value in effects.get(water, {}).items()}
    return values, gains / common


def named(found):
    """Return the parameters of a calibration by name."""
    return {parameter.name: parameter for parameter in found.parameters}


def pulls(found, scene, aims=STRAIGHT):
    """Return the errors of what was fitted, in standard errors: by name, and of the gains."""
    values, gains = truth_of(scene, aims)
    fitted = {
        name: (parameter.value - values[name]) / parameter.std
        for name, parameter in named(found).items()
        if name in values and np.isfinite(parameter.std)
    }
    off = ((found.gains - gains) / found.gain_std).ravel()
    return fitted, off[np.isfinite(off)]


def largest_pull(found, scene, aims=STRAIGHT):
    fitted, gains = pulls(found, scene, aims)
    return np.abs([*fitted.values(), *gains]).max()


def check_consistency(scene_of, start, fits, count, rng, pose_std=None, aims=TURNED, each=1):
    """Calibrate in many seas; errors over standard errors must be normal. Return the mean misfit.

    Of each place of a drive there are `each` images, and an error of its pose, which they share.
    """
    squares, of_gains, misfits = [], [], []
    places = np.repeat(np.arange(count), each)
    for _ in range(fits):
        scene = scene_of(rng)
        poses, rolls = drive(rng, count)
        images = exposed(scene, poses[places], rng, rolls[places], aims)
        if pose_std is not None:
            poses = poses + rng.normal(size=poses.shape) * pose_std
            rolls = rolls + bool(scene.lamps) * rng.normal(size=count) * pose_std[3]
        told = poses[places], rolls[places]
        found = calibrate(start, images, *told, pose_std=pose_std, places=places)
        assert not found.refusal
        fitted, gains = pulls(found, scene, aims)
        assert fitted.keys() == named(found).keys()
        squares.append({name: pull**2 for name, pull in fitted.items()})
        squares[-1]["all at once"], freedoms = whitened(found, fitted)
        of_gains.append(gains)
        misfits.append(found.misfit)
    for name in squares[0]:
        numbers = fits * (freedoms if name == "all at once" else 1)
        low, high = stats.chi2.ppf(stats.norm.cdf([-5, 5]), numbers)
        assert low < np.sum([square[name] for square in squares]) < high, name
    gains = np.mean(np.square(of_gains))
    assert 1 - 5 * np.sqrt(2 / (24 * fits)) < gains < 1 + 5 * np.sqrt(2 / (24 * fits)), gains
    return np.mean(misfits)


def whitened(found, fitted):
    """Return the square of all errors in standard errors, less their correlation, and its freedoms.

    Most are correlated so strongly that a standard error that is too small is seen better here.
    """
    errors = np.array([fitted[one.name] for one in found.parameters][: len(found.correlation)])
    sizes, axes = np.linalg.eigh(found.correlation)
    free = sizes > 1e-9  # the powers of several lamps have a mean of 1
    return np.sum((axes[:, free].T @ errors) ** 2 / sizes[free]), free.sum()
