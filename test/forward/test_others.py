"""Lamps and bodies of other vehicles, beside sums of images and shadows by similar triangles."""

import dataclasses

import numpy as np
import pytest
from designs import scene_with
from scenes import READY, changed
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.geometry import relative_pose
from uuv_optical_array.forward.aim import apparent
from uuv_optical_array.forward.drawn_sea import draw_sea
from uuv_optical_array.forward.lamp.lamps import ring_of_lamps
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.others import BODY_LENGTH_M, BODY_RADIUS_M, Other, sight
from uuv_optical_array.forward.prior import POWER, power_offsets
from uuv_optical_array.forward.scene import load_scene

AHEAD = np.eye(3)
LAMP_M = (-0.4, 0.0, 0.1)
CODED = {
    "ambient": {"level_counts": 300.0},
    "sensor_noise": {"sigma_counts": 2.0},
    "shot_noise": {"electrons_per_count": 50.0},
    "saturation": {"level_counts": 2000.0},
    "demodulation": {"waveform": "square", "pedestal_counts": 30.0},
}


def placed(x=0.0, y=0.0, z=0.0, turn=None, **others):
    rotation = AHEAD if turn is None else Rotation.from_euler("ZYX", turn, degrees=True).as_matrix()
    return Other(np.array([x, y, z]), rotation, **others)


def place_of(other):
    return other.position, other.rotation


def pose_from(follower, other):
    return relative_pose(other.beacon, other.rotation, follower.position, follower.rotation)


@pytest.mark.parametrize("name", READY)
def test_alone_it_is_the_light_of_the_model(name):
    model = ForwardModel(load_scene(name))
    leader = placed(3.0, -2.0, 1.0, (70.0, 5.0, -4.0), lamp_m=LAMP_M)
    at = leader.beacon + leader.rotation @ [-5.0, 0.2, -0.3]
    follower = Other(at, leader.rotation @ placed(turn=(4.0, -3.0, 6.0)).rotation)
    offsets = power_offsets([0.7], model.scene.lamp_count)
    pose, roll = pose_from(follower, leader)
    found = sight(model, place_of(follower), leader, (), offsets, 12.5)
    np.testing.assert_allclose(found.light, model.light(pose, roll, offsets, 12.5), rtol=1e-9)
    assert found.light.max() > 10
    assert not found.beside.any()


@pytest.mark.parametrize("name", ["coastal", "night_plume", "leading_lights"])
def test_lamps_add_up_before_daylight_gains_and_pedestal(name):
    model = ForwardModel(load_scene(name))
    leader = placed(lamp_m=LAMP_M)
    other = placed(1.0, 1.6, 0.2, (12.0, 3.0, 2.0), power=0.6, lamp_m=LAMP_M)
    follower = placed(-5.0, 0.3, -0.2, (5.0, -2.0, 3.0))
    offsets = {name: np.array(0.0) for name in power_offsets([1.0], model.scene.lamp_count)}
    apart = []
    for each in (leader, other):
        pose, roll = pose_from(follower, each)
        powers = power_offsets([each.power], model.scene.lamp_count)
        apart.append(model.light(pose, roll, powers, 3.0))
    pose, roll = pose_from(follower, leader)
    dark = model.light(pose, roll, power_offsets([0.0], model.scene.lamp_count), 3.0)
    assert min(np.ptp(each - dark) for each in apart) > 20
    found = sight(model, place_of(follower), leader, [other], offsets, 3.0)
    np.testing.assert_allclose(found.light, sum(apart) - dark, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["sunlit_modulated", "leading_lights"])
def test_a_drawn_sea_turns_what_is_aimed_and_has_the_gains_for_stray_light_too(name):
    scene = load_scene(name)
    model, sea = ForwardModel(scene), draw_sea(scene, np.random.default_rng(2))
    leader, follower = placed(1.0, 2.0, 0.5), placed(-4.0, 2.3, 0.3, (4.0, -3.0, 6.0))
    other = placed(0.8, 3.4, 0.6, (6.0, -3.0, 11.0), code=1)
    pose, roll = pose_from(follower, leader)
    (aimed,) = apparent(scene, pose[None], sea.aims[None])
    turned = Rotation.from_euler("ZYX", [aimed[4], aimed[3], roll]).as_matrix()
    dimmed = power_offsets([0.7], scene.lamp_count)
    both = {
        key: sea.offsets.get(key, 0.0) + dimmed.get(key, 0.0) for key in {**dimmed, **sea.offsets}
    }
    exact = sight(model, (aimed[:3] + leader.position, turned), leader, [other], both, 1.0)
    found = sight(model, place_of(follower), leader, [other], dimmed, 1.0, sea)
    gains = np.concatenate([sea.gains] * scene.lamp_count)
    black = model.noise.black
    np.testing.assert_allclose(found.light, black + gains * (exact.light - black), rtol=1e-9)
    np.testing.assert_allclose(found.beside, gains * exact.beside, rtol=1e-9)
    assert np.ptp(sea.gains) > 0.005
    assert abs(exact.light - sight(model, place_of(follower), leader).light).max() > 20
    assert exact.beside.max() > 20


@pytest.mark.parametrize("name", ["sunlit_modulated", "leading_lights"])
def test_a_floor_is_light_of_its_lamp_and_goes_out_with_it(name):
    scene = load_scene(name)
    lamps = tuple(dataclasses.replace(each, floor_counts=30.0) for each in scene.lamps)
    lamp = dataclasses.replace(scene.lamp, floor_counts=0.0 if lamps else 30.0)
    scene = dataclasses.replace(scene, lamp=lamp, lamps=lamps)
    model, leader, follower = ForwardModel(scene), placed(), placed(-5.0, 0.3)
    dark, half, whole, twice = (
        sight(model, place_of(follower), leader, (), power_offsets([power], scene.lamp_count)).light
        for power in (0.0, 0.5, 1.0, 2.0)
    )
    np.testing.assert_allclose(dark, scene.black_counts, atol=1e-9)
    assert (whole - dark).min() >= 30.0
    np.testing.assert_allclose(half - dark, 0.5 * (whole - dark))
    np.testing.assert_allclose(twice - dark, 2 * (whole - dark))


def test_a_power_of_the_leader_is_its_own_and_a_sea_is_of_all():
    model = ForwardModel(changed("follow", effects={"sensor_noise": None, "adc": None}))
    leader, follower = placed(), placed(-5.0)
    other = placed(0.5, 1.5)
    k = "sea.absorption_per_m"
    given = {k: np.array(0.05), POWER: np.log(0.25)}
    found = sight(model, place_of(follower), leader, [other], given).light
    by_leader = model.light(pose_from(follower, leader)[0], 0.0, {k: np.array(0.05)}) / 4
    by_other = model.light(pose_from(follower, other)[0], 0.0, {k: np.array(0.05)})
    np.testing.assert_allclose(found, by_leader + by_other, rtol=1e-12)


@pytest.mark.parametrize(
    ("body", "shaded"),
    [
        (placed(-2.5), True),  # midway
        (placed(-2.5, 0.0, 2.0), False),  # above the light
        (placed(2.5), False),  # ahead of the lamp
        (placed(-8.0), False),  # behind the follower
        (placed(-2.5, turn=(90.0, 0.0, 0.0)), True),  # across the light
        # A body 0.6 m aside reaches the middle of the light by its end where it lies across.
        (placed(-2.5, 0.45 + 0.15), False),
        (placed(-2.5, BODY_LENGTH_M / 2 - 0.02, turn=(90.0, 0.0, 0.0)), True),
    ],
)
def test_a_body_on_the_way_hides_the_lamp_and_moved_aside_it_does_not(body, shaded):
    # An array so small that it is a point.
    model = ForwardModel(changed("ideal", array={"width_m": 0.01, "radius_m": 0.1}))
    leader, follower = placed(), placed(-5.0)
    dark = Other(body.position, body.rotation, power=0.0)
    found = sight(model, place_of(follower), leader, [dark]).light
    whole = model.light([-5.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(found, 0.0 if shaded else whole, rtol=1e-12, atol=1e-12)


def shadow(body):
    """Return which detectors of a plane 6 m from the lamp a body shades, and their y and z."""
    wide = {"shape": "planar", "radius_m": None, "detectors_per_side": 81, "width_m": 3.0}
    model = ForwardModel(changed("ideal", array=wide, lamp={"beam_sigma_deg": 60.0}))
    found = sight(model, place_of(placed(-6.0 - 0.4)), placed(), [body]).light
    _, y, z = model.array.positions.T
    return found.ravel() == 0, y, z


def test_the_shadow_of_a_body_along_the_light_is_the_cone_about_its_near_end():
    shaded, y, z = shadow(placed(-3.0, power=0.0))
    near_m = 3.0 - (BODY_LENGTH_M / 2 - BODY_RADIUS_M)
    cone = np.arcsin(BODY_RADIUS_M / near_m)
    np.testing.assert_array_equal(shaded, np.arctan(np.hypot(y, z) / 6.0) < cone)


def test_the_shadow_of_a_body_across_the_light_is_as_wide_as_its_core_and_both_round_ends():
    turn = (90.0, 0.0, 0.0)  # along y, and above the light
    shaded, y, z = shadow(placed(-3.0, 0.0, 0.3, turn, power=0.0))
    # Lines through the core: twice as long and as high on the plane. About it all are hidden whose
    # angle to its nearest point is less than that of the radius.
    core_m = BODY_LENGTH_M / 2 - BODY_RADIUS_M
    middle = abs(y) < core_m
    to, light = np.array([3.0, 0.3]), np.stack([np.full(z.shape, 6.0), z]) / np.hypot(6.0, z)
    off = abs(to[0] * light[1] - to[1] * light[0])
    np.testing.assert_array_equal(shaded[middle], off[middle] < BODY_RADIUS_M)
    beyond = abs(y) > 2 * (core_m + BODY_RADIUS_M) + 0.1
    assert not shaded[beyond].any()
    ends = shaded & (abs(y) > 2 * core_m + 0.1)
    assert (y[ends] > 0).sum() == (y[ends] < 0).sum() > 10


def test_a_vehicle_shades_the_lamp_of_another_and_not_its_own():
    model = ForwardModel(load_scene("ideal"))
    follower = placed(-5.0)
    lamp_inside = (0.0, 0.0, 0.0)
    # The leader stands between the follower and the other, whose light reaches nobody.
    leader, other = placed(lamp_m=lamp_inside), placed(4.0, lamp_m=lamp_inside)
    found = sight(model, place_of(follower), leader, [other]).light
    alone = model.light([-5.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(found[2, 2], alone[2, 2], rtol=1e-12)
    assert model.light([-9.0, 0.0, 0.0, 0.0, 0.0])[2, 2] > 0.01 * alone[2, 2]
    # And the other way round: the leader's is hidden by the one behind it.
    hidden = sight(model, place_of(follower), other, [leader]).light
    np.testing.assert_allclose(hidden[2, 2], alone[2, 2], rtol=1e-12)


def coded(code, waveform="square", lamps=()):
    effects = {**CODED, "demodulation": {**CODED["demodulation"], "waveform": waveform}}
    model = ForwardModel(scene_with(effects, "ideal").with_lamps(lamps))
    leader, follower = placed(code=2), placed(-5.0)
    other = placed(0.5, 1.2, code=code)
    pose, roll = pose_from(follower, other)
    return model, sight(model, place_of(follower), leader, [other]), model.light(pose, roll) - 30.0


@pytest.mark.parametrize("lamps", [(), ring_of_lamps(lamps=3, spread_m=0.2, tilt_deg=2.0)])
def test_a_lamp_of_another_code_leaves_the_readings_and_stays_in_their_noise(lamps):
    model, (light, beside), by_other = coded(0, lamps=lamps)
    alone = model.light([-5.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(light, alone, rtol=1e-12)
    # All its lamps together are beside each of the leader's.
    stray = by_other.reshape(-1, 5, 5).sum(axis=0)
    np.testing.assert_allclose(beside.reshape(-1, 5, 5) - stray, 0.0, atol=1e-9)
    assert stray.max() > 100
    with_it = model.read(light, np.random.default_rng(3), beside) - light
    without = model.read(light, np.random.default_rng(3)) - light
    # The fundamental of a square wave has a noise factor of pi^2/8.
    alone_variance = np.pi**2 / 8 * (4 + (300 + model.scene.lamp_count * (light - 30)) / 50)
    added = np.pi**2 / 8 * beside / 50
    np.testing.assert_allclose((with_it / without) ** 2, 1 + added / alone_variance, rtol=1e-9)


def test_lamps_saturate_together_at_their_peaks():
    model, *_ = coded(0)
    # 300 + 2 x 450 + 2 x 400 is 2,000, the level.
    reading = model.read(np.full((5, 5), 1e6), np.random.default_rng(1), np.full((5, 5), 400.0))
    np.testing.assert_array_equal(reading, 450.0 + 30.0)


@pytest.mark.parametrize(("code", "waveform"), [(2, "square"), (2, "sine"), (0, "slots")])
def test_a_lamp_of_the_same_code_or_in_slots_is_read(code, waveform):
    model, (light, beside), by_other = coded(code, waveform)
    alone = model.light([-5.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(light, alone + by_other, rtol=1e-9)
    assert not beside.any()
