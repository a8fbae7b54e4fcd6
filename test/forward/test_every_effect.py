"""Every effect of the list, anywhere in its bounds: against the second forward model, its
derivatives against finite differences, and compiled against NumPy.

A new effect is tried here as soon as `second_forward` has it.
"""

import numpy as np
import pytest
import second_forward
from differences import extrapolated_slopes
from drawn_effects import any_scenes, poses, scenes
from fits import writer_of_fits
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from needs import numba

from uuv_optical_array.estimation.information.linearised import Lineariser
from uuv_optical_array.forward.effects import EFFECTS, MOVING
from uuv_optical_array.forward.light import COSINE
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

reproducible = settings(max_examples=15)
each_effect = pytest.mark.parametrize("name", list(EFFECTS))
times = st.floats(0, 1e5)
rolls = st.floats(-3, 3)
numbers = st.floats(-0.3, 0.3)


def model_of(scene):
    try:
        return ForwardModel(scene)
    except ValueError:  # all detectors dead, or gains of 0
        assume(False)


def drawn_model(data, name):
    """A model of a scene with an effect, with several, or with several lamps."""
    if name == "lamps":
        return ForwardModel(load_scene("leading_lights"))
    return model_of(data.draw(any_scenes() if name == "several" else scenes([name])))


def offsets_for(data, model):
    """Offsets of some of the settings that a prior may leave uncertain; of several lamps of all."""
    if model.scene.lamps:
        rng = np.random.default_rng(data.draw(st.integers(0, 2**31)))
        return {name: np.array(0.05 * rng.standard_normal()) for name in model.nuisances}
    names = data.draw(st.lists(st.sampled_from(model.nuisances), unique=True))
    # A sphere much smaller would end before the corners of the array.
    parts = {"array.radius_m": 0.3}
    return {name: np.array(parts.get(name, 1.0) * data.draw(numbers)) for name in names}


def test_the_second_forward_model_has_every_effect_in_the_same_order():
    assert list(second_forward.EFFECTS) == list(EFFECTS)


@each_effect
@given(data=st.data())
@reproducible
def test_the_light_is_that_of_the_second_forward_model(name, data):
    scene = data.draw(scenes([name]))
    model = model_of(scene)
    # What moves is seen by a follower without roll; without a moment there is the mean sea, which
    # estimators believe.
    time_s = data.draw(st.none() | times) if name in MOVING else None
    roll = 0.0 if name in MOVING else data.draw(rolls)
    assert_light(model, data.draw(poses), roll, offsets_for(data, model), time_s)


@given(scene=any_scenes(), pose=poses, data=st.data())
@settings(reproducible, max_examples=100)
def test_effects_together_give_the_light_of_the_second_forward_model(scene, pose, data):
    model = model_of(scene)
    assert_light(model, pose, 0.0, offsets_for(data, model), data.draw(times))


def assert_light(model, pose, roll, offsets, time_s):
    found = model.light(pose, roll, offsets, time_s)
    expected = second_forward.light(model.scene.settings(), pose, roll, offsets, time_s)
    # Of the sine of a fast flicker after a long time, and of the rim of a narrow housing, the
    # argument's rounding is what is left.
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * expected.max())


@each_effect
@given(data=st.data())
@reproducible
def test_variance_and_limits_are_those_of_the_second_forward_model(name, data):
    model = model_of(data.draw(scenes([name])))
    plain = model.scene.settings()
    light = np.array(data.draw(st.lists(st.floats(1e-3, 2e6), min_size=4, max_size=4)))
    variance, slope = model.variance(light)
    expected = np.array([second_forward.variance(plain, float(value)) for value in light])
    np.testing.assert_allclose(variance, expected, rtol=1e-9)
    # Of a polynomial of second order a central difference is the slope; above the least there is.
    dark = second_forward.black(plain["effects"])
    beside = [
        [
            second_forward.noise_variance(plain, dark + by * max(value - dark, 0))
            for by in (0.5, 1.5)
        ]
        for value in light.tolist()
    ]
    lit = np.maximum(light - dark, 1e-300)
    slopes = np.where((expected > 1e-6) & (light > dark), np.diff(beside)[:, 0] / lit, 0.0)
    # The difference has the rounding of two variances, over the light between them.
    rounding = 1e-15 * expected * np.maximum(1.0, 1 / lit)
    assert (np.abs(slope - slopes) <= 1e-6 * np.abs(slopes) + rounding).all()
    # No halves, which a converter may round either way.
    readings = np.concatenate([np.floor(light) + 0.3, np.floor(light) + 0.7, [-3.2, -0.4, 2e6]])
    expected = [second_forward.converted(plain, float(reading)) for reading in readings]
    np.testing.assert_array_equal(model.converted(readings), expected)


@pytest.mark.parametrize("name", [*EFFECTS, "several", "lamps"])
@given(data=st.data())
@reproducible
def test_the_jacobian_is_that_of_finite_differences(name, data):
    model = drawn_model(data, name)
    pose, roll = data.draw(poses), data.draw(rolls)
    offsets = offsets_for(data, model)
    # Lambert's max(0, cos) has a kink where a detector turns away.
    cosines = model.rays(np.array([pose]), np.array([roll]))[COSINE]
    assume(np.abs(cosines).min() > 0.04)
    values = np.array([*pose, *offsets.values()])

    def light(at):
        moved = {key: at[..., 5 + i] for i, key in enumerate(offsets)}
        return model.light(at[..., :5], roll, moved).reshape(*at.shape[:-1], -1)

    image, jacobian = model.linearised(pose, roll, offsets)
    np.testing.assert_allclose(image, light(values), rtol=1e-12)
    expected, error = extrapolated_slopes(light, values, 1e-2)
    scale = np.abs(expected).max(axis=0)
    assume((error <= 1e-6 * scale + 1e-9).all())  # or the differences prove nothing
    assert (np.abs(jacobian - expected) <= 10 * error + 1e-8 * scale + 1e-9).all()


@numba
@pytest.mark.parametrize("name", [*EFFECTS, "lamps"])
@given(data=st.data())
@reproducible
def test_compiled_light_and_slopes_are_those_of_numpy(name, data):
    model = drawn_model(data, name)
    offsets = offsets_for(data, model)
    at = np.array([*data.draw(poses), *offsets.values()])
    roll, dark = data.draw(rolls), np.zeros(model.image_shape).ravel()
    ways = (Lineariser(model, tuple(offsets), write) for write in (None, writer_of_fits()))
    plain, found = (linearise(dark, at, roll) for linearise in ways)
    for ours, theirs in (
        (found.light, plain.light),
        *zip(found.slopes.T, plain.slopes.T, strict=True),
    ):
        # At the foot of a narrow housing the light is rounding, and its slopes are steep.
        assert (np.abs(ours - theirs) <= 1e-12 * np.abs(theirs).max() + 1e-9).all()
