"""Detectors in any layout: their table, and their light beside that of a scene's own array."""

import dataclasses

import numpy as np
import pytest
from scenes import changed, ready

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.layouts.detectors import (
    Detectors,
    layout_of,
    of_scene,
    on_array_of,
    read_detectors,
    write_detectors,
)

HEAD = "name,x_m,y_m,z_m,normal_x,normal_y,normal_z"
POSES = np.random.default_rng(2).uniform(
    [-8, -0.7, -0.7, -0.3, -0.3], [-3, 0.7, 0.7, 0.3, 0.3], (50, 5)
)


@pytest.mark.parametrize("name", ["follow", "leading_lights", "eren2017_tank"])
def test_the_array_of_a_scene_reads_the_same_as_a_layout(name):
    scene = ready(name)
    layout = layout_of(scene, of_scene(scene))
    expected = ForwardModel(scene).light(POSES)
    np.testing.assert_allclose(layout.model().light(POSES), expected, rtol=1e-7, atol=1e-9)


def test_five_detectors_read_by_the_inverse_square():
    """A lamp without water: power / r^2, the beam, the cosine and the gain, worked out here."""
    scene = ready("ideal")
    rng = np.random.default_rng(1)
    positions, normals = rng.uniform(-0.3, 0.3, (5, 3)), rng.normal([2, 0, 0], 0.5, (5, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    gains = np.array([1.0, 0.9, 1.1, 1.2, 0.8])
    layout = layout_of(scene, Detectors(tuple("abcde"), positions, normals, gains))
    pose = np.array([-3.0, 0.2, -0.1, 0.0, 0.0])  # level, so that the body's axes are the beacon's
    to = -(pose[:3] + positions)
    r = np.linalg.norm(to, axis=1)
    off = np.arccos(-(pose[0] + positions[:, 0]) / r)
    beam = np.exp(-0.5 * (off / np.radians(8.0)) ** 2)
    cosine = np.maximum((to * normals).sum(axis=1) / r, 0)
    expected = ForwardModel(scene).power / r**2 * beam * cosine * gains
    read = layout.readings(layout.model().light(pose)[None])
    np.testing.assert_allclose(read[0, 0], expected, rtol=1e-9)


def test_a_fitted_light_returns_to_the_array_of_its_scene():
    scene = ready("coastal")
    one = Detectors(("a",), np.zeros((1, 3)), np.array([[1.0, 0, 0]]), np.ones(1))
    back = on_array_of(scene, layout_of(scene, one).scene)
    assert back.array == scene.array
    assert back.lamp.reference_counts == pytest.approx(scene.lamp.reference_counts, rel=1e-8)
    assert back.effects["sea"] == scene.effects["sea"]


def test_what_is_of_the_array_alone_does_not_come_from_the_detectors():
    scene = changed("follow", prior={"gain_std": 0.004, "radius_std": 0.03})
    one = Detectors(("a",), np.zeros((1, 3)), np.array([[1.0, 0, 0]]), np.ones(1))
    fitted = layout_of(scene, one).scene
    prior = dataclasses.replace(fitted.prior, gain_std=0.02, lamp_power_std=0.07)
    back = on_array_of(scene, dataclasses.replace(fitted, prior=prior)).prior
    assert (back.gain_std, back.radius_std, back.lamp_power_std) == (0.004, 0.03, 0.07)


def test_a_table_of_detectors_is_read_as_it_was_written(tmp_path):
    own = of_scene(ready("follow"))
    write_detectors(tmp_path / "d.csv", own, "a sphere")
    read = read_detectors(tmp_path / "d.csv")
    assert read.names == own.names
    np.testing.assert_allclose(read.positions, own.positions, atol=1e-8)
    np.testing.assert_allclose(read.normals, own.normals, atol=1e-8)
    np.testing.assert_array_equal(read.gains, 1.0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("name,x_m\na,1", "no column y_m, z_m, normal_x, normal_y, normal_z; a table of"),
        (HEAD, "no detector below the columns; give one at least"),
        (f"{HEAD}\na,0,0,0,0,0,0", "line 2: the normal is 0; give the direction of view"),
        (f"{HEAD}\na,0,0,0,1,0,0\na,0,0,0,1,0,0", "line 3: a is named twice; give each"),
        (f"{HEAD}\na,0,300,0,1,0,0", "more than 100 m off base_link; positions are in m"),
        (f"{HEAD}\na,0,x,0,1,0,0", "line 2: y_m: 'x' is not a number"),
        (f"{HEAD},gain\na,0,0,0,1,0,0,0", "line 2: gain 0; it must be more than 0"),
    ],
)
def test_a_bad_table_of_detectors_is_refused(tmp_path, text, told):
    path = tmp_path / "d.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=told.replace("(", r"\(")):
        read_detectors(path)


def test_light_of_a_grid_alone_is_refused():
    scene = changed(ready("reference"), effects={"forward_scatter": {"window_m": 0.1}})
    with pytest.raises(ValueError, match=r"effects\.forward_scatter needs a square grid"):
        layout_of(scene, of_scene(scene))
