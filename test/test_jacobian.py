"""Every analytic derivative of the light against finite differences, and the fit's chart."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uuv_optical_array.estimation.least_squares.coordinates import Chart
from uuv_optical_array.forward.light import lamp_in_body
from uuv_optical_array.forward.model import NUISANCES, ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

pytestmark = pytest.mark.filterwarnings("error")
reproducible = settings(deadline=None, derandomize=True, max_examples=12)

EFFECTS = {
    "clear": {},
    "attenuation": {"attenuation": {"k_per_m": 0.1}},
    "ambient": {"ambient": {"level_counts": 20.0}},
    "scatter": {"forward_scatter": {"window_m": 0.3}},
    "spread": {"beam_spread": {"scattering_per_m": 0.3, "scattering_angle_deg": 4.0}},
    "lens": {"field_of_view": {"cosine_power": 2.5}},
    "rim": {"field_of_view": {"half_angle_deg": 40.0, "edge_deg": 30.0}},
    "gains": {"responsivity": {"spread": 0.1, "seed": 1}},
    "faults": {"detector_faults": {"dead": [[0, 1]], "stuck": [[2, 2]], "stuck_counts": 40.0}},
    "all": {
        "attenuation": {"k_per_m": 0.2},
        "beam_spread": {"scattering_per_m": 0.1, "scattering_angle_deg": 2.0},
        "responsivity": {"spread": 0.05, "seed": 2},
        "ambient": {"level_counts": 20.0},
        "forward_scatter": {"window_m": 0.25},
        "sensor_noise": {"sigma_counts": 1.0},
        "shot_noise": {"electrons_per_count": 50.0},
        "saturation": {"level_counts": 1023.0},
        "adc": {"bits": 10},
    },
}
SHAPES = ("planar", "curved")
SIDES = (3, 4, 5, 7, 21)
ALIGNED = (-6.0, 0.0, 0.0, 0.0, 0.0)

places = st.tuples(st.floats(-9, -2), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
angles = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
poses = st.builds(lambda place, angle: (*place, *angle), places, angles)
rolls = st.floats(-0.5, 0.5)


def make_model(shape, side, effects):
    scene = load_scene("reference").settings()
    scene["array"].update(shape=shape, detectors_per_side=side)
    if shape == "planar":
        del scene["array"]["radius_m"]
    return ForwardModel(scene_from_settings({**scene, "effects": effects}, "test"))


@pytest.fixture(scope="module", params=[(shape, side) for shape in SHAPES for side in SIDES])
def models(request):
    """The models of one array, by effects."""
    return {name: make_model(*request.param, effects) for name, effects in EFFECTS.items()}


def differentiate(function, at, step=2e-4):
    """Five-point central differences along a last axis; exact but for the fifth derivative."""
    columns = []
    for i in range(len(at)):
        h = np.zeros(len(at))
        h[i] = step
        near, far = (function(at + k * h) - function(at - k * h) for k in (1, 2))
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


def incidence(array, pose, roll):
    """Cosines between the detectors' normals and the directions to the lamp."""
    turn = Rotation.from_euler("ZYX", [pose[4], pose[3], roll])
    to_lamp = -(turn.apply(array.positions) + pose[:3])
    return (turn.apply(array.normals) * to_lamp).sum(axis=1) / np.linalg.norm(to_lamp, axis=1)


def away_from_grazing(array, pose, roll):
    # Lambert's max(0, cos theta) has a kink where a detector turns away from the lamp: differences
    # across it are the mean of two slopes, which no derivative is.
    return np.abs(incidence(array, pose, roll)).min() > 1e-3


def assert_close(analytic, differences):
    scale = np.abs(differences).max()
    np.testing.assert_allclose(analytic, differences, rtol=1e-7, atol=1e-8 * scale + 1e-8)


@pytest.mark.parametrize("effects", EFFECTS)
@example(pose=ALIGNED, roll=0.0)
@given(pose=poses, roll=rolls)
@reproducible
def test_the_jacobian_is_the_derivative_of_the_light(models, effects, pose, roll):
    model = models[effects]
    assume(away_from_grazing(model.array, pose, roll))
    image, jacobian = model.linearised(pose, roll)
    np.testing.assert_allclose(image, model.light(pose, roll).ravel(), rtol=1e-12)
    assert_close(jacobian, differentiate(lambda at: model.light(at, roll).ravel(), np.array(pose)))


@given(
    pose=poses,
    roll=rolls,
    offset=st.tuples(
        st.floats(-0.3, 0.3), st.floats(-0.05, 0.05), st.floats(-9, 9), st.floats(-5, 5)
    ),
    order=st.permutations(list(NUISANCES)),
    number=st.integers(1, 4),
)
@reproducible
def test_the_jacobian_by_nuisances_is_the_derivative_too(models, pose, roll, offset, order, number):
    model = models["all"]
    assume(away_from_grazing(model.array, pose, roll))
    names = order[:number]

    def light(at):
        offsets = {name: np.asarray(at[5 + i]) for i, name in enumerate(names)}
        return model.light(at[:5], roll, offsets).ravel()

    at = np.array([*pose, *offset[:number]])
    offsets = {name: np.asarray(at[5 + i]) for i, name in enumerate(names)}
    image, jacobian = model.linearised(pose, roll, offsets)
    np.testing.assert_allclose(image, light(at), rtol=1e-12)
    assert_close(jacobian, differentiate(light, at))


@pytest.mark.parametrize("shape", SHAPES)
def test_many_poses_at_once_have_the_jacobians_of_each(shape):
    model = make_model(shape, 4, EFFECTS["all"])
    rng = np.random.default_rng(1)
    many = np.array(ALIGNED) + 0.2 * rng.standard_normal((2, 3, 5))
    roll = 0.2 * rng.standard_normal((2, 3))
    offsets = {name: 0.01 * rng.standard_normal((2, 3)) for name in NUISANCES}
    image, jacobian = model.linearised(many, roll, offsets)
    assert image.shape == (2, 3, 16)
    assert jacobian.shape == (2, 3, 16, 5 + len(NUISANCES))
    for i in np.ndindex(2, 3):
        own = {name: values[i] for name, values in offsets.items()}
        one_image, one_jacobian = model.linearised(many[i], roll[i], own)
        np.testing.assert_allclose(image[i], one_image, rtol=1e-12)
        np.testing.assert_allclose(jacobian[i], one_jacobian, rtol=1e-9, atol=1e-9)


def test_a_detector_that_faces_away_has_no_slope_and_no_light():
    model = make_model("curved", 5, EFFECTS["attenuation"])
    pose = (-5.0, 0.0, 0.0, 0.0, 1.0)
    away = incidence(model.array, pose, 0.0) < 0
    assert 0 < away.sum() < 25
    image, jacobian = model.linearised(pose)
    assert not image[away].any()
    assert not jacobian[away].any()
    assert np.abs(jacobian[~away]).sum(axis=1).all()


@pytest.mark.parametrize("name", ["attenuation.k_per_m", "ambient.level_counts", "lamp.colour"])
def test_a_nuisance_that_the_scene_does_not_have_is_refused(name):
    with pytest.raises(ValueError, match=name):
        make_model("curved", 5, {}).linearised(ALIGNED, 0.0, {name: np.zeros(())})


@pytest.mark.parametrize("effects", EFFECTS)
def test_the_slope_of_the_variance_is_its_derivative_by_the_light(effects):
    model = make_model("curved", 5, EFFECTS[effects])
    light = np.linspace(5, 900, 100)
    _, slope = model.variance(light)
    h = 1e-3
    differences = (model.variance(light + h)[0] - model.variance(light - h)[0]) / (2 * h)
    np.testing.assert_allclose(slope, differences, atol=1e-9)
    assert slope.any() == ("shot_noise" in EFFECTS[effects])


charts = st.builds(
    Chart,
    st.tuples(st.floats(-0.5, 1), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)).map(np.array),
    st.floats(math.radians(2), math.radians(30)),
    st.one_of(st.just(0.0), st.floats(1e-3, 0.2)),
    st.booleans(),
)


def facing(chart, pose, roll):
    """Cosine between the array's axis and the way to the lamp; positive where it sees it."""
    lamp, _ = lamp_in_body(np.array(pose), roll)
    sight = lamp - chart.centre
    return sight[0] / np.linalg.norm(sight)


@given(chart=charts, pose=poses, roll=rolls)
@settings(reproducible, max_examples=100)
def test_from_pose_to_the_chart_and_back(chart, pose, roll):
    assume(facing(chart, pose, roll) > 0.01)
    coordinates = chart.from_pose(np.array(pose), roll)
    back, lamp, axis, _ = chart.to_pose(coordinates, roll)
    seen = lamp, axis
    np.testing.assert_allclose(back, pose, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(seen, lamp_in_body(pose, roll), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(chart.from_pose(back, roll), coordinates, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize(("k", "r"), [(0.1, 100.0), (0.5, 20.0), (3.0, 4.0), (10.0, 1.0)])
def test_the_chart_holds_in_thick_water_too(k, r):
    chart = Chart(np.zeros(3), math.radians(8), k)
    pose = np.array([-r, 0.0, 0.0, 0.0, 0.0])
    back, *_ = chart.to_pose(chart.from_pose(pose, 0.0), 0.0)
    np.testing.assert_allclose(back, pose, rtol=1e-7)


@given(chart=charts, pose=poses, roll=rolls)
@settings(reproducible, max_examples=100)
def test_the_chart_is_where_the_lamp_stands_and_how_dim_it_is(chart, pose, roll):
    assume(facing(chart, pose, roll) > 0.01)
    turn = Rotation.from_euler("ZYX", [pose[4], pose[3], roll])
    centre = turn.apply(chart.centre) + pose[:3]
    x, y, z = turn.inv().apply(-centre)
    r = np.linalg.norm(centre)
    off_axis = math.atan2(math.hypot(centre[1], centre[2]), -centre[0])
    dimness = math.log(r) + chart.k_per_m * r / 2 + (off_axis / chart.beam_sigma_rad) ** 2 / 4
    azimuth, elevation = math.atan2(y, x), math.asin(z / r)
    if chart.planar:
        ahead = turn.inv().apply([1.0, 0.0, 0.0])  # against the beam
        weight = chart.beam_sigma_rad**-2
        share = weight / (weight + 3)
        azimuth -= share * math.atan2(ahead[1], ahead[0])
        elevation -= share * math.asin(ahead[2])
        dimness -= 0.5 * math.log(facing(chart, pose, roll))
    coordinates = chart.from_pose(np.array(pose), roll)
    expected = [azimuth, elevation, dimness, *pose[3:]]
    np.testing.assert_allclose(coordinates, expected, rtol=1e-9, atol=1e-9)


@given(chart=charts, pose=poses, roll=rolls)
@settings(reproducible, max_examples=100)
def test_the_volume_of_the_chart_is_the_determinant_of_its_derivative(chart, pose, roll):
    assume(facing(chart, pose, roll) > 0.05)
    coordinates = chart.from_pose(np.array(pose), roll)
    derivative = differentiate(lambda at: chart.to_pose(at, roll)[0], coordinates)
    log_volume = chart.to_pose(coordinates, roll)[3]
    assert log_volume == pytest.approx(np.linalg.slogdet(derivative)[1], abs=1e-4)


@pytest.mark.parametrize("turn", [(0.1, -0.05), (-0.08, 0.12)])
def test_the_lookalikes_of_a_planar_array_look_alike(turn):
    """Turned as far in pitch and yaw without them, the image is a quite different one."""
    model = make_model("planar", 5, EFFECTS["attenuation"])
    centre = model.array.positions.mean(axis=0)
    chart = Chart(centre, math.radians(8), 0.1, planar=True)
    pose = np.array([-6.0, 0.2, -0.1, *turn])
    image = model.light(pose)
    others = chart.to_pose(chart.lookalikes(chart.from_pose(pose, 0.0)), 0.0)[0]
    assert len(others) == 3
    naive = np.array([[*pose[:3], -turn[0], -turn[1]], [*pose[:3], turn[1], -turn[0]]])
    off = [np.abs(model.light(other) - image).max() for other in (*others, *naive)]
    assert max(off[:3]) < 0.01 * image.max()
    assert min(off[3:]) > 0.05 * image.max()
    assert chart.lookalikes(np.zeros(7)).shape == (3, 7)
    assert Chart(centre, math.radians(8), 0.1).lookalikes(np.zeros(5)).shape == (0, 5)


@example(
    chart=Chart(np.array([0.4, 0.0, 0.0]), math.radians(8), 0.1), pose=ALIGNED, roll=0.0
)  # on the beam's axis, where eta / sin(eta) is 0 / 0
@given(chart=charts, pose=poses, roll=rolls)
@settings(reproducible, max_examples=100)
def test_the_derivatives_of_the_chart_are_those_of_the_lamp_seen_from_the_body(chart, pose, roll):
    assume(facing(chart, pose, roll) > 0.05)
    coordinates = chart.from_pose(np.array(pose), roll)

    def lamp(at):
        return np.concatenate(lamp_in_body(chart.to_pose(at, roll)[0], roll))

    def pose_at(at):
        return chart.to_pose(at, roll)[0]

    *seen, derivatives, there, pose_derivatives, log_volume = chart.to_lamp(coordinates, roll)
    np.testing.assert_allclose(np.concatenate(seen), lamp(coordinates), rtol=1e-9, atol=1e-9)
    assert_close(derivatives, differentiate(lamp, coordinates))
    np.testing.assert_allclose(there, pose_at(coordinates), rtol=1e-9, atol=1e-9)
    assert_close(pose_derivatives, differentiate(pose_at, coordinates))
    assert log_volume == pytest.approx(np.linalg.slogdet(pose_derivatives)[1], abs=1e-9)
