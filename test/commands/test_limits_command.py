"""``uuv_array limits``: what it prints and draws."""

import functools
import re

import command_line
import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from scenes import SHAPES, WATER, make_scene, std_m_deg

from uuv_optical_array.commands import limits
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

pytestmark = pytest.mark.filterwarnings("error")
run = functools.partial(command_line.run, "limits")


def printed(text):
    """The printed standard deviations by degree of freedom."""
    return {
        name: (float(value), unit, verdict)
        for name, value, unit, verdict in re.findall(
            r"^  (\w+) +(\S+) (m|deg) +(within|beyond) ", text, re.MULTILINE
        )
    }


@pytest.mark.usefixtures("sketched")
def test_the_command_prints_the_bound_of_one_pose_and_writes_a_picture(tmp_path, capsys):
    output = tmp_path / "limits.png"
    words = ("--pose", -7, 0.5, -0.2, 3, -10)
    run(*words, "--shape", "planar", "--output", output)
    out = "".join(capsys.readouterr())
    model = ForwardModel(load_scene("follow").with_shape("planar"))
    pose = [-7, 0.5, -0.2, *np.radians([3, -10])]
    found = printed(out)
    assert list(found) == ["x", "y", "z", "pitch", "yaw"]
    for (value, unit, verdict), std, wanted in zip(
        found.values(), std_m_deg(model, pose), [0.2, 0.2, 0.2, 10, 10], strict=True
    ):
        assert value == pytest.approx(std, rel=0.01)
        assert unit == ("m" if wanted == 0.2 else "deg")
        assert verdict == ("within" if std <= wanted else "beyond")
    assert "planar 5 x 5" in out
    assert "x -7, y 0.5, z -0.2 m; pitch 3, yaw -10 deg" in out
    assert "observable: x, y, z, pitch, yaw" in out
    condition = float(re.search(r"condition number.*: (\S+)", out)[1])
    assert condition == pytest.approx(cramer_rao_bound(model, pose).condition, rel=0.05)
    command_line.assert_picture(output)
    assert [file.name for file in tmp_path.iterdir()] == ["limits.png"]


def test_the_report_says_what_is_not_observable():
    text = limits.report(ForwardModel(load_scene("follow")), np.array([5.0, 0, 0, 0, 0]))
    assert "observable: nothing" in text
    assert text.count("unobservable") == 5
    assert printed(text) == {}


def test_the_report_says_what_is_estimated_along_with_the_pose():
    pose = np.array([-6.0, 0, 0, 0, 0])
    known, unsure = (
        limits.report(ForwardModel(make_scene("curved", prior=prior)), pose)
        for prior in (None, {"lamp_power_std": 0.1})
    )
    assert "estimated along with the pose: lamp.power +-0.1" in unsure
    assert printed(unsure)["x"][0] > 2 * printed(known)["x"][0]

    lights = limits.report(ForwardModel(load_scene("leading_lights")), pose)
    assert lights.count(".power +-") == 2  # of all lamps, and of each
    assert "lamps.*.pitch_deg +-0.2" in lights


def test_the_volume_is_that_of_the_paper_seen_from_above():
    # Detectors of different gain, so that port and starboard differ.
    scene = make_scene("planar", effects={**WATER, "responsivity": {"spread": 0.3, "seed": 1}})
    behind_m, aside_m = limits.BEHIND_M[::40], limits.ASIDE_M[30::40]
    assert behind_m.tolist() == [4, 6, 8]
    assert aside_m == pytest.approx([-0.25, 0.75])
    found = limits.bound_map(scene, behind_m, aside_m)
    assert set(found) == set(SHAPES)
    for shape, std in found.items():
        assert std.shape == (3, 2, 5)
        model = ForwardModel(scene.with_shape(shape))
        np.testing.assert_allclose(std[1, 1], std_m_deg(model, [-6, 0.75, 0, 0, 0]), rtol=1e-6)


@pytest.mark.parametrize(("shape", "beam_sigma_deg"), [("planar", 8.0), ("curved", 0.5)])
def test_a_picture_is_drawn_even_where_little_is_observable(shape, beam_sigma_deg):
    scene = make_scene(shape, 3, beam_sigma_deg=beam_sigma_deg)
    places = np.linspace(4, 8, 5), np.linspace(-1, 1, 7)
    figure = limits.draw(limits.bound_map(scene, *places), "x", *places)
    maps = [axes for axes in figure.axes if axes.get_ylabel().startswith("y, port")]
    meshes = [axes.findobj(QuadMesh)[0].get_array() for axes in maps]
    assert len(meshes) == 6
    assert all(mesh.size == 7 * 5 for mesh in meshes)  # flat before Matplotlib 3.8


def test_a_pose_before_the_lamp_is_refused_with_the_sign_that_is_meant(tmp_path):
    words = ("limits", "--pose", 6, 0, 0, 0, 0, "--output", tmp_path / "x.png")
    assert "--pose X: 6 m is not behind the lamp; give X below 0" in command_line.run(
        *words, code=2
    )
    assert not list(tmp_path.iterdir())


def test_another_shape_keeps_the_rest_of_the_scene():
    planar, curved = make_scene("planar"), make_scene("curved")  # whose radius is the paper's
    assert planar.with_shape("planar") == curved.with_shape("planar") == planar
    assert planar.with_shape("curved").array == curved.array
