"""The coordinates of pose and constants: their meaning, there and back, and derivatives."""

import math

import numpy as np
import pytest
from differences import assert_close, differentiate
from drawn_effects import poses
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scenes import SHAPES, make_scene
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.geometry import lamp_in_body
from uuv_optical_array.estimation.unknowns.coordinates import (
    CoordinateFrame,
    frame_of,
    from_pose,
    to_lamp,
    write_slopes,
)
from uuv_optical_array.estimation.unknowns.joint_coordinates import JointCoordinates
from uuv_optical_array.forward.lamp.beam import UNIT
from uuv_optical_array.forward.model import ForwardModel

pytestmark = pytest.mark.filterwarnings("error")
reproducible = settings(max_examples=100)
ALIGNED = (-6.0, 0.0, 0.0, 0.0, 0.0)
rolls = st.floats(-0.5, 0.5)


BEAM = np.array([[-0.2, 0.9, 0.3], [0.5, 0.9, 1.7]])  # weights and widths of three Gaussians
LAMP = {"beam_weights": BEAM[0].tolist(), "beam_widths": BEAM[1].tolist()}


def frame_like(centre, sigma_rad, k_per_m=0.0, planar=False, gaussians=UNIT):
    weight = sigma_rad**-2
    share = weight / (weight + 3) if planar else 0.0
    return CoordinateFrame(*centre, sigma_rad, k_per_m, share, 0.0, gaussians)


frames = st.builds(
    frame_like,
    st.tuples(st.floats(-0.5, 1), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)),
    st.floats(math.radians(2), math.radians(30)),
    st.one_of(st.just(0.0), st.floats(1e-3, 0.2)),
    st.booleans(),
    st.sampled_from([UNIT, BEAM]),
)


def slopes_at(frame, at, roll, lamp):
    shape = np.shape(at)[1:]
    slopes, pose_slopes = np.zeros((6, 5, *shape)), np.zeros((5, 5, *shape))
    write_slopes(frame, at, roll, lamp, slopes, pose_slopes)
    return slopes, pose_slopes


def lamp_and_pose(frame, at, roll):
    lamp, pose, _ = to_lamp(frame, at, roll)
    return np.array(lamp), np.array(pose)


def facing(frame, pose, roll):
    """Cosine between the array's axis and the way to the lamp; positive where it sees it."""
    sight = np.array(lamp_in_body(pose, roll)[:3]) - frame[:3]
    return sight[0] / np.linalg.norm(sight)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_frame_of_a_scene_is_that_of_its_array_lamp_and_water(shape):
    model = ForwardModel(make_scene(shape, effects={"attenuation": {"k_per_m": 0.1}}))
    # The mean of the detectors: on the curved array they bulge ahead of its frame.
    offsets = (-0.2, -0.1, 0.0, 0.1, 0.2)
    depths = [math.sqrt(0.32**2 - y**2 - z**2) for y in offsets for z in offsets]
    ahead = 0.4 + (sum(depths) / 25 if shape == "curved" else 0.0)
    expected = frame_like((ahead, 0, 0), math.radians(8), 0.1, shape == "planar")
    found = frame_of(model)
    np.testing.assert_allclose(found[:-1], expected[:-1], rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(found.gaussians, UNIT)


def test_the_frame_of_three_gaussians_is_as_wide_as_the_light_there():
    sea = {"sea": {"absorption_per_m": 0.1, "scattering_per_m": 0.3}}
    for effects in ({}, sea):
        model = ForwardModel(make_scene(effects=effects, **LAMP))
        frame, eta = frame_of(model), np.linspace(0, 0.5, 2001)
        # A lone detector, so to speak, that looks at the lamp from the table's middle.
        beam = np.exp(-(eta[:, None] ** 2) / 2 / (frame.beam_sigma_rad * frame.gaussians[1]) ** 2)
        beam = beam @ frame.gaussians[0]
        assert np.interp(math.exp(-0.5), beam[::-1], eta[::-1]) == pytest.approx(
            frame.beam_sigma_rad, rel=1e-4
        )
        if not effects:
            clear = np.exp(-(eta[:, None] ** 2) / 2 / (math.radians(8) * BEAM[1]) ** 2) @ BEAM[0]
            np.testing.assert_allclose(beam, clear, rtol=1e-9)
        else:
            middle = model.array.positions[12, 0]
            places = [[-6 * math.cos(e), 6 * math.sin(e), 0, 0, -e] for e in (0.0, 0.12)]
            places = np.array(places)
            places[:, 0] -= middle * np.cos(places[:, 4])
            places[:, 1] -= middle * np.sin(places[:, 4])
            on_axis, off_axis = model.light(places)[:, 2, 2]
            assert off_axis / on_axis == pytest.approx(np.interp(0.12, eta, beam), abs=0.03)


@pytest.mark.parametrize(("k", "r"), [(0.1, 100.0), (0.5, 20.0), (3.0, 4.0), (10.0, 1.0)])
def test_the_coordinates_hold_in_thick_water_too(k, r):
    frame = frame_like((0.0, 0.0, 0.0), math.radians(8), k)
    pose = np.array([-r, 0.0, 0.0, 0.0, 0.0])
    _, back = lamp_and_pose(frame, from_pose(frame, pose, 0.0), 0.0)
    np.testing.assert_allclose(back, pose, rtol=1e-7)


@given(frame=frames, pose=poses, roll=rolls)
@reproducible
def test_the_coordinates_are_place_and_dimness_of_the_lamp_and_lead_back(frame, pose, roll):
    assume(facing(frame, pose, roll) > 0.01)
    turn = Rotation.from_euler("ZYX", [pose[4], pose[3], roll])
    centre = turn.apply(frame[:3]) + pose[:3]
    x, y, z = turn.inv().apply(-centre)
    r = np.linalg.norm(centre)
    off_axis = math.atan2(math.hypot(centre[1], centre[2]), -centre[0])
    beam = (off_axis / frame.beam_sigma_rad) ** 2 / 4
    if frame.gaussians is BEAM:
        nearer = beam * (BEAM[1] ** -2.0 - BEAM[1].max() ** -2.0)  # to the widest: not 0
        beam = beam / BEAM[1].max() ** 2 - 0.5 * math.log(BEAM[0] @ np.exp(-2 * nearer))
        assume(beam < 300)
    dimness = math.log(r) + frame.k_per_m * r / 2 + beam
    azimuth, elevation = math.atan2(y, x), math.asin(z / r)
    if frame.share > 0:
        ahead = turn.inv().apply([1.0, 0.0, 0.0])  # against the beam
        weight = frame.beam_sigma_rad**-2
        share = weight / (weight + 3)
        azimuth -= share * math.atan2(ahead[1], ahead[0])
        elevation -= share * math.asin(ahead[2])
        dimness -= 0.5 * math.log(facing(frame, pose, roll))
    coordinates = from_pose(frame, np.array(pose), roll)
    expected = [azimuth, elevation, dimness, *pose[3:]]
    np.testing.assert_allclose(coordinates, expected, rtol=1e-9, atol=1e-9)
    lamp, back = lamp_and_pose(frame, coordinates, roll)
    np.testing.assert_allclose(back, pose, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(lamp, lamp_in_body(pose, roll), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("turn", [(0.1, -0.05), (-0.08, 0.12)])
def test_the_lookalikes_of_a_planar_array_look_alike(turn):
    """To second order the light depends on pitch and yaw by the sum of their squares alone.

    Turned as far in pitch and yaw without these coordinates, the image is a quite different one.
    """
    model = ForwardModel(make_scene("planar", effects={"attenuation": {"k_per_m": 0.1}}))
    frame = frame_of(model)
    pose = np.array([-6.0, 0.2, -0.1, *turn])
    image = model.light(pose)
    coordinates, others = from_pose(frame, pose, 0.0), []
    for _ in range(4):
        coordinates[3:] = coordinates[4], -coordinates[3]
        others.append(lamp_and_pose(frame, coordinates, 0.0)[1])
    np.testing.assert_allclose(others.pop(), pose, rtol=1e-9, atol=1e-9)  # four are a whole turn
    naive = np.array([[*pose[:3], -turn[0], -turn[1]], [*pose[:3], turn[1], -turn[0]]])
    off = [np.abs(model.light(other) - image).max() for other in (*others, *naive)]
    assert max(off[:3]) < 0.01 * image.max()
    assert min(off[3:]) > 0.05 * image.max()


@example(
    frame=frame_like((0.4, 0.0, 0.0), math.radians(8), 0.1), pose=ALIGNED, roll=0.0
)  # on the beam's axis, where eta / sin(eta) is 0 / 0
# Far beside a narrow beam, where the fifth derivative is large.
@example(frame=frame_like((0.0, 0.0, 0.0), 0.035), pose=(-2.0, 1.0, 1.0, 0.0, 0.0), roll=0.5)
@given(frame=frames, pose=poses, roll=rolls)
@reproducible
def test_the_derivatives_of_the_coordinates_are_those_of_lamp_and_pose(frame, pose, roll):
    assume(facing(frame, pose, roll) > 0.05)
    coordinates = from_pose(frame, np.array(pose), roll)
    lamp, there, log_volume = to_lamp(frame, coordinates, roll)
    slopes, pose_slopes = slopes_at(frame, coordinates, roll, lamp)

    def lamp_at(at):
        return np.array(lamp_in_body(lamp_and_pose(frame, at, roll)[1], roll))

    def pose_at(at):
        return lamp_and_pose(frame, at, roll)[1]

    np.testing.assert_allclose(lamp, lamp_at(coordinates), rtol=1e-9, atol=1e-9)
    assert_close(slopes, differentiate(lamp_at, coordinates, 1e-4))
    np.testing.assert_allclose(there, pose_at(coordinates), rtol=1e-9, atol=1e-9)
    assert_close(pose_slopes, differentiate(pose_at, coordinates, 1e-4))
    assert log_volume == pytest.approx(np.linalg.slogdet(pose_slopes)[1], abs=1e-9)


@pytest.mark.parametrize("planar", [False, True])
def test_many_poses_at_once_have_the_coordinates_of_each(planar):
    rng, frame = np.random.default_rng(4), frame_like((0.4, 0, 0), math.radians(8), 0.1, planar)
    many = np.array(ALIGNED)[:, None] + 0.2 * rng.standard_normal((5, 7))
    rolls = 0.2 * rng.standard_normal(7)

    def everything(poses, roll):
        at = from_pose(frame, poses, roll)
        lamp, pose, log_volume = to_lamp(frame, at, roll)
        return at, np.array(lamp), np.array(pose), log_volume, *slopes_at(frame, at, roll, lamp)

    together = everything(many, rolls)
    for i in range(7):
        for found, alone in zip(together, everything(many[:, i], rolls[i]), strict=True):
            np.testing.assert_allclose(found[..., i], alone, rtol=1e-10, atol=1e-10)


# Of pose and constants together.
NAMES = ("ambient.level_counts", "lamp.power", "lamp.beam_sigma_deg", "attenuation.k_per_m")
WATER = {"attenuation": {"k_per_m": 0.1}, "ambient": {"level_counts": 0.0}}
offsets = st.tuples(
    st.floats(-10, 10), st.floats(-0.5, 0.5), st.floats(-2, 2), st.floats(-0.09, 0.2)
)


SEA = {"sea": {"absorption_per_m": 0.1, "scattering_per_m": 0.5}}
SEA_NAMES = ("sea.scattering_per_m", "lamp.power", "lamp.beam_sigma_deg", "sea.absorption_per_m")


@pytest.mark.parametrize(("effects", "names"), [(WATER, NAMES), (SEA, SEA_NAMES)])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("lamp", [{}, LAMP], ids=["one Gaussian", "three Gaussians"])
@settings(max_examples=60)
@given(pose=poses, offset=offsets)
def test_there_and_back_with_slopes_that_are_differences(shape, lamp, effects, names, pose, offset):
    model = ForwardModel(make_scene(shape, effects=effects, **lamp))
    joint = JointCoordinates(frame_of(model), names)
    offset = (0.1 * offset[0], *offset[1:])
    at = np.array([*pose, *offset])
    coordinates, slopes = joint.of(at)
    back, _ = joint.place(coordinates)
    np.testing.assert_allclose(back, at, rtol=1e-7, atol=1e-7)
    assert_close(slopes, differentiate(lambda c: joint.place(c)[0], coordinates))


@pytest.mark.parametrize(
    ("effects", "names"),
    [
        (WATER, ("lamp.power", "attenuation.k_per_m")),
        (SEA, ("lamp.power", "sea.absorption_per_m")),
        (SEA, ("lamp.power", "sea.scattering_per_m")),
    ],
)
@pytest.mark.parametrize("lamp", [{}, LAMP], ids=["one Gaussian", "three Gaussians"])
def test_a_wrong_constant_that_keeps_the_coordinates_keeps_the_light(effects, names, lamp):
    # Along the valley, where power, water and range make up for each other.
    model = ForwardModel(make_scene(effects=effects, **lamp))
    joint = JointCoordinates(frame_of(model), names)
    at = np.array([-6.0, 0.4, -0.3, 0.1, -0.08, 0.0, 0.0])
    (coordinates, _), light = joint.of(at), model.light(at[:5])
    step = 0.3 if names[1] == "sea.scattering_per_m" else 0.04
    for wrong in ([0.2, 0.0], [0.0, step], [-0.2, step]):
        place, _ = joint.place(np.array([*coordinates[:5], *wrong]))
        assert abs(place[0] - at[0]) > 0.1
        known = dict(zip(names, np.array(wrong), strict=True))
        kept = model.light(place[:5], offsets=known)
        moved = model.light(at[:5], offsets=known)
        assert np.abs(kept - light).max() < 0.1 * np.abs(moved - light).max()


@pytest.mark.parametrize(("linear", "angles"), [(False, [0, 4]), (True, [4])])
def test_angles_differ_the_short_way_round(linear, angles):
    frame = None if linear else frame_of(ForwardModel(make_scene(effects=WATER)))
    expected = np.full(9, 6.2)
    expected[angles] -= 2 * np.pi
    found = JointCoordinates(frame, NAMES).difference(np.full(9, 3.1), np.full(9, -3.1))
    np.testing.assert_allclose(found, expected, rtol=1e-12)
