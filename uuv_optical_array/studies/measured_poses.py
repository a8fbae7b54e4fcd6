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
from uuv_optical_array.studies.measured_room import (
    HEIGHT_M,
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


def positions(room: Room, lamps: Sequence[Lamp]) -> Array:
    """Return errors and standard deviations of places in the plane, m, ``(m, 2, 2)``; or nan.

    Height, heading and a level vehicle are known.
    """
    origin = np.mean([lamp.place for lamp in lamps], axis=0)
    powers = [lamp.found.parameters[0].value for lamp in lamps]
    own = [
        {
            "y_m": float(lamp.place[0] - origin[0]),
            "z_m": float(lamp.place[1] - origin[1]),
            "power": power / float(np.mean(powers)),
            "beam_sigma_deg": lamp.found.scene.lamp.beam_sigma_deg,
        }
        for lamp, power in zip(lamps, powers, strict=True)
    ]
    noise = np.array([lamp.noise for lamp in lamps])
    effects = {
        "attenuation": {"k_per_m": 0.0},
        "sensor_noise": {"sigma_counts": float(noise[:, 0].max())},
        "demodulation": {"waveform": "square", "pedestal_counts": 0.0},
    }
    prior = {
        "known": "calibrated",
        "k_std_per_m": 0.0,
        "gain_std": float(min(noise[:, 1].max(), 0.3)),
        "roll_std_deg": 0.0,
    }
    table = {"x_m": [-3.4, -1.4, 9], "y_m": [-3, 3, 13], "z_m": [-3, 3, 13],
             "pitch_deg": [-25, 25, 9], "yaw_deg": [-25, 25, 9]}  # fmt: skip
    scene = scene_of(effects=effects, prior=prior, table=table, lamps=own)
    layout = layout_of(scene, PHOTODIODE)
    # The power of all lamps together is the sum of theirs; a sine of the detection is in both.
    bright = with_power(layout.scene.settings(), "room", sum(powers))
    layout = Layout(bright, PHOTODIODE, layout.array)
    fit = PoseFit(layout, 1e-5)
    floors = np.array([lamp.floor for lamp in lamps])
    images = layout.images((room.readings - floors)[:, :, None])
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


def virtual_array(room: Room, lamp: Lamp, i: int, known: str) -> dict[str, Any]:
    """Return figures of poses of an array whose readings are interpolated from those of a room.

    Those of a level vehicle, whose pitch and yaw are known, are beside them.

    Each is a quadratic of the logarithm, fitted to the places about the detector.
    """
    along = np.linspace(-ABOUT_M, ABOUT_M, CENTRES)
    grid = np.array(np.meshgrid(along, along)).reshape(2, -1).T
    spots = ForwardModel(scene_of()).array.positions[:, 1:3]
    poses, images, shares = [], [], []
    logarithms = np.log(np.maximum(room.readings[:, i] - lamp.floor, 1.0))
    for centre in grid:
        values, variances = np.transpose(
            [_interpolated(room.places - lamp.place, logarithms, centre + s) for s in spots]
        )
        if np.isfinite(values).all():
            poses.append([-HEIGHT_M, *centre, 0.0, 0.0])
            images.append(np.exp(values))
            shares.append(variances.mean())
    if not poses:
        return {"centres": 0}
    scene = _scene_of_array(lamp, known, lamp.noise[1] * float(np.mean(shares)) ** 0.5)
    where, model = np.array(poses), ForwardModel(scene)
    frames = np.array(images).reshape(-1, SIDE, SIDE)
    estimator = Estimator(scene).wait()
    of = errors_of(estimator, model, where, frames, f"lamp {i}, {known}").summary()
    # A level vehicle is known: the same images, with pitch and yaw.
    fit = PoseFit(layout_of(scene, of_scene(scene)), estimator.settings.max_misfit)
    given = np.where([True, True, True, False, False], np.nan, where)
    found = [
        fit.one(each, at, np.full(5, LEAST_STD), 0.0)
        for each, at in zip(frames, given, strict=True)
    ]
    errors = np.array([each.pose for each in found]) - where
    covariances = np.array([each.covariance for each in found])
    level = FrameErrors(errors, covariances, np.zeros(0), np.zeros(0)).summary()
    return {"centres": len(where), "share": scene.prior.gain_std, **of, "level": level}


def _scene_of_array(lamp: Lamp, known: str, share: float) -> Scene:
    """Return the scene of a virtual array below a lamp, of readings with a relative error."""
    prior: dict[str, Any] = {"known": known, "k_std_per_m": 0.0, "gain_std": share}
    if known == "calibrated":
        own = lamp.found.scene.prior
        for key in ("lamp_power_std", "beam_sigma_std_deg", "lamp_aim_std_deg"):
            prior[key] = getattr(own, key)
        prior["cosine_power_std"] = 0.0
    scene = scene_of(lamp=lamp.found.scene.settings()["lamp"], prior=prior)
    settings = scene.settings()
    power = lamp.found.parameters[0].value
    settings["lamp"]["reference_counts"] *= power / ForwardModel(scene).power
    settings["effects"]["sensor_noise"]["sigma_counts"] = lamp.noise[0] * share / lamp.noise[1]
    return scene_from_settings(settings, "room")


def _interpolated(places: Array, logarithms: Array, at: Array) -> tuple[float, float]:
    """Return the logarithm of a reading, and its variance over that of a single one."""
    off = places - at
    near = np.hypot(*off.T) < AROUND_M
    # All around it: nothing is extrapolated.
    quarters = {(x > 0, y > 0) for x, y in off[near].tolist()}
    if near.sum() < LEAST_PLACES or len(quarters) < 4:
        return np.nan, np.nan
    u, v = off[near].T
    design = np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    first = np.linalg.pinv(design)[0]
    return float(first @ logarithms[near]), float(first @ first)
