"""The light of the lamp: each law in closed form, and the chain against a scalar loop."""

import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uuv_optical_array.forward import effects
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.light import Light, irradiance, lamp_in_body, trace
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import scene_from_settings

reproducible = settings(deadline=None, derandomize=True)
ONE = DetectorArray(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]), 1, 0.4)
SIGMA = math.radians(8)

curved = st.fixed_dictionaries(
    {
        "shape": st.just("curved"),
        "detectors_per_side": st.integers(2, 7),
        "width_m": st.floats(0.1, 0.6),
        "bow_m": st.floats(0, 1),
        "radius_m": st.floats(0.45, 1),
    }
)
planar = curved.map(lambda array: {**array, "shape": "planar", "radius_m": None})
arrays = st.one_of(curved, planar)


def seen(pose, roll=0.0):
    return trace(ONE, *lamp_in_body(pose, roll))


def one_detector(pose, sigma=SIGMA):
    """Light on a single detector at the follower's origin, of a lamp of unit power."""
    return irradiance(seen(pose), sigma)[..., 0]


def make_model(array, sigma_deg=8.0, k=0.0, reference_range_m=4.0, window_m=None):
    table = {key: [0, 0, 1] for key in ("x_m", "y_m", "z_m", "pitch_deg", "yaw_deg")}
    settings = {
        "lamp": {
            "beam_sigma_deg": sigma_deg,
            "reference_counts": 900.0,
            "reference_range_m": reference_range_m,
        },
        "array": array,
        "effects": {"attenuation": {"k_per_m": k}},
        "table": table,
    }
    if window_m is not None:
        settings["effects"]["forward_scatter"] = {"window_m": window_m}
    return ForwardModel(scene_from_settings(settings, "test"))


def facing(pose, tilt=0.0):
    """Pose at the same place, its bow turned to the lamp and then by `tilt` in yaw."""
    x, y, z = pose
    yaw = math.atan2(-y, -x)
    return [x, y, z, math.atan2(z, math.hypot(x, y)), yaw + tilt]


def slow_image(array, sigma_deg, k, pose, roll=0.0):
    """Equations 1 to 5 and 8 to 12 for a lamp of unit power, one detector at a time."""
    side, width, bow, radius = (
        array[key] for key in ("detectors_per_side", "width_m", "bow_m", "radius_m")
    )
    x, y, z, pitch, yaw = pose
    attitude = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    image = []
    for row in range(side):
        for column in range(side):
            port = width / 2 - column * width / (side - 1)
            up = width / 2 - row * width / (side - 1)
            depth = 0.0 if radius is None else math.sqrt(radius**2 - port**2 - up**2)
            looks = (1, 0, 0) if radius is None else (depth / radius, port / radius, up / radius)
            px, py, pz = np.array([x, y, z]) + attitude.apply((bow + depth, port, up))
            nx, ny, nz = attitude.apply(looks)
            r = math.sqrt(px * px + py * py + pz * pz)
            eta = math.acos(max(-1.0, min(1.0, -px / r)))
            cosine = -(nx * px + ny * py + nz * pz) / r
            beam = math.exp(-(eta**2) / (2 * math.radians(sigma_deg) ** 2))
            image.append(beam * math.exp(-k * r) * max(0.0, cosine) / r**2)
    return np.reshape(image, (side, side))


def test_twice_the_range_gives_a_quarter_of_the_light():
    light = one_detector([[-2, 0, 0, 0, 0], [-4, 0, 0, 0, 0], [-8, 0, 0, 0, 0]])
    np.testing.assert_allclose(light, [1 / 4, 1 / 16, 1 / 64], rtol=1e-15)


@given(
    eta=st.floats(0, math.pi),
    around=st.floats(-math.pi, math.pi),
    r=st.floats(0.5, 50),
    sigma=st.floats(math.radians(3), math.radians(60)),
)
@reproducible
def test_the_beam_is_gaussian_in_the_off_axis_angle_and_round(eta, around, r, sigma):
    across = r * math.sin(eta)
    place = (-r * math.cos(eta), across * math.cos(around), across * math.sin(around))
    expected = math.exp(-(eta**2) / (2 * sigma**2)) / r**2
    assert one_detector(facing(place), sigma) == pytest.approx(expected, rel=1e-11, abs=1e-300)


def test_twice_sigma_off_the_axis_the_beam_is_down_to_one_over_e_squared():
    # W, the 1/e^2 radius, is twice sigma_rho (eqs 3 and 4).
    off_axis = 2 * SIGMA
    at_w = one_detector(facing((-math.cos(off_axis), math.sin(off_axis), 0.0)))
    on_axis = one_detector([-1.0, 0, 0, 0, 0])
    assert at_w / on_axis == pytest.approx(math.exp(-2), rel=1e-13)


@given(r_axial=st.floats(0.5, 30), eta=st.floats(0.0, 1.2), k=st.floats(0, 1))
@reproducible
def test_beer_dims_along_the_slant_path(r_axial, eta, k):
    rays = seen([-r_axial, r_axial * math.tan(eta), 0, 0, 0])
    light = Light(np.ones((1, 1)))
    effects.attenuation(ONE, k_per_m=k)(light, rays)
    assert light.image[0, 0] == pytest.approx(math.exp(-k * r_axial / math.cos(eta)), rel=1e-12)


@pytest.mark.parametrize("eta", [0.05, 0.1, 0.2])
def test_the_slant_path_of_the_paper_is_ours_to_second_order(eta):
    ours = seen([-6.0, 6.0 * math.tan(eta), 0, 0, 0]).range_m[0]
    papers = 2 * 6.0 / (2 - eta**2)
    # 2 / (2 - eta^2) and 1 / cos(eta) part at fourth order, by eta^4 / 24.
    assert papers - ours == pytest.approx(6.0 * eta**4 / 24, rel=0.1)


@given(tilt=st.floats(-math.pi, math.pi), roll=st.floats(-3, 3))
@reproducible
def test_lambert_a_turned_detector_reads_the_cosine_and_zero_from_behind(tilt, roll):
    light = irradiance(seen([-1, 0, 0, 0, tilt], roll), SIGMA)[0]
    assert light == pytest.approx(max(0.0, math.cos(tilt)), abs=1e-15)
    if abs(tilt) > math.pi / 2 + 1e-12:
        assert light == 0.0


@pytest.mark.parametrize("axis", [1, 2])
def test_a_small_off_axis_angle_is_not_lost(axis):
    pose = np.array([-1.0, 0, 0, 0, 0])
    pose[axis] = 1e-9
    assert seen(pose).off_axis_rad[0] == pytest.approx(1e-9, rel=1e-12)


@given(
    array=arrays,
    sigma_deg=st.floats(3, 60),
    k=st.floats(0, 0.5),
    x=st.floats(-12, -2),
    y=st.floats(-2, 2),
    z=st.floats(-2, 2),
    pitch=st.floats(-1.5, 1.5),
    yaw=st.floats(-math.pi, math.pi),
    roll=st.floats(-math.pi, math.pi),
)
@reproducible
def test_the_whole_chain_agrees_with_a_scalar_loop(array, sigma_deg, k, x, y, z, pitch, yaw, roll):
    pose = (x, y, z, pitch, yaw)
    power = 900 / slow_image(array, sigma_deg, k, (-4, 0, 0, 0, 0)).max()
    expected = power * slow_image(array, sigma_deg, k, pose, roll)
    found = make_model(array, sigma_deg, k).light(pose, roll)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("shape", [(6,), (2, 3), (0,)])
def test_stacks_of_poses_give_the_stack_of_their_images(shape):
    model = make_model({"shape": "planar", "detectors_per_side": 4}, 8.0, 0.1)
    rng = np.random.default_rng(3)
    poses = rng.uniform([-8, -1, -1, -0.5, -0.5], [-4, 1, 1, 0.5, 0.5], (*shape, 5))
    rolls = rng.uniform(-1, 1, shape)
    together = model.light(poses, rolls)
    assert together.shape == (*shape, 4, 4)
    for index in np.ndindex(*shape):
        alone = model.light(poses[index], rolls[index])
        assert alone.shape == (4, 4)
        np.testing.assert_allclose(together[index], alone, rtol=1e-13)


@given(
    array=arrays,
    sigma_deg=st.floats(0.5, 60),
    k=st.floats(0, 10),
    distance=st.one_of(st.sampled_from([0.0, 1e-3, 1e3]), st.floats(1e-3, 1e3)),
    direction=st.tuples(st.floats(-math.pi, math.pi), st.floats(-math.pi / 2, math.pi / 2)),
    attitude=st.tuples(st.floats(-math.pi / 2, math.pi / 2), st.floats(-math.pi, math.pi)),
)
@reproducible
def test_extreme_poses_give_finite_light_without_a_warning(
    array, sigma_deg, k, distance, direction, attitude
):
    bearing, elevation = direction
    place = distance * np.array(
        [
            np.cos(elevation) * np.cos(bearing),
            np.cos(elevation) * np.sin(bearing),
            np.sin(elevation),
        ]
    )
    model = make_model(array, sigma_deg, k, reference_range_m=5.0, window_m=0.3)
    with np.errstate(over="raise", divide="raise", invalid="raise"), warnings.catch_warnings():
        warnings.simplefilter("error")
        image = model.light([*place, *attitude])
    assert np.isfinite(image).all()
    assert (image >= 0).all()


def test_light_too_dim_for_a_number_is_zero():
    model = make_model({"shape": "planar", "detectors_per_side": 3}, 8.0, 10.0)
    with np.errstate(all="raise"):
        assert (model.light([-1000.0, 0, 0, 0, 0]) == 0).all(), "K r = 10,000"
        assert (model.light([-10.0, 0, 0, 0, 0]) > 0).all(), "K r = 100 is no underflow"


def test_a_detector_behind_the_lamp_that_looks_away_reads_nothing():
    model = make_model({"shape": "curved", "detectors_per_side": 5, "radius_m": 0.32}, 60.0)
    assert (model.light([3.0, 0.1, 0.1, 0, 0]) == 0).all()
