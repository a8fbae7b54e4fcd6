"""What can be wrong with a picture: labels on one another, odd ticks, colours, kinds of file."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from measured import ALL_METHODS, row

from uuv_optical_array.commands import render
from uuv_optical_array.control.follow_record import FollowRecord
from uuv_optical_array.control.follow_states import COLOURS
from uuv_optical_array.control.following import State
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.plots import follow, style
from uuv_optical_array.studies import tradeoff
from uuv_optical_array.studies.approach import METHODS

DOCS = Path(__file__).parents[2] / "docs"


def test_every_method_has_one_colour_of_its_own():
    colours = style.METHOD_COLOURS
    assert set(colours) >= {*ALL_METHODS, *METHODS}
    assert len(set(colours.values())) == len(colours)
    # In grey its mark tells a method of the trade-off.
    assert set(style.METHOD_MARKS) == set(ALL_METHODS)
    assert len(set(style.METHOD_MARKS.values())) == len(ALL_METHODS)
    rows = [row(method, ms=1 + i, position=0.1 + i) for i, method in enumerate(ALL_METHODS)]
    figure = tradeoff.draw(rows, "about")
    points = {
        float(dots.get_offsets()[0, 0]): to_hex(dots.get_facecolor()[0])
        for dots in figure.axes[0].collections
        if len(dots.get_offsets()) == 1
    }
    assert points == {row.median_ms: colours[row.method] for row in rows}


def run_of(x_m=-6.0):
    """Return a run that hardly moves, so that much rounds to zero from below."""
    record = FollowRecord((x_m, 0.0, 0.0))
    for t in range(20):
        record.leader_path[t] = np.array([0.5 * t, -1e-4 * t, 0.0])
        record.follower_path[t] = record.leader_path[t] + [x_m, 0.0, 0.0]
        record.truth[t] = np.array([x_m, -1e-4, -2e-3, -1e-3, -3e-3])
        record.estimates[t] = record.truth[t] * 1.001
        record.images[t] = 10.0 * np.arange(25).reshape(5, 5)
    return record


def test_a_run_has_no_negative_zero_and_says_what_is_drawn():
    figure = follow.draw_follow([run_of()])
    figure.set_layout_engine("none")  # which takes most of the time, and writes no text
    figure.draw_without_rendering()
    texts = [t.get_text() for t in figure.findobj(lambda artist: hasattr(artist, "get_text"))]
    for text in texts:
        assert not re.search(r"[-\N{MINUS SIGN}]0(\.0*)?(?![\d.])", text), text
    assert "reading (counts)" in texts
    assert "positions when the images are taken" in texts
    panels = [axes for part in figure.subfigs for axes in part.axes]
    for axes in panels:
        if axes.get_visible() and axes.get_xlabel() == "time (s)":
            assert re.search(r"\((m|deg)\)$", axes.get_ylabel())
    images = [a for a in panels if a.get_xlabel() == "column, to starboard" and a.get_visible()]
    scales = {image.collections[0].get_clim() for image in images}
    assert scales == {(0.0, 240.0)}  # one colour bar is that of all


def test_a_picture_of_a_run_shows_what_the_follower_did_over_time_in_bands_by_follower():
    first, second = run_of(), run_of()
    first.states[:] = [State("locked", -1.0, ""), State("coasting", 4.0, "")]
    second.states[:] = [State("searching", 7.0, "")]
    figure = follow.draw_follow([first, second])
    (errors,) = (part for part in figure.subfigs if len(part.axes) == 5)
    for axes in errors.axes:
        below = axes.get_xaxis_transform()  # x in seconds, y from 0 to 1
        bands = [patch for patch in axes.patches if patch.get_label() in COLOURS]
        assert [patch.get_label() for patch in bands] == ["locked", "coasting", "searching"]
        corners = [
            below.inverted().transform(patch.get_window_extent().get_points()) for patch in bands
        ]
        np.testing.assert_allclose(
            [c[:, 0] for c in corners], [[0, 4], [4, 19], [7, 19]], atol=1e-9
        )
        np.testing.assert_allclose([c[0, 1] for c in corners], [0, 0, follow.BAND], atol=1e-9)
    (legend,) = errors.legends
    assert {"locked", "coasting", "searching"} < {text.get_text() for text in legend.get_texts()}


def test_rows_of_images_use_the_whole_scale_and_ticks_are_detectors(monkeypatch):
    monkeypatch.setattr(render, "RANGES_M", (4.0, 8.0))  # of five, each is drawn alike
    own = load_scene("sunlit_shallow")
    images = ForwardModel(own).expose(render.sheet_poses(), np.random.default_rng(0))
    figure = render.draw_scene(own, images)
    panels = figure.subfigs[0].axes
    sheet = [axes for axes in panels if axes.get_aspect() == 1.0]
    assert len(sheet) == images.shape[0] * images.shape[1]
    for axes, image in zip(sheet, images.reshape(-1, *images.shape[2:]), strict=True):
        np.testing.assert_array_equal(axes.collections[0].get_array(), image)
    for first, row_of_images in zip(sheet[::7], images, strict=True):
        low, high = first.collections[0].get_clim()
        assert (low, high) == (row_of_images.min(), row_of_images.max())
        assert first.get_ylim()[0] > first.get_ylim()[1], "rows go down"
    assert sum("counts" in axes.get_ylabel() for axes in panels) == len(images)
    whole = [axes.xaxis for axes in sheet]
    whole += [a.xaxis for a in figure.subfigs[1].axes if a.get_xlabel() in ("column", "row")]
    for axis in whole:
        ticks = axis.get_majorticklocs()
        np.testing.assert_array_equal(ticks, np.round(ticks))


@given(st.floats(-1e6, 1e6), st.integers(0, 4))
def test_a_signed_number_is_the_rounded_one_and_zero_has_no_sign(value, digits):
    text = style.signed(value, digits)
    assert float(text) == round(value, digits)
    assert (text[0] in "+-") == (float(text) != 0)


@pytest.mark.parametrize(
    ("name", "start"), [("a.svg", b"<?xml"), ("a.PDF", b"%PDF"), ("a.png", b"\x89PNG")]
)
def test_the_kind_of_a_file_follows_its_name_and_is_the_same_each_time(tmp_path, name, start):
    figure = Figure()
    image = np.arange(9.0).reshape(3, 3)
    style.array_image(figure.subplots(), image)
    style.save(figure, tmp_path / name)
    data = (tmp_path / name).read_bytes()
    assert data.startswith(start)
    assert b"<image" not in data  # vectors alone
    assert b"/Subtype /Image" not in data
    assert not re.search(rb"<dc:date>|/CreationDate", data)


def test_another_kind_of_file_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match=r"a.jpg: not a kind of picture; .*\.png, \.svg, \.pdf"):
        style.save(Figure(), tmp_path / "a.jpg")
    assert not list(tmp_path.iterdir())


def test_pictures_of_the_documents_are_small():
    assert {path.name for path in DOCS.glob("**/*.png") if path.stat().st_size > 300_000} == set()
