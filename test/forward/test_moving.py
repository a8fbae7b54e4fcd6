"""What changes with time: flicker, drift and clouds, and that estimators do not see them."""

import math

import numpy as np
import pytest
import second_forward

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

AHEAD = [-5.0, 0.1, -0.1, 0.05, 0.1]
FLICKER = {"lamp_flicker": {"depth": 0.2, "frequency_hz": 100.0}}
DRIFT = {"lamp_drift": {"std": 0.1, "time_scale_s": 20.0, "seed": 1}}
CLOUDS = {"depth": 1.5, "size_m": 0.15, "speed_m_per_s": 0.2, "distance_m": 2.5, "seed": 3}
PLUME = {"plume": CLOUDS}


def model_with(**chosen):
    settings = load_scene("reference").settings()
    return ForwardModel(scene_from_settings({**settings, "effects": chosen}, "test"))


@pytest.mark.parametrize("chosen", [FLICKER, DRIFT, PLUME], ids=["flicker", "drift", "plume"])
def test_without_a_moment_there_is_the_mean_sea_which_estimators_believe(chosen):
    still, moving = model_with(), model_with(**chosen)
    np.testing.assert_array_equal(moving.expose(AHEAD), still.light(AHEAD))
    for found, expected in zip(moving.linearised(AHEAD), still.linearised(AHEAD), strict=True):
        np.testing.assert_array_equal(found, expected)
    moments = np.linspace(3.003, 50.0, 40)
    seen = moving.expose(np.broadcast_to(AHEAD, (40, 5)), time_s=moments)
    assert not np.allclose(seen, still.light(AHEAD), rtol=1e-2)


@pytest.mark.parametrize("chosen", [FLICKER, DRIFT, PLUME], ids=["flicker", "drift", "plume"])
def test_many_moments_at_once_are_each_alone_and_come_again_by_the_seed(chosen):
    moments = np.array([[0.0, 1.234, 7.7], [20.0, 33.3, 1.7e9]])
    poses = np.array(AHEAD) + 0.1 * np.random.default_rng(2).standard_normal((2, 3, 5))
    together = model_with(**chosen).expose(poses, time_s=moments)
    again = model_with(**chosen)
    for place in np.ndindex(2, 3):
        alone = again.expose(poses[place], time_s=moments[place])
        np.testing.assert_allclose(together[place], alone, rtol=1e-12)


def test_a_flicker_is_a_sine_of_the_time():
    model, still = model_with(**FLICKER), model_with().light(AHEAD)
    for time_s in (0.0, 0.0025, 0.0071, 12.3456):
        ratio = model.expose(AHEAD, time_s=time_s) / still
        expected = 1 + 0.2 * math.sin(2 * math.pi * 100 * time_s)
        np.testing.assert_allclose(ratio, expected, rtol=1e-9)


LAMPS = 200


def test_the_drift_has_the_stated_spread_and_correlation():
    # Over many lamps, as one record of 16 waves is not long enough.
    now, later = [], []
    still = model_with().light(AHEAD).max()
    for seed in range(LAMPS):
        model = model_with(lamp_drift={"std": 0.1, "time_scale_s": 20.0, "seed": seed})
        both = np.log(model.expose([AHEAD, AHEAD], time_s=[100.0, 120.0]).max(axis=(1, 2)) / still)
        now.append(both[0])
        later.append(both[1])
    assert np.std(now) == pytest.approx(0.1, rel=4 / math.sqrt(2 * LAMPS))
    assert abs(np.mean(now)) < 5 * 0.1 / math.sqrt(LAMPS)
    assert np.corrcoef(now, later)[0, 1] == pytest.approx(
        math.exp(-0.5), abs=4 * (1 - math.exp(-1)) / math.sqrt(LAMPS)
    )


@pytest.mark.parametrize(("pitch", "yaw"), [(0.0, 0.0), (0.0, 0.3), (0.2, 0.3), (-0.4, -0.2)])
def test_clouds_dim_each_ray_where_it_pierces_their_plane(pitch, yaw):
    model = model_with(**PLUME)
    pose = np.array([-5.0, 0.4, -0.1, pitch, yaw])
    moments = np.arange(0.0, 60.0, 0.5)
    settings = model.scene.settings()
    clouds = settings["effects"]["plume"]
    expected = [
        [
            second_forward.plume(ray, None, **clouds)
            for ray in second_forward.rays(settings["array"], pose, 0.0, float(moment))
        ]
        for moment in moments
    ]
    found = model.expose(np.broadcast_to(pose, (120, 5)), time_s=moments).reshape(120, 25)
    still = model_with().light(pose).ravel()
    np.testing.assert_allclose(found, still * expected, rtol=1e-9)
    assert np.min(expected) < 0.5


def test_some_cloud_passes_and_dims_a_part_of_the_array_only():
    model, still = model_with(**PLUME), model_with().light(AHEAD)
    moments = np.arange(0, 50, 0.5)
    passed = model.expose(np.broadcast_to(AHEAD, (100, 5)), time_s=moments) / still
    assert (passed <= 1).all()
    assert passed.min() < 0.5
    assert passed.max() > 0.999
    spread = passed.max(axis=(1, 2)) - passed.min(axis=(1, 2))
    assert spread.max() > 0.2


def test_a_cloud_behind_the_array_dims_nothing():
    model = model_with(plume={**CLOUDS, "distance_m": 9.0})
    np.testing.assert_array_equal(model.expose(AHEAD, time_s=5.0), model.light(AHEAD))
