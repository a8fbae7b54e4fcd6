"""The scripts of ``examples/`` run as they stand, and find what they made."""

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
    _, *lines = capsys.readouterr().out.splitlines()
    assert len(lines) == scene.detectors_per_side**2
    for i, line in enumerate(lines):
        number, row, column, *rest = line.split()
        assert (int(number), int(row), int(column)) == (i, *divmod(i, 5))
        *place, yaw, pitch, tilt = map(float, rest[:6])
        yaw, pitch = np.radians([yaw, pitch])
        ray = [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)]
        # Figures are printed to 0.1 mm and 0.1 deg, which is 0.6 mm on the sphere.
        np.testing.assert_allclose(place, 1e3 * scene.radius_m * np.array(ray), atol=0.6)
        assert np.cos(np.radians(tilt)) == pytest.approx(ray[0], abs=2e-3)
        assert rest[-2:] == [f"U{1 + i // 8}", f"AIN{i % 8}"]
    # The first is above and to port.
    assert min(float(word) for word in lines[0].split()[4:6]) > 0
    assert len({tuple(line.split()[-2:]) for line in lines}) == 25, "one input each"


def test_they_are_short():
    for name in ("detectors", "images", "pose", "track"):
        assert len((EXAMPLES / f"{name}.py").read_text().splitlines()) <= 30
