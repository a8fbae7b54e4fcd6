"""Coordinates of pose and constants: there and back, their slopes, and what they are good for."""

import numpy as np
import pytest
from differences import assert_close, differentiate
from drawn_effects import SHAPES, poses, scene_with
from hypothesis import given, settings
from hypothesis import strategies as st

from uuv_optical_array.estimation.unknowns.coordinates import frame_of
from uuv_optical_array.estimation.unknowns.joint_coordinates import JointCoordinates
from uuv_optical_array.forward.model import ForwardModel

pytestmark = pytest.mark.filterwarnings("error")
NAMES = ("ambient.level_counts", "lamp.power", "lamp.beam_sigma_deg", "attenuation.k_per_m")
WATER = {"attenuation": {"k_per_m": 0.1}, "ambient": {"level_counts": 0.0}}
offsets = st.tuples(
    st.floats(-10, 10), st.floats(-0.5, 0.5), st.floats(-2, 2), st.floats(-0.09, 0.2)
)


SEA = {"sea": {"absorption_per_m": 0.1, "scattering_per_m": 0.5}}
SEA_NAMES = ("sea.scattering_per_m", "lamp.power", "lamp.beam_sigma_deg", "sea.absorption_per_m")


@pytest.mark.parametrize(("effects", "names"), [(WATER, NAMES), (SEA, SEA_NAMES)])
@pytest.mark.parametrize("shape", SHAPES)
@settings(max_examples=60)
@given(pose=poses, offset=offsets)
def test_there_and_back_with_slopes_that_are_differences(shape, effects, names, pose, offset):
    joint = JointCoordinates(frame_of(ForwardModel(scene_with(effects, shape))), names)
    offset = (0.1 * offset[0], *offset[1:])
    at = np.array([*pose, *offset])
    coordinates = joint.of(at)
    back, slopes = joint.place(coordinates)
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
def test_a_wrong_constant_that_keeps_the_coordinates_keeps_the_light(effects, names):
    # Along the valley, where power, water and range make up for each other.
    model = ForwardModel(scene_with(effects, "curved"))
    joint = JointCoordinates(frame_of(model), names)
    at = np.array([-6.0, 0.4, -0.3, 0.1, -0.08, 0.0, 0.0])
    coordinates, light = joint.of(at), model.light(at[:5])
    step = 0.3 if names[1] == "sea.scattering_per_m" else 0.04
    for wrong in ([0.2, 0.0], [0.0, step], [-0.2, step]):
        place, _ = joint.place(np.array([*coordinates[:5], *wrong]))
        assert abs(place[0] - at[0]) > 0.1
        known = dict(zip(names, np.array(wrong), strict=True))
        kept = model.light(place[:5], offsets=known)
        moved = model.light(at[:5], offsets=known)
        assert np.abs(kept - light).max() < 0.1 * np.abs(moved - light).max()


def test_angles_differ_the_short_way_round():
    joint = JointCoordinates(frame_of(ForwardModel(scene_with(WATER, "curved"))), NAMES)
    one, other = np.full(9, 3.1), np.full(9, -3.1)
    expected = np.full(9, 6.2)
    expected[[0, 4]] -= 2 * np.pi
    np.testing.assert_allclose(joint.difference(one, other), expected, rtol=1e-12)
