"""``uuv_array render``: the sheet of what a scene's array reads."""

import functools
import re

import command_line
import numpy as np
import pytest
from command_line import text_of
from matplotlib.image import imread

from uuv_optical_array.commands import render
from uuv_optical_array.commands.render import COLUMNS, draw_scene, sheet_poses
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

run = functools.partial(command_line.run, "render")


@pytest.fixture
def two_ranges(monkeypatch):
    """Draw the nearest and the farthest range, like which the three between them look."""
    monkeypatch.setattr(render, "RANGES_M", (4.0, 8.0))


def test_the_sheet_shows_each_motion_alone_at_each_range():
    sheet = sheet_poses()
    assert sheet.shape == (5, 7, 5)
    np.testing.assert_array_equal(sheet[..., 0], -np.repeat([[4, 5, 6, 7, 8]], 7, axis=0).T)
    assert np.count_nonzero(sheet[:, 0, 1:]) == 0
    for column, (title, name, value) in enumerate(COLUMNS[1:], 1):
        dof = ["y", "z", "pitch", "yaw"].index(name)
        assert np.count_nonzero(sheet[:, column, 1:]) == 5
        scale = 180 / np.pi if "deg" in title else 1
        np.testing.assert_allclose(sheet[:, column, 1 + dof] * scale, value)


@pytest.mark.usefixtures("two_ranges")
def test_render_draws_the_picture_and_says_what_the_scene_holds(tmp_path, monkeypatch):
    # Of the motions, none and a shift, and the profiles of the latter.
    monkeypatch.setattr(render, "COLUMNS", COLUMNS[:3])
    monkeypatch.setattr(render, "PROFILED", (2,))
    picture = tmp_path / "harbour.png"
    said = text_of(run, "--scene", "harbour", "--output", picture)
    named = "sea, responsivity, photodiode, saturation, adc"
    assert f"scene harbour: {named}\n" in said
    assert f"picture: {picture}" in said
    pixels = imread(picture)
    assert min(pixels.shape[:2]) > 800
    assert len(np.unique(pixels.reshape(-1, pixels.shape[-1])[::97], axis=0)) > 50
    assert [path.name for path in tmp_path.iterdir()] == ["harbour.png"]


@pytest.mark.usefixtures("sketched", "two_ranges")
def test_the_sheet_of_a_plume_is_that_of_its_time(tmp_path):
    words = ("--scene", "night_plume", "--time-s", 30, "--output", tmp_path / "sheet.png")
    printed = re.findall(r"to (\S+) counts", text_of(run, *words))
    model = ForwardModel(load_scene("night_plume"))
    before, then = (
        model.expose(sheet_poses(), np.random.default_rng(0), time_s=t)[:, 0].max(axis=(-1, -2))
        for t in (0.0, 30.0)
    )
    np.testing.assert_allclose(np.array(printed, float), then, atol=0.5)
    assert np.abs(then - before).max() > 50


@pytest.mark.usefixtures("two_ranges")
def test_images_of_several_lamps_are_drawn_below_one_another():
    scene = load_scene("leading_lights")
    model = ForwardModel(scene)
    figure = draw_scene(scene, model.expose(sheet_poses(), np.random.default_rng(0)))
    sheet, profiles = figure.subfigs
    assert len(sheet.axes[0].lines) == 2  # between three lamps
    curve = profiles.axes[0].lines[0].get_ydata()
    rows = together(model.light([-4.0, 0, 0, 0, 0]))
    np.testing.assert_allclose(curve, rows[2], atol=10)
