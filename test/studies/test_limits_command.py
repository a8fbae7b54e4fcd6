"""``uuv_array limits``: what it prints and draws."""

import dataclasses
import functools
import re

import command_line
import matplotlib.image
import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from scenes import SHAPES, make_scene, std_m_deg

from uuv_optical_array.commands.studies import limits as command
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.effects import check_effects
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.plots.studies import bound_map as picture
from uuv_optical_array.studies.limits.bound_map import bound_map

pytestmark = pytest.mark.filterwarnings("error")


def coarse_map(scene):
    return bound_map(scene, np.linspace(4, 8, 5), np.linspace(-1, 1, 7))


@pytest.fixture
def coarse(monkeypatch):
    """A picture of few poses, which takes less time."""
    monkeypatch.setattr(command, "bound_map", coarse_map)


@pytest.fixture
def undrawn(monkeypatch):
    """No picture, where only the text is asked for."""
    monkeypatch.setattr(command, "bound_map", lambda scene: None)
    monkeypatch.setattr(picture, "draw_bound_map", lambda *words: None)


run = functools.partial(command_line.run, "limits")


def told(capsys, *words):
    """Run the command and return what it prints."""
    run(*words)
    return "".join(capsys.readouterr())


def printed(out):
    """The printed standard deviations by degree of freedom."""
    return {
        name: (float(value), unit, verdict)
        for name, value, unit, verdict in re.findall(
            r"^  (\w+) +(\S+) (m|deg) +(within|beyond) ", out, re.MULTILINE
        )
    }


@pytest.mark.usefixtures("coarse")
def test_the_command_prints_the_bound_of_one_pose_and_writes_a_picture(tmp_path, capsys):
    output = tmp_path / "limits.png"
    words = ("--x", -7, "--y", 0.5, "--z", -0.2, "--pitch-deg", 3, "--yaw-deg", -10)
    out = told(capsys, *words, "--shape", "planar", "--output", output)
    model = ForwardModel(load_scene("follow").with_shape("planar"))
    pose = [-7, 0.5, -0.2, *np.radians([3, -10])]
    bound = cramer_rao_bound(model, pose)
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
    assert condition == pytest.approx(bound.condition, rel=0.05)
    image = matplotlib.image.imread(output)
    assert image.shape[0] > 500
    assert image.shape[1] > 800
    assert image[..., :3].std() > 0.1
    assert [file.name for file in tmp_path.iterdir()] == ["limits.png"]


@pytest.mark.usefixtures("undrawn")
def test_the_command_says_what_is_not_observable(capsys):
    out = told(capsys, "--x", 5)
    assert "observable: nothing" in out
    assert out.count("unobservable") == 5
    assert printed(out) == {}


@pytest.mark.usefixtures("undrawn")
def test_the_command_says_what_is_estimated_along(tmp_path, capsys):
    scene = tmp_path / "sea.yaml"
    scene.write_text("extends: reference\nprior: {lamp_power_std: 0.1}\n", encoding="utf-8")
    known = printed(told(capsys, "--scene", "reference"))
    out = told(capsys, "--scene", scene)
    assert "estimated along with the pose: lamp.power +-0.1" in out
    assert printed(out)["x"][0] > 2 * known["x"][0]


def test_the_volume_is_that_of_the_paper_seen_from_above():
    # Detectors of different gain, so that port and starboard differ.
    effects = load_scene("follow").effects | {"responsivity": {"spread": 0.3, "seed": 1}}
    scene = dataclasses.replace(make_scene("planar"), effects=check_effects(effects))
    found = bound_map(scene)
    assert (found.behind_m[0], found.behind_m[-1]) == (4, 8)
    assert set(found.std) == set(SHAPES)
    pose = [-found.behind_m[3], found.aside_m[70], 0, 0, 0]
    for shape, std in found.std.items():
        assert std.shape == (len(found.behind_m), len(found.aside_m), 5)
        model = ForwardModel(scene.with_shape(shape))
        np.testing.assert_allclose(std[3, 70], std_m_deg(model, pose), rtol=1e-6)


@pytest.mark.parametrize(("shape", "beam_sigma_deg"), [("planar", 8.0), ("curved", 0.5)])
def test_a_picture_is_drawn_even_where_little_is_observable(
    tmp_path, shape, beam_sigma_deg, monkeypatch
):
    figures = []
    # It has been laid out by then, for the labels.
    monkeypatch.setattr(picture, "save", lambda figure, path: figures.append(figure))
    scene = make_scene(shape, 3, beam_sigma_deg=beam_sigma_deg)
    picture.draw_bound_map(coarse_map(scene), "x", tmp_path / "x.png")
    maps = [axes for axes in figures[0].axes if axes.get_ylabel().startswith("y, port")]
    meshes = [axes.findobj(QuadMesh)[0].get_array() for axes in maps]
    assert len(meshes) == 6
    assert all(mesh.shape == (7, 5) for mesh in meshes)


def test_another_shape_keeps_the_rest_of_the_scene():
    for shape in SHAPES:
        scene = make_scene(shape)
        assert scene.with_shape(shape) == scene
    planar, curved = make_scene("planar"), make_scene("curved")  # whose radius is the paper's
    assert planar.with_shape("curved").array == curved.array
    assert curved.with_shape("planar") == planar


@pytest.mark.usefixtures("coarse")
def test_a_picture_that_cannot_be_written_leaves_the_old_one(tmp_path, capsys, monkeypatch):
    output = tmp_path / "limits.png"
    output.write_bytes(b"old")

    def break_off(figure, path, **settings):
        path.write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(picture, "drop_overlapping", lambda *labels: None)  # a layout
    monkeypatch.setattr(Figure, "savefig", break_off)
    assert "disk full" in run("--output", output, code=1)
    assert output.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["limits.png"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--x", "-2000"], "--x: -2000.0 is out of bounds; it must be from -1000 to 1000 m"),
        (["--pitch-deg", "95"], "--pitch-deg: 95.0 is out of bounds"),
        (["--y", "nan"], "--y: nan is out of bounds"),
        (["--scene", "lagoon"], "lagoon"),
    ],
)
def test_a_wrong_word_ends_in_one_line(capsys, words, said):
    line = run(*words, "--output", "never.png", code=2)
    assert line.startswith("uuv_array limits: ")
    assert said in line


def test_the_help_teaches_by_examples(capsys):
    text = told(capsys, "--help")
    for word in ("Cramer-Rao", "examples:", "uuv_array limits --shape planar", "condition number"):
        assert word in text
    for option in ("--scene", "--x", "--y", "--z", "--pitch-deg", "--yaw-deg", "--output"):
        assert option in text
