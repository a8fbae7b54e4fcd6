"""Several lamps: each beside one lamp seen from its own frame, and what they show together."""

import dataclasses

import numpy as np
import pytest
import second_forward
from differences import differentiate
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import changed
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.geometry import rolled
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import ROLL, PriorSettings
from uuv_optical_array.forward.scene import load_scene

SCENE = load_scene("leading_lights")
MODEL = ForwardModel(SCENE)
PEDESTAL = SCENE.effects["demodulation"]["pedestal_counts"]
reproducible = settings(max_examples=15, deadline=None)
poses = st.tuples(
    st.floats(-8, -3), *[st.floats(-0.9, 0.9)] * 2, *[st.floats(-0.35, 0.35)] * 2
).map(np.array)
rolls = st.floats(-0.5, 0.5)


def with_lamps(*lamps, **effects):
    return changed(SCENE, effects=effects, lamps=list(lamps))


def seen_from(lamp, pose, roll):
    """Pose and roll of a follower in the frame of a lamp, by SciPy."""
    angles = [lamp.get("yaw_deg", 0.0), lamp.get("pitch_deg", 0.0)]
    turn = Rotation.from_euler("ZY", angles, degrees=True).inv()
    place = [lamp.get(f"{axis}_m", 0.0) for axis in "xyz"]
    body = turn * Rotation.from_euler("ZYX", [pose[4], pose[3], roll])
    yaw, pitch, roll = body.as_euler("ZYX")
    return np.array([*turn.apply(pose[:3] - place), pitch, yaw]), roll


@given(pose=poses, roll=rolls, data=st.data())
@reproducible
def test_each_lamp_gives_the_light_of_one_lamp_in_its_own_frame(pose, roll, data):
    numbers = st.floats(-0.5, 0.5)
    lamps = [
        {
            **{f"{axis}_m": data.draw(numbers) for axis in "xyz"},
            **{f"{axis}_deg": 10 * data.draw(numbers) for axis in ("pitch", "yaw")},
            "power": power,
        }
        for power in (1.0, 3.0)
    ]
    lamps[1]["beam_sigma_deg"] = 11.0
    found = ForwardModel(with_lamps(*lamps)).light(pose, roll).reshape(2, 5, 5) - PEDESTAL
    alone = SCENE.settings()
    power = second_forward.power_of(alone)
    for lamp, image, share in zip(lamps, found, (0.25, 0.75), strict=True):
        alone["lamp"]["beam_sigma_deg"] = lamp.get("beam_sigma_deg", 8.0)
        one = second_forward.light(alone, *seen_from(lamp, pose, roll), power=share * power)
        np.testing.assert_allclose(image, one - PEDESTAL, rtol=1e-8, atol=1e-9)


@given(pose=poses, roll=rolls, angle=st.floats(-0.3, 0.3))
@reproducible
def test_the_unknown_roll_is_a_turn_of_the_follower_about_the_beam(pose, roll, angle):
    turned, turned_roll = rolled(pose, roll, angle)
    body = Rotation.from_euler("ZYX", [pose[4], pose[3], roll])
    expected = Rotation.from_euler("x", angle) * body
    found = Rotation.from_euler("ZYX", [turned[4], turned[3], turned_roll])
    assert (found.inv() * expected).magnitude() < 1e-9
    light = MODEL.light(pose, roll, {ROLL: np.array(angle)})
    np.testing.assert_allclose(MODEL.light(turned, turned_roll), light, rtol=1e-9)


def test_the_bound_is_that_of_pose_and_roll_together():
    """By differences of the light at a pose and a roll, with the prior of the roll, inverted."""
    known = PriorSettings(roll_std_deg=2.0)
    model = ForwardModel(dataclasses.replace(SCENE, prior=known))
    pose = np.array([-5.0, 0.4, -0.3, 0.1, 0.15])

    def light(at):
        return model.light(*rolled(at[:5], 0.0, at[5])).ravel()

    slopes = differentiate(light, np.append(pose, 0.0))
    # By the pose as it is: what a turn adds to it is taken off.
    slopes[:, 5:] -= slopes[:, :5] @ differentiate(lambda at: rolled(pose, 0.0, at[0])[0], [0.0])
    weights = 1 / model.variance(model.light(pose).ravel())[0]
    joint = slopes.T @ (weights[:, None] * slopes)
    joint[5, 5] += np.radians(2.0) ** -2
    expected = np.linalg.inv(joint)[:5, :5]
    np.testing.assert_allclose(cramer_rao_bound(model, pose).covariance, expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("lamps", "effects", "message"),
    [
        ([{"y_m": 0.1}], {}, "not a list of 2 to 8 lamps; for one lamp leave it out"),
        ([{"y_m": i} for i in range(9)], {}, "not a list of 2 to 8 lamps"),
        (
            [{"y_m": 0.1}, {"y_m": 0.105}],
            {},
            r"lamps\[1\]: within 0.01 m and 0.1 deg of lamps\[0\]",
        ),
        ([{"y_m": 0.1}, {"y_m": 20}], {}, r"lamps\[1\].y_m: 20 is out of bounds"),
        ([{"y_m": 0.1}, {"yaw": 3}], {}, r"lamps\[1\].yaw"),
        ([{"y_m": 0.1}, {}], {"demodulation": None}, "only demodulation separates their light"),
        ([{"y_m": 0.1}, {}], {"forward_scatter": {"window_m": 0.2}}, "it takes one lamp only"),
    ],
)
def test_lamps_that_cannot_work_are_refused_with_the_reason(lamps, effects, message):
    with pytest.raises(ValueError, match=message):
        with_lamps(*lamps, **effects)
