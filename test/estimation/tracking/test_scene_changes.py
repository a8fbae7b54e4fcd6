"""What to change in a scene: written there, it gives the light of the sea that was found."""

import math
import re

import numpy as np
import pytest
from scenes import READY, changed, make_scene, nested, ready

from uuv_optical_array.estimation.tracking.scene_changes import scene_changes
from uuv_optical_array.estimation.tracking.track import Learnt
from uuv_optical_array.estimation.unknowns.constants import Constants, constants_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import GRADIENTS, ROLL

NAMES = ("lamp.power", "attenuation.k_per_m", "ambient.level_counts")
STDS = dict(zip(NAMES, (0.1, 0.02, 5.0), strict=True))
CONSTANTS = Constants(NAMES, tuple(STDS.values()))
MODEL = ForwardModel(
    make_scene(effects={"attenuation": {"k_per_m": 0.1}, "ambient": {"level_counts": 20.0}})
)
SEA = {"absorption_per_m": 0.1, "scattering_per_m": 0.2}
IN_SEA = ForwardModel(make_scene(effects={"sea": SEA}))
OF_SEA_AND_ARRAY = {
    "sea.absorption_per_m": 0.02,
    "sea.scattering_per_m": 0.3,
    "field_of_view.cosine_power": 0.1,
    "array.radius_m": 0.02,
}
LAMPS = ready("leading_lights").settings()["lamps"]
LAMPS[1]["power"] = 2.0
OF_THREE_LAMPS = ForwardModel(changed("leading_lights", lamps=LAMPS))
BY_LAMP = {
    "lamp.power": 0.05,
    "lamps.0.power": 0.03,
    "lamps.0.pitch_deg": 0.2,
    "lamps.1.y_m": 0.002,
    "lamps.2.power": 0.03,
}
POSES = np.array([[-4.0, 0, 0, 0, 0], [-7.0, 0.4, -0.3, 0.1, -0.1]])


def learnt(*offsets, std=10.0):
    return {name: Learnt(offset, std) for name, offset in zip(NAMES, offsets, strict=True)}


def model_with(changes, model=MODEL):
    """Return the model's scene with changes written into it, by their dotted keys."""
    scene = model.scene
    for change in changes:
        if found := re.fullmatch(r"lamps\[(\d)\]\.(\w+)", change.key):
            lamps = scene.settings()["lamps"]
            lamps[int(found[1])][found[2]] = change.value
            scene = changed(scene, lamps=lamps)
        else:
            scene = changed(scene, **nested(change.key, change.value))
    return ForwardModel(scene)


@pytest.mark.parametrize(
    ("model", "stds", "offsets"),
    [
        (MODEL, STDS, (0.4, 0.0, 0.0)),
        (MODEL, STDS, (-0.5, 0.0, 0.0)),
        (MODEL, STDS, (0.0, 0.08, 0.0)),
        (MODEL, STDS, (0.35, -0.09, 30.0)),
        (IN_SEA, OF_SEA_AND_ARRAY, (0.07, 1.2, 0.4, 0.08)),
        (OF_THREE_LAMPS, BY_LAMP, (0.3, -0.3, -2.0, 0.03, 0.2)),
    ],
)
def test_the_changed_scene_gives_the_light_that_was_found(model, stds, offsets):
    found = {name: Learnt(offset, 1e-3) for name, offset in zip(stds, offsets, strict=True)}
    changes = scene_changes(model, Constants(tuple(stds), tuple(stds.values())), found)
    known = dict(zip(stds, np.array(offsets), strict=True))
    expected = np.array([model.light(pose, offsets=known) for pose in POSES])
    np.testing.assert_allclose(model_with(changes, model).light(POSES), expected, rtol=1e-9)


@pytest.mark.parametrize("name", READY)
def test_each_constant_of_each_ready_scene_may_be_off(name):
    model = ForwardModel(ready(name))
    constants = constants_of(model)
    for constant, std in zip(constants.names, constants.stds, strict=True):
        for off in (3.1 * std, -3.1 * std):
            changes = scene_changes(model, constants, {constant: Learnt(off, 1e-3 * std)})
            assert all(math.isfinite(change.value) for change in changes)
            if constant in (ROLL, *GRADIENTS):  # which no scene holds
                assert changes == []
                continue
            if off < 0:
                continue  # no value is below nothing
            expected = model.light(POSES[0], offsets={constant: np.array(off)})
            found = model_with(changes, model).light(POSES[0])
            np.testing.assert_allclose(found, expected, rtol=6e-3, atol=1e-9, err_msg=constant)


def test_only_what_is_off_by_more_than_asked_is_named_with_key_value_and_reason():
    found = learnt(0.29, -0.1 + 0.02, 15.1)
    water, ambient, lamp = scene_changes(MODEL, CONSTANTS, found)
    assert (water.key, water.value) == ("effects.attenuation.k_per_m", pytest.approx(0.02))
    assert water.text == (
        "attenuation.k_per_m is 4.0 standard deviations of its prior below the scene; "
        "write effects.attenuation.k_per_m: 0.02"
    )
    assert ambient.text.endswith("above the scene; write effects.ambient.level_counts: 35.1")
    assert lamp.key == "lamp.reference_counts"
    assert lamp.text.startswith("with that the lamp is the same; write lamp.reference_counts: ")
    assert scene_changes(MODEL, CONSTANTS, learnt(0.29, 0.05, -14.9)) == []
    one, two = (scene_changes(MODEL, CONSTANTS, learnt(0.31, 0, 0), beyond) for beyond in (3, 3.2))
    assert [change.key for change in one] == ["lamp.reference_counts"]
    assert two == []


def test_what_is_known_to_be_off_is_named_within_its_prior():
    def keys(offset, std):
        changes = scene_changes(MODEL, CONSTANTS, learnt(0, 0, offset, std=std))
        return [change.key for change in changes]

    # Of a prior of 5 counts: beyond it, and beyond six standard deviations of what is known.
    assert keys(6.0, 0.99) == keys(-6.0, 0.99) == ["effects.ambient.level_counts"]
    assert keys(6.0, 1.01) == keys(4.9, 0.01) == []


def test_no_value_is_below_nothing():
    (ambient,) = scene_changes(MODEL, CONSTANTS, learnt(0, 0, -40.0))
    assert (ambient.key, ambient.value) == ("effects.ambient.level_counts", 0.0)
