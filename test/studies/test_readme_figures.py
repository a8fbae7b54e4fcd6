"""The errors that the README promises are those of drawn seas."""

import re

import numpy as np
import pytest
from pages import ROOT

from uuv_optical_array.estimation.estimator import Estimator
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
