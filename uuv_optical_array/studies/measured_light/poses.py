"""Places and poses by readings of a room: parts of ``study measured``."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from uuv_optical_array.cli import progress
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.processes import spread
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.layouts.detectors import Layout, layout_of, of_scene, with_power
from uuv_optical_array.layouts.poses import PoseFit
from uuv_optical_array.recording.places import LEAST_STD
from uuv_optical_array.studies.measured_light.room import (
    HEIGHT_M,
    NOISE,
    PHOTODIODE,
    SIDE,
    Lamp,
    Room,
    poses_below,
    scene_of,
)
from uuv_optical_array.studies.shared.errors import FrameErrors, errors_of

# A virtual array's centres about a lamp, and the places that a reading is made of.
ABOUT_M, CENTRES, AROUND_M, LEAST_PLACES = 0.8, 9, 0.45, 12
ATTITUDE_STD = np.radians(2.0)  # of pitch and yaw by an inertial unit
BY_LAMP = "lamp_power_std", "beam_sigma_std_deg", "lamp_aim_std_deg"


def positions(room: Room, lamps: Sequence[Lamp]) -> Array:
    """Return errors and standard deviations of places in the plane, m, ``(m, 2, 2)``; or nan.

    Height, heading and a level vehicle are known.
    """
    origin = np.mean([lamp.place for lamp in lamps], axis=0)
    powers = [lamp.found.parameters[0].value for lamp in lamps]
    noise = np.sqrt(np.mean(np.square([lamp.noise for lamp in lamps]), axis=0))
    own = [
        {
            "floor_counts": lamp.floor,
            "y_m": float(lamp.place[0] - origin[0]),
            "z_m": float(lamp.place[1] - origin[1]),
            "power": power / float(np.mean(powers)),
            "beam_sigma_deg": lamp.found.scene.lamp.beam_sigma_deg,
        }
        for lamp, power in zip(lamps, powers, strict=True)
    ]
    effects = {
        "attenuation": {"k_per_m": 0.0},
        "sensor_noise": dict(zip(NOISE, noise.tolist(), strict=True)),
        "demodulation": {"waveform": "square", "pedestal_counts": 0.0},
    }
    prior = {
        "known": "calibrated",
        "k_std_per_m": 0.0,
        "roll_std_deg": 0.0,
        "lamps_floor_std_counts": max(
            lamp.found.scene.prior.lamp_floor_std_counts for lamp in lamps
        ),
    }
    table = {"x_m": [-3.4, -1.4, 9], "y_m": [-3, 3, 13], "z_m": [-3, 3, 13],
             "pitch_deg": [-25, 25, 9], "yaw_deg": [-25, 25, 9]}  # fmt: skip
    scene = scene_of(effects=effects, prior=prior, table=table, lamps=own)
    layout = layout_of(scene, PHOTODIODE)
    # The power of all lamps together is the sum of theirs; a sine of the detection is in both.
    bright = with_power(layout.scene.settings(), "room", sum(powers))
    layout = Layout(bright, PHOTODIODE, layout.array)
    fit = PoseFit(layout, 1e-5)
    images = layout.images(room.readings[:, :, None])
    poses = poses_below(room.places, origin)
    given = poses.copy()
    given[:, 1:3] = np.nan
    exact = np.full(5, LEAST_STD)

    def one(k: int) -> Array:
        found = fit.one(images[k], given[k], exact, 0.0)
        std = np.sqrt(found.covariance.diagonal())[1:3]
        return np.array([(found.pose - poses[k])[1:3], std])

    rows = progress.over(spread(one, len(poses), None, 64), "place", len(poses), "places")
    return np.array(list(rows))


def virtual_array(room: Room, lamp: Lamp, known: str, seed: int) -> dict[str, Any]:
    """Return figures of poses of an array whose readings are interpolated from those of a room.

    Of the attitude nothing is known, or each angle to `ATTITUDE_STD` of a vehicle that draws its
    errors by the seed, or all.
    """
    along = np.linspace(-ABOUT_M, ABOUT_M, CENTRES)
    grid = np.array(np.meshgrid(along, along)).reshape(2, -1).T
    spots = ForwardModel(scene_of()).array.positions[:, 1:3]
    around = [interpolation(room.places - lamp.place, centre, spots) for centre in grid]
    centres = [i for i, weights in enumerate(around) if weights is not None]
    if not centres:
        return {"centres": 0}
    weights = np.array([around[i] for i in centres])
    readings = room.readings[:, lamp.channel] - lamp.floor
    images = np.exp(weights @ np.log(np.maximum(readings, 1.0))) + lamp.floor
    frames, where = images.reshape(-1, SIDE, SIDE), np.zeros((len(centres), 5))
    where[:, 0], where[:, 1:3] = -HEIGHT_M, grid[centres]
    scene = _scene_of_array(lamp, known, relative_error(room, lamp, where, weights))
    estimator, model = Estimator(scene).wait(), ForwardModel(scene)
    result = {
        "centres": len(where),
        "error": scene.effects["sensor_noise"]["relative"] / lamp.noise[1],
        "open": errors_of(estimator, model, where, frames, f"{known}").summary(),
    }
    fit = PoseFit(layout_of(scene, of_scene(scene)), estimator.settings.max_misfit)
    rng = np.random.default_rng(seed)
    for name, std in (("attitude", ATTITUDE_STD), ("level", LEAST_STD)):
        stds = np.array([*[LEAST_STD] * 3, std, std])
        given = np.where([True, True, True, False, False], np.nan, where)
        given[:, 3:] += std * rng.standard_normal((len(where), 2)) * (std > LEAST_STD)
        found = [fit.one(*each, stds, 0.0) for each in zip(frames, given, strict=True)]
        errors = np.array([each.pose for each in found]) - where
        covariances = np.array([each.covariance for each in found])
        result[name] = FrameErrors(errors, covariances, np.zeros(0), np.zeros(0)).summary()
    return result


def interpolation(places: Array, centre: Array, spots: Array) -> Array | None:
    """Return weights of readings at places that give those of an array, ``(n, m)``, if there are.

    Each is a quadratic that is fitted to the places about the detector, all around it.
    """
    rows = np.zeros((len(spots), len(places)))
    for row, spot in zip(rows, centre + spots, strict=True):
        off = places - spot
        near = np.hypot(*off.T) < AROUND_M
        quarters = {(x > 0, y > 0) for x, y in off[near].tolist()}
        if near.sum() < LEAST_PLACES or len(quarters) < 4:
            return None  # nothing is extrapolated
        u, v = off[near].T
        design = np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])
        row[near] = np.linalg.pinv(design)[0]
    return rows


def relative_error(room: Room, lamp: Lamp, poses: Array, weights: Array) -> float:
    """Return the error of an array's reading over that of a photodiode which tells poses as well.

    Its readings share places, and light from walls is off by as much at places near each other: so
    a pose errs by more than by as large errors of independent detectors. The square is the mean
    variance of the place of a level array, over that by single readings of its own.
    """
    apart = np.linalg.norm(room.places[:, None] - room.places, axis=2)
    together = lamp.pattern.share * np.exp(-0.5 * (apart / lamp.pattern.length_m) ** 2)
    np.fill_diagonal(together, 1.0)
    light, slopes = ForwardModel(scene_of(lamp=lamp.found.scene.settings()["lamp"])).linearised(
        poses
    )
    ratios = []
    for each, by_place, rows in zip(light - lamp.floor, slopes[..., :3], weights, strict=True):
        relative = by_place / each[:, None]
        spread = np.linalg.pinv(relative) @ rows
        ratios.append(np.trace(relative @ spread @ together @ spread.T @ relative.T) / 3)
    return float(np.sqrt(np.mean(ratios)))


def _scene_of_array(lamp: Lamp, known: str, error: float) -> Scene:
    """Return the scene of a virtual array below a lamp, of readings with a part of its noise."""
    prior: dict[str, Any] = {"known": known, "k_std_per_m": 0.0}
    if known == "calibrated":
        own = lamp.found.scene.prior
        for key in (*BY_LAMP, "lamp_floor_std_counts"):
            prior[key] = getattr(own, key)
        prior["cosine_power_std"] = 0.0
    scene = scene_of(lamp=lamp.found.scene.settings()["lamp"], prior=prior)
    settings = scene.settings()
    power = lamp.found.parameters[0].value
    settings["lamp"]["reference_counts"] *= power / ForwardModel(scene).power
    noise = dict(zip(NOISE, (error * np.array(lamp.noise)).tolist(), strict=True))
    settings["effects"]["sensor_noise"] = noise
    return scene_from_settings(settings, "room")
