"""The scripts of ``examples/`` run as they stand, and find what they made."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from command_line import assert_picture

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def run(monkeypatch, scene_file, tmp_path):
    """Run a script on a scene whose table is small; return its names."""

    def script(name, *words):
        monkeypatch.setattr("sys.argv", [name, scene_file, *map(str, words)])
        return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")

    monkeypatch.chdir(tmp_path)
    return script


def test_images_get_darker_with_the_distance(run, capsys):
    images = run("images")["images"]
    assert images.shape == (5, 5, 5)
    assert (np.diff(images.max(axis=(1, 2))) < 0).all()
    assert capsys.readouterr().out.count("m behind the lamp") == 5


def test_a_pose_is_within_its_errors(run, compiled_fit, capsys):
    names = run("pose")
    assert (np.abs(names["estimate"].pose - names["truth"]) < 5 * names["std"]).all()
    assert len(capsys.readouterr().out.splitlines()) == 5


def test_a_track_is_nearer_to_the_truth_than_its_frames(run, compiled_fit, tmp_path):
    names = run("track", tmp_path / "y.png")
    off = [np.square(names[name] - names["truth"])[:, 1].mean() for name in ("frames", "track")]
    assert off[1] < off[0] < 0.1**2
    assert_picture(tmp_path / "y.png", 600, 400)


def test_detectors_look_along_the_radius_of_their_sphere(run, capsys):
    scene = run("detectors")["scene"].array
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == scene.detectors_per_side**2
    for line in lines:
        *place, yaw, pitch = (float(number) for number in re.findall(r"-?\d+\.\d+", line))
        yaw, pitch = np.radians([yaw, pitch])
        ray = [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)]
        np.testing.assert_allclose(place, scene.radius_m * np.array(ray), atol=1e-4)
    # The first is above and to port.
    assert min(float(word) for word in lines[0].split()[1:3]) > 0


def test_they_are_short():
    for name in ("detectors", "images", "pose", "track"):
        assert len((EXAMPLES / f"{name}.py").read_text().splitlines()) <= 30
