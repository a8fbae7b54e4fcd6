"""Bounds of key parameters, images that are not theirs, and frames that repeat."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes import changed
from scipy.stats import skew

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature.plausibility import (
    FROZEN,
    REMEMBERED,
    FrozenFrames,
    bounds,
    check_image,
    check_parameters,
)
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

FULL = 1023.0


def scene_of(side=5, **effects):
    return changed("reference", array={"detectors_per_side": side}, effects=effects)


SCENES = {side: scene_of(side) for side in (2, 3, 4, 5, 8)}
counts = st.one_of(st.integers(0, 1023), st.sampled_from([0, 1, 1022, 1023]))
images = st.sampled_from([2, 3, 4, 5, 8]).flatmap(
    lambda side: arrays(float, (side, side), elements=counts)
)


@given(images)
def test_no_image_is_beyond_the_bounds_nor_another_than_itself(image):
    scene = SCENES[len(image)]
    parameters = key_parameters(image, FULL, scene.signature.peak)
    for passed_on in (parameters, parameters.astype(np.float32).astype(float)):
        check_parameters(passed_on, bounds(scene))
        check_image(passed_on, image, scene)


@pytest.mark.parametrize("side", [2, 3, 5, 8])
def test_the_bounds_are_reached_and_not_wider(side):
    image = np.zeros((side, side))
    image[-1, -1] = FULL
    peak, column, row, *skewnesses = bounds(SCENES[side])
    found = key_parameters(image, FULL, "detector")
    np.testing.assert_allclose(found[:3], [peak, column, row])
    one_apart = np.eye(side)[0]
    expected = 0.0 if side == 2 else skew(one_apart)
    np.testing.assert_allclose(skewnesses, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (0, 1.7, r"peak is 1\.7, but it must be from 0 to 1$"),
        (0, -0.01, r"peak is -0\.01, .* from 0 to 1$"),
        (1, 2.00001, r"column is 2\.00001, but it must be from -2 to 2$"),
        (2, -2.5, r"row is -2\.5, "),
        (3, 1.50001, r"skewness_horizontal is 1\.50001, .* from -1\.5 to 1\.5$"),
        (4, -40.0, r"skewness_vertical is -40, "),
    ],
)
def test_what_no_array_can_have_is_refused_with_value_and_bound(place, value, words):
    parameters = np.array([0.5, 0.3, -0.2, 0.1, 0.1])
    check_parameters(parameters, bounds(SCENES[5]))
    parameters[place] = value
    with pytest.raises(NoPose, match=rf"^not of this array: {words}"):
        check_parameters(parameters, bounds(SCENES[5]))


@pytest.mark.parametrize(
    ("level", "adc", "bound"),
    [(900.6, {}, 901 / 900.6), (900.4, {}, 1), (None, None, math.inf), (900.6, None, 1)],
)
def test_the_peak_is_bounded_by_what_the_electronics_can_read(level, adc, bound):
    saturation = None if level is None else {"level_counts": level}
    assert bounds(scene_of(saturation=saturation, adc=adc))[0] == bound


@pytest.mark.parametrize("place", range(5))
@pytest.mark.parametrize("off", [1e-5, 0.3, -1e-5])
def test_key_parameters_of_another_image_are_refused_with_both_values(place, off):
    scene = SCENES[5]
    image = ForwardModel(scene).expose([-6.0, 0.3, 0.2, 0.1, 0.1], np.random.default_rng(1))
    parameters = key_parameters(image, FULL, scene.signature.peak)
    check_image(parameters, image, scene)
    parameters[place] += off
    with pytest.raises(NoPose, match=rf"^another image: .* is {parameters[place]:.9g} in the feat"):
        check_image(parameters, image, scene)


def hold(frozen, image):
    frozen.check(image, lambda: image)


def repeats_until_frozen(scene, image, most=50):
    frozen = FrozenFrames(ForwardModel(scene))
    for count in range(most):
        try:
            hold(frozen, image)
        except NoPose:
            return count
    return most


@pytest.mark.parametrize("lit", [25, 17, 16, 8, 1])
def test_frames_are_frozen_once_their_noise_repeats_with_no_chance(lit):
    image = np.zeros(25)
    image[:lit] = 500.0
    # The noise of the reference scene has a standard deviation of one count.
    chance = (1 / (2 * math.sqrt(math.pi))) ** lit
    expected = math.ceil(math.log(FROZEN) / math.log(chance))
    assert repeats_until_frozen(SCENES[5], image.reshape(5, 5)) == expected


@pytest.mark.parametrize(
    ("scene", "level"),
    [
        (SCENES[5], 0.0),
        (SCENES[5], FULL),
        (scene_of(sensor_noise={"sigma_counts": 0.0}), 500.0),
        (load_scene("eren2016"), 500.0),
        (scene_of(sensor_noise={"sigma_counts": 0.25}), 500.0),
    ],
    ids=["dark", "saturated", "without noise", "eren2016", "coarse converter"],
)
def test_an_image_that_may_repeat_is_never_frozen(scene, level):
    assert repeats_until_frozen(scene, np.full((5, 5), level)) == 50


@pytest.mark.parametrize("sigma", [0.1, 0.3, 0.6, 1.0, 4.0])
@pytest.mark.parametrize("light", [200.0, 200.5])
def test_the_chance_is_an_upper_bound_and_near_where_noise_is_wide(sigma, light):
    model = ForwardModel(scene_of(sensor_noise={"sigma_counts": sigma}))
    first, second = model.read(np.full((2, 400_000), light), np.random.default_rng(3))
    seen = np.mean(first == second)
    chance = math.exp(FrozenFrames(model).log_chance(np.array([light])))
    assert seen - 4e-3 <= chance <= 1
    if sigma >= 1:
        assert seen == pytest.approx(chance, rel=0.05)


def test_shot_noise_counts_as_noise():
    effects = {"sensor_noise": {"sigma_counts": 0.0}, "shot_noise": {"electrons_per_count": 1.0}}
    frozen = FrozenFrames(ForwardModel(scene_of(**effects)))
    expected = -math.log(2 * math.sqrt(math.pi * 400))
    assert frozen.log_chance(np.array([400.0])) == pytest.approx(expected)


def test_honest_frames_at_rest_are_not_frozen_and_a_break_starts_anew():
    model = ForwardModel(SCENES[5])
    frames = model.expose(np.tile([-7.9, 0, 0, 0, 0], (3000, 1)), np.random.default_rng(4))
    frozen = FrozenFrames(model)
    for frame in frames:
        hold(frozen, frame)
    few, frozen = np.zeros((5, 5)), FrozenFrames(model)
    few[2, 1:3] = 300.0, 310.0
    for _ in range(9):  # one more would be frozen
        hold(frozen, few)
    hold(frozen, frames[0])
    for _ in range(11):  # now it may be either of two that repeats
        hold(frozen, few)
    with pytest.raises(NoPose, match=r"^frozen: .* chance of 1e-10"):
        hold(frozen, few)


def test_frames_that_come_round_again_are_frozen_and_readings_that_often_repeat_are_not():
    model, rng = ForwardModel(SCENES[5]), np.random.default_rng(6)
    frames = model.expose(np.tile([-6.0, 0, 0, 0, 0], (REMEMBERED + 1, 1)), rng)
    looped = FrozenFrames(model)
    for frame in frames[1:]:
        hold(looped, frame)
    with pytest.raises(NoPose, match=r"^frozen: "):
        hold(looped, frames[1])
    longer = FrozenFrames(model)
    for frame in np.tile(frames, (3, 1, 1)):  # a loop longer than what is remembered
        hold(longer, frame)
    # Two lit detectors give few images, of which one of so many before comes often.
    few, at_rest = np.zeros((5, 5)), FrozenFrames(model)
    few[2, 1:3] = 300.0, 310.0
    for frame in few + np.rint(rng.standard_normal((3000, 5, 5))) * (few > 0):
        hold(at_rest, frame)


def test_key_parameters_depend_on_the_profiles_through_their_peak():
    model = ForwardModel(SCENES[5])
    pose = np.array([-5.0, 0.3, -0.4, 0.1, -0.2])
    image = model.expected(pose, 0.2)
    parameters = key_parameters(image, FULL, SCENES[5].signature.peak)
    row, column = np.unravel_index(image.argmax(), image.shape)
    expected = [*image[row], *(image[i, column] for i in range(5) if i != row)]
    np.testing.assert_array_equal(FrozenFrames(model).profiles(pose, 0.2, parameters), expected)
