"""The errors that the README promises are those of drawn seas."""

import re

import numpy as np
import pytest
from pages import ROOT

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.aim import apparent
from uuv_optical_array.forward.drawn_sea import draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.studies.accuracy import exposed

FRAMES = 500


def promised(row):
    """Return range and distance across, m, and angle, deg, of a row of the README's table."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (line,) = re.findall(rf"^\| {row}.*\|$", text, re.MULTILINE)
    return [float(figure) for figure in re.findall(r"([\d.]+) (?:m|deg)\b", line.split("|")[3])]


@pytest.mark.parametrize(
    ("row", "name"), [("this package", "follow"), ("the same with", "leading_lights")]
)
@pytest.mark.usefixtures("compiled_fit")
def test_errors_in_drawn_seas_are_as_the_readme_says(row, name):
    scene = load_scene(name)
    model, rng = ForwardModel(scene), np.random.default_rng(12)
    poses = lit_poses(model, FRAMES, rng)
    images = exposed(model, poses, 12, True, False, rng)
    estimator = Estimator(scene).wait()
    errors = np.array([estimator.estimate(image).pose for image in images]) - poses
    squares = np.square(errors * [1, 1, 1, *np.degrees([1, 1])])
    # Of y and z alike, and of pitch and yaw.
    groups = squares[:, 0], squares[:, 1:3].mean(axis=1), squares[:, 3:].mean(axis=1)
    for said, square in zip(promised(row), groups, strict=True):
        found = np.sqrt(square.mean())
        std = square.std() / np.sqrt(FRAMES) / (2 * found)  # of the root
        assert found == pytest.approx(said, abs=5 * std + 0.005)


@pytest.mark.usefixtures("compiled_fit")
def test_the_first_command_shows_a_sea_in_which_the_range_errs_as_in_others():
    """A lucky seed would promise more than the table."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^make follow ARGS='--seed (\d+)'", readme, re.MULTILINE)
    scene = load_scene("follow")
    model, estimator = ForwardModel(scene), Estimator(scene).wait()
    station = np.tile([-4.5, 0.0, 0.0, 0.0, 0.0], (4, 1))

    def error(seed):
        sea = draw_sea(scene, np.random.default_rng((seed, 1)))  # as simulator_node does
        poses = apparent(scene, station, np.tile(sea.aims, (len(station), 1)))
        light = model.with_gains(model.light(poses, 0.0, sea.offsets), sea.gains)
        images = model.read(light, np.random.default_rng(seed))
        return np.mean([estimator.estimate(image).pose[0] for image in images]) - station[0, 0]

    errors = np.abs([error(seed) for seed in range(100)])
    assert 0.1 < np.sqrt(np.mean(errors**2)) < 0.2
    assert 0.4 < np.mean(errors < abs(error(int(shown)))) < 0.9
