"""Pareto-optimal designs, and ``uuv_array study design``."""

import dataclasses
import functools
import itertools
import math
import random
import re

import command_line
import matplotlib.image
import numpy as np
import pytest
from command_line import json_of, text_of
from designs import CURVED, LISTS, PLANAR, SMALL
from hypothesis import example, given
from hypothesis import strategies as st
from matplotlib.text import Annotation

from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.designs import scores
from uuv_optical_array.studies.designs.choice import Choice, front, report
from uuv_optical_array.studies.designs.picture import draw
from uuv_optical_array.studies.designs.scores import (
    ScoredDesign,
    origin,
    scored,
    scored_before,
)
from uuv_optical_array.studies.designs.sweep import Design, designed, designs_of
from uuv_optical_array.studies.shared.results import write

FOLLOW = load_scene("follow")

COLUMNS = [field.name for field in dataclasses.fields(ScoredDesign)][8:]


def row_of(side, position_m, angle_deg, **changes):
    values = dict.fromkeys(COLUMNS, 1.0) | {"position_m": position_m, "angle_deg": angle_deg}
    design = dataclasses.replace(PLANAR, detectors_per_side=side, **changes)
    return ScoredDesign(**vars(design), **values)


@given(
    st.lists(st.tuples(st.integers(2, 6), st.floats(0.01, 10), st.floats(0.01, 10)), min_size=1),
    st.randoms(),
)
@example([(3, 10.0, 0.1), (3, 9.5, 0.12)], random.Random(1))
def test_the_front_stands_for_all_and_none_of_it_for_another(points, order):
    rows = [row_of(*point, width_m=0.1 + i / 100) for i, point in enumerate(points)]

    def stands_for(one, other):
        fewer = one.design.detectors_per_side <= other.design.detectors_per_side
        return fewer and max_ratio(one, other) <= 1.1 * (1 + 1e-12)

    found = front(rows)
    assert all(any(stands_for(one, row) for one in found) for row in rows)
    pairs = itertools.permutations(found, 2)
    assert not any(stands_for(one, row) and max_ratio(one, row) < 1.1 - 1e-9 for one, row in pairs)
    assert [r.design.detectors for r in found] == sorted(r.design.detectors for r in found)
    order.shuffle(rows)
    bounds = {(row.position_m, row.angle_deg) for row in found}
    assert {(row.position_m, row.angle_deg) for row in front(rows)} == bounds


def max_ratio(one, other):
    return max(one.position_m / other.position_m, one.angle_deg / other.angle_deg)


def test_fronts_are_of_what_fits_and_of_what_the_criterion_lets_pass():
    wide = row_of(3, 0.01, 0.1, width_m=0.5)
    fits = row_of(3, 0.1, 1.0, width_m=0.4)
    passing = {"position_m": 0.2, "shift_near_deg": 15.0, "yaw_near_deg": 15.0}
    resolved = dataclasses.replace(fits, width_m=0.3, **passing)
    papers = {**vars(Design("curved", 5, 0.4, 0.32, 8.0, 1, 0.0, 0.0)), "yaw_near_deg": 14.9}
    paper = dataclasses.replace(resolved, **papers)
    choice = Choice(FOLLOW, [wide, fits, resolved, paper])
    assert choice.fronts == {"fits": [fits], "resolved": [resolved], "any": [wide]}
    assert resolved.resolved_at_4m
    assert not paper.resolved_at_4m
    assert choice.numbered == [fits, resolved, wide, paper]
    table = choice.table().splitlines()
    standing = ["fits", "resolved", "any", "none; the paper's array"]
    assert [re.split("  +", line)[2] for line in table[2:]] == standing
    assert table[3].startswith("2   planar 3 x 3, 0.3 m, beam 6 deg ")
    # With another lamp it is the paper's array still, but not listed for its own sake.
    other = dataclasses.replace(paper, beam_sigma_deg=6.0)
    assert other.is_papers_array
    assert other not in Choice(FOLLOW, [*choice.rows, other]).numbered


def test_designs_that_meet_the_criterion_are_counted_with_and_without_noise():
    row, values = row_of(3, 0.1, 1.0), {"shift_near_deg": 15.0, "yaw_near_deg": 15.0}
    near = dataclasses.replace(row, **values)
    far = dataclasses.replace(near, shift_deg=15.0, yaw_deg=15.0, shift_sigmas=3.0, yaw_sigmas=2.9)
    clear = dataclasses.replace(far, yaw_sigmas=3.0)
    rows = [row, near, far, clear]
    told = report(Choice(FOLLOW, rows))
    assert "3 of 4 designs tell" in told
    assert "2 from 4 to 8 m;\nof these, 1 by 3 or more" in told
    assert [row.resolved for row in rows] == ["none", "4 m", "4 to 8 m", "4 to 8 m"]


run = functools.partial(command_line.run, "study", "design")


POSES = 40
WORDS = ["--sweep", *LISTS, "--poses", POSES]


@pytest.fixture(scope="module")
def whole():
    """The scores of all designs, one by one."""
    return list(scored(FOLLOW, designs_of(SMALL)[0], POSES))


@pytest.fixture
def heard(monkeypatch, whole):
    """List the designs that are scored; at number `heard.stop` of them it is interrupted.

    Their scores are those of `whole`.
    """
    there = {row.design: row for row in whole}

    class Heard(list):
        stop, end = None, KeyboardInterrupt

    heard = Heard()

    def counted(scene, poses, rng):
        assert len(poses) == POSES
        if len(heard) == heard.stop:
            raise heard.end
        heard.append(Design.of(scene))
        return there[heard[-1]]

    monkeypatch.setattr(scores, "score", counted)
    return heard


def test_a_score_is_its_designs_own_whatever_else_is_scored(whole):
    some = [row.design for row in whole[3::7]]
    assert 0 < len(some) < len(whole)
    assert list(map(str, scored(FOLLOW, some, POSES))) == list(map(str, whole[3::7]))


@pytest.mark.parametrize(
    ("scene", "poses", "error"),
    [
        (FOLLOW, POSES + 1, "poses is 40 there and 41 here"),
        (load_scene("coastal"), POSES, "fingerprint is"),
    ],
)
def test_the_scores_of_another_study_are_refused_by_what_differs(
    whole, tmp_path, scene, poses, error
):
    path = tmp_path / "scores.csv"
    own = origin(FOLLOW, POSES)
    write(path, own, [row.columns() for row in whole])
    renamed = own | {"scene": "another name"}
    assert list(map(str, scored_before(path, renamed))) == list(map(str, whole))
    with pytest.raises(ValueError, match=f"another run: {error}.*name another"):
        scored_before(path, origin(scene, poses))


@pytest.mark.usefixtures("sketched")
def test_the_command_is_interrupted_goes_on_and_tells(tmp_path, monkeypatch, capsys, whole, heard):
    monkeypatch.chdir(tmp_path)
    heard.stop = 0
    run(*WORDS, code=130)
    assert "interrupted" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    heard.stop, heard.end = 4, MemoryError  # as a run that is killed
    with pytest.raises(MemoryError):
        run(*WORDS)
    heard.stop, heard.end = 6, KeyboardInterrupt
    out = text_of(run, *WORDS, code=130)
    assert "4 designs are there already" in out
    assert "interrupted: 6 of 20 designs; the same command resumes it" in out
    assert "of 6 designs tell" in out
    heard.stop = None
    out = text_of(run, *WORDS, "--take", 2)
    assert "left out: 4 designs whose corners lie beyond their sphere" in out
    assert "6 designs are there already" in out
    assert len(heard) == 20
    assert re.search(r"curved 5 x 5, 0.4 m, radius 0.32 m, beam 8 deg .*the paper's array", out)
    assert "of 20 designs tell" in out

    told = json_of(run, *WORDS)
    assert len(heard) == 20
    assert told["complete"] is True
    assert told["files"] == ["follow.design.csv", "follow.design.png"]
    assert [d["position_m"] for d in told["designs"]] == [r.position_m for r in whole]
    assert [d["resolved_at_4_m"] for d in told["designs"]] == [r.resolved_at_4m for r in whole]
    assert [whole[i].design for i in told["papers_array"]] == [
        Design("curved", 5, 0.4, 0.32, sigma_deg, 1, 0.0, 0.0) for sigma_deg in (6.0, 8.0)
    ]
    assert [whole[i] for i in told["numbered"]] == Choice(FOLLOW, whole).numbered
    table = np.genfromtxt("follow.design.csv", delimiter=",", names=True, dtype=None, encoding=None)
    assert len(table) == 20
    np.testing.assert_array_equal(table["angle_deg"], [r.angle_deg for r in whole])
    assert set(table["seed"]) == {1}
    assert matplotlib.image.imread("follow.design.png").shape[:2] == (630, 1440)
    # A part of what is there scores nothing, and loses nothing.
    told = json_of(run, "--sweep", "shape=curved", *LISTS, "--poses", POSES)
    assert (len(heard), len(told["designs"])) == (20, 12)
    assert len((tmp_path / "follow.design.csv").read_text().splitlines()) == 21
    taken = load_scene("follow.design.2.yaml")
    wanted = Choice(FOLLOW, whole).numbered[1].design
    assert taken.fingerprint == designed(FOLLOW, wanted).fingerprint


@pytest.mark.parametrize(
    "designs", [[PLANAR], [CURVED, Design("curved", 21, 0.3, 0.5, 30.0, 1, 0.0, 0.0)]]
)
def test_any_study_can_be_drawn(designs):
    values = dict.fromkeys(COLUMNS, math.nan) | {"position_m": 0.3, "angle_deg": 5.0}
    rows = [ScoredDesign(**vars(design), **values) for design in designs]
    figure = draw(Choice(FOLLOW, rows), "about")
    figure.draw_without_rendering()
    dots = [line.get_ydata() for line in figure.axes[0].lines[:2]]
    assert np.concatenate(dots).tolist() == [0.3] * len(designs)


def test_the_line_of_a_front_goes_through_the_best_of_each_number_of_detectors():
    near, turned = row_of(3, 0.1, 2.0), row_of(3, 0.2, 1.0, width_m=0.2)
    figure = draw(Choice(FOLLOW, [near, turned, row_of(5, 0.05, 0.5)]), "about")
    for axes, best in zip(figure.axes[:2], ([0.1, 0.05], [1.0, 0.5]), strict=True):
        lines = [line for line in axes.lines if line.get_label().startswith("front")]
        assert [list(line.get_ydata()) for line in lines] == [best, best]  # of `fits` and `any`


def test_each_design_that_fits_has_its_number_beside_it():
    rows = [row_of(3, 0.2, 2.0), row_of(5, 0.1, 1.0), row_of(5, 0.01, 0.1, width_m=0.6)]
    choice = Choice(FOLLOW, rows)
    assert choice.numbered == rows
    panels = draw(choice, "about").axes[:2]
    for axes, bounds in zip(panels, ({"1": 0.2, "2": 0.1}, {"1": 2.0, "2": 1.0}), strict=True):
        notes = [note for note in axes.texts if isinstance(note, Annotation)]
        assert {note.get_text(): note.xy[1] for note in notes} == bounds
