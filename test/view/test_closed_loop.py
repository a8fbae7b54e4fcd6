"""The loop without ROS: conditions act as their laws say, and the follower keeps its station."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import changed, coarse

from uuv_optical_array.core.geometry import rotation_matrix
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.array import build_array
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.view.closed_loop import ViewedLoop


@pytest.fixture(scope="module")
def bare():
    """An estimator of light in water, without noise or converter, that takes no match."""
    nothing = dict.fromkeys(("sensor_noise", "saturation", "adc"))
    table = build_table(changed(coarse("reference"), effects=nothing))
    return Estimator(table, "sam", max_angle_rad=0.0)


def first(estimator, **changes):
    """Return the first sight under conditions that differ from the scene's."""
    loop = ViewedLoop(estimator, np.random.default_rng(1))
    loop.change(replace(loop.conditions, **changes))
    return loop.step(0.1)


def places_of(seen):
    """Return where the follower is over ground."""
    return np.array([sight.leader[0] + sight.leader[1] @ sight.true_pose[:3] for sight in seen])


def test_water_dims_each_ray_by_its_length(bare):
    clear, murky = first(bare), first(bare, k_per_m=0.3)
    np.testing.assert_allclose(
        clear.image, ForwardModel(bare.scene).light(clear.true_pose), rtol=1e-12
    )
    turn = rotation_matrix(*clear.true_pose[3:])
    places = clear.true_pose[:3] + build_array(bare.scene.array).positions @ turn.T
    passed = np.exp(-0.2 * np.linalg.norm(places, axis=1))
    np.testing.assert_allclose(murky.image.ravel(), clear.image.ravel() * passed, rtol=1e-12)


def test_light_is_proportional_to_the_power_of_the_lamp(bare):
    np.testing.assert_allclose(
        first(bare, lamp_power=[0.3]).image, 0.3 * first(bare).image, rtol=1e-12
    )


def test_clouds_of_twice_the_depth_dim_twice_in_the_logarithm(bare):
    clear, once, twice = (first(bare, plume_depth=depth).image for depth in (0.0, 0.4, 0.8))
    np.testing.assert_allclose(clear * twice, once**2, rtol=1e-12)
    assert (once < clear).any()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"k_per_m": -0.1}, "k_per_m: -0.1"),
        ({"lamp_power": [float("nan")]}, r"lamp_power\[0\]"),
        ({"lamp_power": [1.0, 1.0]}, "lamp_power: 2 values; give 1, one for each lamp"),
        ({"station_m": (1.0, 0.0, 0.0)}, "not behind the lamp"),
    ],
)
def test_conditions_out_of_bounds_change_nothing(bare, changes, named):
    loop = ViewedLoop(bare, np.random.default_rng(1))
    before = loop.conditions
    with pytest.raises(ValueError, match=named):
        loop.change(replace(before, **changes))
    assert loop.conditions == before
    np.testing.assert_array_equal(loop.step(0.1).image, first(bare).image)


@pytest.mark.usefixtures("compiled_fit")
def test_once_there_is_light_the_follower_reaches_its_station_in_any_sea(table):
    loop = ViewedLoop(Estimator(table), np.random.default_rng(1))
    station = (-5.0, 0.4, -0.2)
    sea = replace(loop.conditions, current_m_per_s=(0.0, 0.2, 0.0), station_m=station, k_per_m=0.1)
    loop.change(replace(sea, lamp_power=[0.0]))
    dark = [loop.step(0.2) for _ in range(3)]
    assert not any(sight.leader[0].any() for sight in dark)
    assert dark[-1].note.startswith("no light")
    np.testing.assert_array_equal(dark[-1].true_pose, dark[0].true_pose)  # no current, either
    loop.change(sea)
    seen = [loop.step(0.2) for _ in range(130)]
    off = np.array([sight.true_pose[:3] for sight in seen[-10:]]) - station
    assert np.linalg.norm(off, axis=1).max() < 0.4
    # Over ground: 0.5 m/s for 26 s, less the start.
    assert seen[-1].leader[0][0] > 10
    # The leader has set off, and what it does is known.
    assert len([1 for sight in seen[40:] if sight.pose is None or sight.note]) < 5
    # Without light it goes on as its leader did.
    loop.change(replace(sea, lamp_power=[0.0]))
    dark = [loop.step(0.2) for _ in range(25)]
    assert all(sight.pose is None and sight.note.startswith("no light") for sight in dark)
    assert np.linalg.norm(dark[-1].true_pose[:3] - station) < 1.0
    assert np.linalg.norm(np.diff(places_of(dark)[[0, -1]], axis=0)) > 2.0


def test_a_track_by_an_array_that_is_not_the_scenes_says_so():
    scene = load_scene("follow")
    loop = ViewedLoop(Estimator(scene).wait(), np.random.default_rng(1))
    # The scene's detectors have the power 1.
    model = ForwardModel(changed(scene, effects={"field_of_view": {"cosine_power": 2.0}}))
    loop.light = loop.light._replace(model=model)

    def said():
        posed = loop.step(0.1).pose is not None
        return loop.follower.pipeline.track().mismatch if posed else ""

    assert any("evenness of the light" in said() for _ in range(60))
