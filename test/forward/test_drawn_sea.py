"""A sea drawn from a scene's prior: how far it is off, and how it says so."""

import dataclasses

import numpy as np
import pytest
from scenes import changed

from uuv_optical_array.forward.aim import apparent
from uuv_optical_array.forward.drawn_sea import draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import ROLL
from uuv_optical_array.forward.scene import load_scene

DRAWS = 400
FIVE_SIGMA = 5 / np.sqrt(2 * DRAWS)  # of a standard deviation by so many draws, relative


@pytest.mark.parametrize("name", ["follow", "leading_lights"])
def test_each_setting_varies_as_the_prior_says(name):
    scene, rng = load_scene(name), np.random.default_rng(3)
    seas = [draw_sea(scene, rng) for _ in range(DRAWS)]
    stds = scene.nuisance_std()
    roll_std = stds.pop(ROLL, 0.0)
    offsets = {key: [float(sea.offsets[key]) for sea in seas] for key in seas[0].offsets}
    assert offsets.keys() == stds.keys()
    for key, values in offsets.items():
        assert np.sqrt(np.mean(np.square(values))) == pytest.approx(stds[key], rel=FIVE_SIGMA), key
    assert np.std([sea.roll for sea in seas]) == pytest.approx(roll_std, rel=FIVE_SIGMA)
    aims = np.array([sea.aims for sea in seas])
    assert aims.std(axis=0) == pytest.approx(np.ones(4), rel=FIVE_SIGMA)
    gains = np.array([sea.gains for sea in seas])
    assert gains.shape[1:] == (5, 5)
    assert gains.std() == pytest.approx(scene.prior.gain_std, rel=FIVE_SIGMA / 5)
    assert gains.mean() == pytest.approx(1, abs=5 * scene.prior.gain_std / np.sqrt(25 * DRAWS))


def test_water_takes_light_however_uncertain_it_is():
    scene = changed("follow", prior={"absorption_std_per_m": 1.0})
    name, per_m = scene.attenuation
    rng = np.random.default_rng(1)
    offsets = np.array([float(draw_sea(scene, rng).offsets[name]) for _ in range(50)])
    assert offsets.min() == -per_m  # as of nearly half of them
    assert (offsets >= -per_m).all()


def test_what_differs_is_said_as_a_ratio_where_it_is_one_and_nothing_is_no_word():
    known = load_scene("reference")
    assert draw_sea(known, np.random.default_rng(1)).in_words(known) == ""
    prior = {"known": "exactly", "lamp_power_std": 0.1, "ambient_std_counts": 5.0}
    scene = changed("follow", prior={**prior, "lamp_aim_std_deg": 0.5, "gain_std": 0.01})
    sea = draw_sea(scene, np.random.default_rng(2))
    power, ambient, pitch, yaw, gains = sea.in_words(scene).split(", ")
    name, _, ratio = power.partition(" x")
    assert (name, float(ratio)) == (
        "lamp.power",
        pytest.approx(np.exp(sea.offsets["lamp.power"]), abs=6e-4),
    )
    name, _, counts = ambient.partition(" ")
    assert (name, float(counts)) == (
        "ambient.level_counts",
        pytest.approx(float(sea.offsets["ambient.level_counts"]), rel=6e-3),
    )
    assert pitch == f"lamp pitch {0.5 * sea.aims[2]:+.2f} deg"
    assert yaw == f"lamp yaw {0.5 * sea.aims[3]:+.2f} deg"
    assert gains == f"gains {100 * sea.gains.std():.2g} % apart"


def test_the_apparent_source_of_a_lamp_is_as_far_behind_its_face_as_the_prior_says():
    """Images of drawn seas against those of scenes whose lamp is told to be there."""
    prior = {"known": "exactly", "lamp_behind_std_m": 0.1}
    scene, rng = changed("follow", lamp={"behind_m": 0.05}, prior=prior), np.random.default_rng(4)
    model, pose, found = ForwardModel(scene), np.array([-5.0, 0.4, -0.3, 0.1, -0.2]), []
    for _ in range(DRAWS):
        sea = draw_sea(scene, rng)
        (seen,) = apparent(scene, pose[None], sea.aims[None])
        name, _, metres = sea.in_words(scene).partition(" ")
        assert name == "lamp.behind_m"
        found.append(float(metres))
        if len(found) <= 5:
            nearer = dataclasses.replace(scene.lamp, behind_m=0.05 + 0.1 * float(sea.aims[4]))
            truth = ForwardModel(dataclasses.replace(scene, lamp=nearer))
            # Of a power that is told at the reference, which is where base_link is, not the source.
            truth.power = model.power
            np.testing.assert_allclose(model.light(seen), truth.light(pose), rtol=1e-9)
            assert float(metres) == pytest.approx(0.1 * float(sea.aims[4]), abs=6e-4)
    assert np.std(found) == pytest.approx(0.1, rel=FIVE_SIGMA)
