"""Every analytic derivative of the light against finite differences."""

import numpy as np
import pytest
from differences import assert_close, differentiate
from drawn_effects import poses, scene_with
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.geometry import lamp_in_body, write_lamp_slopes
from uuv_optical_array.forward.model import ForwardModel

pytestmark = pytest.mark.filterwarnings("error")
reproducible = settings(max_examples=8)

EFFECTS = {
    "attenuation": {"k_per_m": 0.2},
    "beam_spread": {"scattering_per_m": 0.1, "scattering_angle_deg": 2.0},
    "responsivity": {"spread": 0.05, "seed": 2},
    "ambient": {"level_counts": 20.0},
    "forward_scatter": {"window_m": 0.25},
    "sensor_noise": {"sigma_counts": 1.0},
    "shot_noise": {"electrons_per_count": 50.0},
    "saturation": {"level_counts": 1023.0},
    "adc": {"bits": 10},
}
NUISANCES = (
    "lamp.power",
    "attenuation.k_per_m",
    "ambient.level_counts",
    "responsivity.temperature_c",
)
ALIGNED = (-6.0, 0.0, 0.0, 0.0, 0.0)

rolls = st.floats(-0.5, 0.5)


def make_model(shape, side, effects=EFFECTS):
    return ForwardModel(scene_with(effects, shape, side))


def incidence(array, pose, roll):
    """Cosines between the detectors' normals and the directions to the lamp."""
    turn = Rotation.from_euler("ZYX", [pose[4], pose[3], roll])
    to_lamp = -(turn.apply(array.positions) + pose[:3])
    return (turn.apply(array.normals) * to_lamp).sum(axis=1) / np.linalg.norm(to_lamp, axis=1)


def away_from_grazing(array, pose, roll):
    # Lambert's max(0, cos theta) has a kink where a detector turns away from the lamp: differences
    # across it are the mean of two slopes, which no derivative is.
    return np.abs(incidence(array, pose, roll)).min() > 1e-3


@pytest.mark.parametrize(("shape", "side"), [("planar", 4), ("curved", 21)])
@given(
    pose=poses,
    roll=rolls,
    offset=st.tuples(
        st.floats(-0.3, 0.3), st.floats(-0.05, 0.05), st.floats(-9, 9), st.floats(-5, 5)
    ),
    order=st.permutations(list(NUISANCES)),
    number=st.integers(0, 4),
)
@example(pose=ALIGNED, roll=0.0, offset=(0.0,) * 4, order=NUISANCES, number=4)
@reproducible
def test_the_jacobian_is_the_derivative_of_the_light(
    shape, side, pose, roll, offset, order, number
):
    model = make_model(shape, side)
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


def test_a_detector_that_faces_away_has_no_slope_and_no_light():
    model = make_model("curved", 5, {})
    pose = (-5.0, 0.0, 0.0, 0.0, 1.0)
    away = incidence(model.array, pose, 0.0) < 0
    assert 0 < away.sum() < 25
    image, jacobian = model.linearised(pose)
    assert not image[away].any()
    assert not jacobian[away].any()
    assert np.abs(jacobian[~away]).sum(axis=1).all()


@pytest.mark.parametrize(
    "name", ["attenuation.k_per_m", "responsivity.temperature_c", "lamp.colour"]
)
def test_a_nuisance_that_the_scene_does_not_have_is_refused(name):
    with pytest.raises(ValueError, match=name):
        make_model("curved", 5, {}).linearised(ALIGNED, 0.0, {name: np.zeros(())})


def test_the_slope_of_the_variance_is_its_derivative_by_the_light():
    model = make_model("curved", 5)
    light = np.linspace(5, 900, 100)
    _, slope = model.variance(light)
    h = 1e-3
    differences = (model.variance(light + h)[0] - model.variance(light - h)[0]) / (2 * h)
    np.testing.assert_allclose(slope, differences, atol=1e-9)
    assert slope.all()


@given(pose=poses, roll=rolls)
@settings(reproducible, max_examples=100)
def test_the_slopes_of_the_lamp_seen_from_the_body_are_its_derivatives(pose, roll):
    slopes = np.zeros((6, 5))
    write_lamp_slopes(pose, roll, lamp_in_body(*pose, roll), slopes)
    assert_close(
        slopes, differentiate(lambda at: np.array(lamp_in_body(*at, roll)), np.array(pose))
    )
