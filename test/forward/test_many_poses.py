"""Light at very many poses, which is worked out in blocks, against that of each pose alone."""

import subprocess
import sys

import numpy as np
import pytest
import second_forward
from drawn_effects import SHAPES, scene_with
from effect_settings import middle_settings

from uuv_optical_array.estimation.table.signature_table import build_table
from uuv_optical_array.forward import model as model_module
from uuv_optical_array.forward.effects import EFFECTS
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

pytestmark = pytest.mark.filterwarnings("error")

WATER = {
    "attenuation": {"k_per_m": 0.15},
    "ambient": {"level_counts": 7.0},
    "forward_scatter": {"window_m": 0.3},
    "responsivity": {"spread": 0.1, "seed": 1},
}


def table_poses(count, seed=1):
    low, high = [-8, -1, -1, -0.4, -0.4], [-4, 1, 1, 0.4, 0.4]
    return np.random.default_rng(seed).uniform(low, high, (count, 5))


def test_a_million_readings_are_those_of_the_second_forward_model():
    model = ForwardModel(load_scene("reference"))
    poses = table_poses(40_000)
    light = model.light(poses)
    plain = model.scene.settings()
    power = second_forward.power_of(plain)
    for i in range(0, 40_000, 400):
        expected = second_forward.light(plain, poses[i], power=power)
        np.testing.assert_allclose(light[i], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("readings", [1, 9, 64, 1000])
def test_the_size_of_a_block_changes_nothing(monkeypatch, shape, name, readings):
    model = ForwardModel(scene_with({name: middle_settings(name)}, shape, 5))
    rng = np.random.default_rng(2)
    poses, rolls = table_poses(14).reshape(2, 7, 5), rng.uniform(-1, 1, (2, 7))
    offsets = {key: rng.uniform(-0.1, 0.1, (2, 7)) for key in model.nuisances}
    moments = rng.uniform(0, 100, (2, 7))

    def everything():
        light = model.light(poses, rolls, offsets, moments)
        return light, *model.linearised(poses, rolls, offsets)

    whole = everything()
    monkeypatch.setattr(model_module, "BLOCK_READINGS", readings)
    for found, expected in zip(everything(), whole, strict=True):
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13 * scale)


@pytest.mark.parametrize("names", [[], ["ambient"], ["forward_scatter"], list(WATER)], ids=str)
def test_a_stack_of_poses_with_effects_is_each_of_its_rows(names):
    model = ForwardModel(scene_with({name: WATER[name] for name in names}))
    poses, rolls = table_poses(5000).reshape(50, 100, 5), np.linspace(-1, 1, 100)
    light = model.light(poses, rolls)
    assert light.shape == (50, 100, 5, 5)
    for some, expected in zip(poses[::7], light[::7], strict=True):
        alone = np.stack([model.light(pose, roll) for pose, roll in zip(some, rolls, strict=True)])
        np.testing.assert_allclose(alone, expected, rtol=1e-12, atol=1e-11)


def test_a_table_has_the_peaks_of_each_pose_alone():
    values = load_scene("reference").settings()
    values["table"] = {**values["table"], "x_m": [-8, -4, 3], "z_m": [-0.5, 0.5, 2]}
    scene = scene_from_settings(values, "test")
    table, model = build_table(scene), ForwardModel(scene)
    peaks = [model.expected(pose).max() for pose in table.poses[::500]]
    np.testing.assert_allclose(table.parameters[::500, 0] * 1023, peaks, rtol=1e-12)


def test_no_pose_at_all_has_no_light():
    model = ForwardModel(load_scene("reference"))
    assert model.light(np.empty((3, 0, 5))).shape == (3, 0, 5, 5)
    image, jacobian = model.linearised(np.empty((0, 5)))
    assert (image.shape, jacobian.shape) == ((0, 25), (0, 25, 5))


def test_simulation_and_tables_never_load_numba():
    code = (
        "import sys, numpy as np; from uuv_optical_array.forward.model import ForwardModel;"
        "from uuv_optical_array.forward.scene import load_scene;"
        "from uuv_optical_array.estimation.table.signature_table import build_table;"
        "model = ForwardModel(load_scene('reference'));"
        "model.light(np.tile([-6.0, 0, 0, 0, 0], (10_000, 1)));"
        "print('numba' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
