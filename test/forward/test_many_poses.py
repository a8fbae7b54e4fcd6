"""Light at very many poses, which is worked out in blocks, against that of each pose alone."""

import numpy as np
import pytest
from effect_settings import middle_settings
from needs import numba
from scenes import changed, make_scene

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.forward.effects import EFFECTS
from uuv_optical_array.forward.many_poses import expected_readings, prepare
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

pytestmark = pytest.mark.filterwarnings("error")


@pytest.mark.parametrize("name", EFFECTS)
def test_a_stack_of_several_blocks_is_each_of_its_rows(name):
    model = ForwardModel(make_scene(effects={name: middle_settings(name)}))
    rng = np.random.default_rng(2)
    poses = rng.uniform([-8, -1, -1, -0.4, -0.4], [-4, 1, 1, 0.4, 0.4], (2, 2100, 5))
    rolls = rng.uniform(-1, 1, (2, 2100))
    offsets = {key: rng.uniform(-0.1, 0.1, (2, 2100)) for key in model.nuisances}
    times = rng.uniform(0, 100, (2, 2100))
    light = model.light(poses, rolls, offsets, times)
    image, jacobian = model.linearised(poses, rolls, offsets)
    for place in [(0, 0), (0, 2047), (0, 2048), (1, 7), (1, 2099)]:
        own = {key: values[place] for key, values in offsets.items()}
        expected = model.linearised(poses[place], rolls[place], own)
        found = light[place], image[place], jacobian[place]
        alone = model.light(poses[place], rolls[place], own, times[place])
        for some, other in zip(found, (alone, *expected), strict=True):
            scale = np.abs(other).max()
            np.testing.assert_allclose(some, other, rtol=1e-12, atol=1e-13 * scale)


def test_no_pose_at_all_has_no_light():
    model = ForwardModel(load_scene("reference"))
    assert model.light(np.empty((3, 0, 5))).shape == (3, 0, 5, 5)
    image, jacobian = model.linearised(np.empty((0, 5)))
    assert (image.shape, jacobian.shape) == ((0, 25), (0, 25, 5))


@pytest.fixture(params=["as it stands", pytest.param("compiled", marks=numba)])
def way(request, monkeypatch):
    """Whether what is written for many poses runs as it stands or as Numba compiles it."""
    if request.param == "compiled":
        prepare(ForwardModel(load_scene("reference")))
    else:
        monkeypatch.setattr(compilation, "loaded", lambda function: function)


def assert_readings(model):
    # Ahead of the lamp, too, where the beam has its tail, and near it.
    rng = np.random.default_rng(4)
    poses = rng.uniform([-8, -2, -2, -0.4, -0.4], [2, 2, 2, 0.4, 0.4], (300, 5))
    expected = model.expected(poses)
    found = expected_readings(model, model.optics(), poses).T.reshape(expected.shape)
    assert (expected.max(axis=(1, 2)) > 1).sum() > 30
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13 * expected.max())


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.usefixtures("way")
def test_the_readings_at_many_poses_are_the_images_of_the_model_with_every_effect(name):
    assert_readings(ForwardModel(make_scene(effects={name: middle_settings(name)})))


@pytest.mark.parametrize("name", ["leading_lights", "eren2016", "sunlit_modulated", "harbour"])
@pytest.mark.usefixtures("way")
def test_the_readings_at_many_poses_are_the_images_of_the_model_in_ready_scenes(name):
    assert_readings(ForwardModel(load_scene(name)))


@pytest.mark.parametrize("name", ["reference", "harbour"])
@pytest.mark.usefixtures("way")
def test_the_readings_at_many_poses_are_the_images_of_the_model_of_a_beam_of_three(name):
    beam = {"beam_widths": [0.6, 1.0, 1.8], "beam_weights": [-0.2, 0.8, 0.4]}
    assert_readings(ForwardModel(changed(name, lamp=beam)))
