"""The light of the lamp: each law in closed form, and the whole by the second forward model."""

import math
import warnings

import numpy as np
import pytest
import second_forward
from hypothesis import given
from hypothesis import strategies as st

from uuv_optical_array.forward.light import MIN_RANGE_M, off_axis, ray
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import scene_from_settings

arrays = st.sampled_from(
    [
        {"shape": "planar", "detectors_per_side": 4},
        {"shape": "curved", "detectors_per_side": 5, "radius_m": 0.32, "bow_m": 0.0},
    ]
)


def make_model(array, sigma_deg=8.0, k=0.0, reference_range_m=4.0, window_m=None):
    water = {"attenuation": {"k_per_m": k}}
    if window_m is not None:
        water["forward_scatter"] = {"window_m": window_m}
    lamp = {"beam_sigma_deg": sigma_deg, "reference_counts": 900.0}
    lamp["reference_range_m"] = reference_range_m
    settings = {"lamp": lamp, "array": array, "effects": water}
    return ForwardModel(scene_from_settings(settings, "test"))


@pytest.mark.parametrize("axis", [1, 2])
def test_a_small_off_axis_angle_is_not_lost(axis):
    to = np.array([1.0, 0, 0])
    to[axis] = 1e-9
    _, inverse, half_sine_squared, _, _, along = ray(to, (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    half_square, _ = off_axis(along, half_sine_squared, inverse)
    assert math.sqrt(2 * half_square) == pytest.approx(1e-9, rel=1e-12)


@given(
    degrees=st.sampled_from([0.0, 1e-6, 44.9, 45.1, 90.0, 179.9, 180.0]) | st.floats(1e-6, 180),
    range_m=st.floats(1e-3, 300.0),
)
def test_the_off_axis_angle_is_exact_ahead_and_behind(degrees, range_m):
    eta = math.radians(degrees)
    along, half_sine = range_m * math.cos(eta), math.sin(min(eta, math.pi - eta) / 2)
    half_square, turn = off_axis(along, half_sine**2, 1 / range_m)
    assert half_square == pytest.approx(eta**2 / 2, rel=2e-15)
    if math.sin(eta) > 1e-9:  # below, it is bounded
        assert turn == pytest.approx(eta / math.sin(eta) / range_m, rel=1e-12)
    many = off_axis(np.full(3, along), np.full(3, half_sine**2), np.full(3, 1 / range_m))
    np.testing.assert_allclose(many, [[half_square] * 3, [turn] * 3], rtol=1e-15)


def test_the_turn_stays_finite_on_the_axis_on_either_side():
    assert off_axis(2.0, 0.0, 0.5) == (0.0, 0.5)
    half_square, turn = off_axis(-2.0, 0.0, 0.5)
    assert half_square == pytest.approx(math.pi**2 / 2, rel=1e-15)
    assert 0 < turn <= math.pi * 1e9 / 2.0


def test_no_cosine_exceeds_one_by_rounding():
    normals = np.random.default_rng(7).standard_normal((3, 1000))
    normals /= np.linalg.norm(normals, axis=0)
    lamps = 3.7 * normals  # straight ahead of detectors at the origin
    assert ((lamps * normals).sum(axis=0) > np.linalg.norm(lamps, axis=0)).any()
    cosines = ray(lamps, normals, (-1.0, 0.0, 0.0))[3]
    assert (cosines <= 1).all()
    np.testing.assert_allclose(cosines, 1, rtol=1e-15)


@given(
    array=arrays,
    sigma_deg=st.floats(0.5, 60),
    k=st.floats(0, 10),
    place=st.tuples(*[st.sampled_from([0.0, 1e-3, -1e-3]) | st.floats(-1e3, 1e3)] * 3),
    attitude=st.tuples(st.floats(-math.pi / 2, math.pi / 2), st.floats(-math.pi, math.pi)),
)
def test_extreme_poses_give_finite_light_without_a_warning(array, sigma_deg, k, place, attitude):
    model = make_model(array, sigma_deg, k, reference_range_m=5.0, window_m=0.3)
    with np.errstate(over="raise", divide="raise", invalid="raise"), warnings.catch_warnings():
        warnings.simplefilter("error")
        image = model.light([*place, *attitude])
    assert np.isfinite(image).all()
    assert (image >= 0).all()


@pytest.mark.parametrize(
    "place",
    [
        (-0.402, 0.0, 0.0),  # the middle detector 2 mm behind the lamp
        (-0.398, 0.0, 0.0),  # and 2 mm ahead of it
        (-1.0, 0.0, 0.0),
        (-1e-9, 0.0, 0.0),
        (0.4, 0.0, 0.0),
        (1000.0, 0.0, 0.0),  # straight behind the lamp
        (-1000.0, 1e-9, 0.0),
        (-2.0, 1.6, 0.0),  # 45 deg off the axis, for some detectors
        (0.0, 5.0, 0.0),
    ],
)
def test_singular_places_have_the_light_of_the_second_forward_model(place):
    model = make_model({"shape": "planar", "detectors_per_side": 5}, 8.0, 0.1)
    plain = model.scene.settings()
    for attitude, roll in (((0.0, 0.0), 0.0), ((0.3, math.pi), 1.0), ((-math.pi / 2, 2.0), 3.0)):
        found = model.light([*place, *attitude], roll)
        expected = second_forward.light(plain, (*place, *attitude), roll)
        # So near to a detector the direction to the lamp is lost in the place's rounding.
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * model.power / 4e-6)


def test_a_lamp_in_a_detector_is_as_bright_as_at_a_millimetre():
    model = make_model({"shape": "planar", "detectors_per_side": 5}, 8.0, 0.0)
    for place in (-0.4, -0.4 - 1e-4, -0.4 + 1e-4):
        light = model.light([place, 0, 0, 0, 0])
        assert np.isfinite(light).all()
        assert (light <= model.power / MIN_RANGE_M**2).all()


def test_light_whose_exponential_is_subnormal_is_right():
    model = make_model({"shape": "planar", "detectors_per_side": 5}, 60.0, 10.0)
    pose = [-72.5, 0, 0, 0, 0]
    model.power = 1e9
    light = model.light(pose)
    paths = second_forward.rays(model.scene.settings()["array"], pose)
    for found, path in zip(light.ravel(), paths, strict=True):
        assert -745 < -10 * path.range_m < -708
        beam = second_forward.ideal(path, 60.0)
        expected = 1e9 * beam * math.exp(-5 * path.range_m) * math.exp(-5 * path.range_m)
        assert 0 < found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    "pose", [[math.nan, 0, 0, 0, 0], [-4, 0, 0, math.inf, 0], [-4, 0, 0], np.zeros((2, 3)), -4.0]
)
def test_what_is_no_pose_is_refused_by_name(pose):
    model = make_model({"shape": "planar", "detectors_per_side": 3}, 8.0, 0.1)
    with pytest.raises(ValueError, match=r"poses: .*five finite numbers each: x, y, z"):
        model.light([[-4, 0, 0, 0, 0], pose] if np.shape(pose) == (5,) else pose)
    with pytest.raises(ValueError, match="five finite numbers"):
        model.linearised(pose)


def test_light_too_dim_for_a_number_is_zero():
    model = make_model({"shape": "planar", "detectors_per_side": 3}, 8.0, 10.0)
    with np.errstate(all="raise"):
        assert (model.light([-1000.0, 0, 0, 0, 0]) == 0).all(), "K r = 10,000"
        assert (model.light([-10.0, 0, 0, 0, 0]) > 0).all(), "K r = 100 is no underflow"
