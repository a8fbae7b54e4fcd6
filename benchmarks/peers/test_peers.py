"""What the comparison counts: exact truth, hard cases, peers that are wrong or not there."""

import importlib.util
import json
import sys

import numpy as np
import pytest

from peers import __main__ as program
from peers import libraries, report
from peers.exact import hard_cases, is_nearest, nearest_exactly, verdict
from peers.libraries import BUILDERS, NEEDS, OURS, missing
from peers.search import BATCH, compare, figures, signatures
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.forward.scene import load_scene, scene_from_settings


@pytest.fixture(scope="module")
def rows():
    return signatures(load_scene("reference"), 600, np.random.default_rng(5))


@pytest.fixture
def only_ours(monkeypatch):
    """A computer with none of the peers that need more than NumPy and SciPy."""
    find_spec, absent = importlib.util.find_spec, {*NEEDS.values(), "numba"}
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name in absent else find_spec(name)
    )
    for module in absent:
        monkeypatch.setitem(sys.modules, module, None)


def run(*words, code=0):
    """Run the program and expect an exit code; return the line of an error."""
    with pytest.raises(SystemExit) as end:
        program.main([str(word) for word in words])
    if isinstance(end.value.code, str):  # which Python prints before it exits with 1
        assert code == 1, end.value.code
        assert "\n" not in end.value.code
        return end.value.code
    assert end.value.code == code
    return ""


def test_signatures_are_those_of_lit_poses_and_the_same_for_a_seed(rows):
    again = signatures(load_scene("reference"), 600, np.random.default_rng(5))
    np.testing.assert_array_equal(rows, again)
    weights = load_scene("reference").signature
    assert (rows[:, 5] == weights.lift).all()
    assert (rows[:, 0] * 1023 >= weights.peak_weight * (1 - 1e-12)).all()
    assert len(np.unique(rows, axis=0)) == 600


def test_poses_without_light_are_drawn_again():
    values = load_scene("reference").settings()
    values["lamp"]["beam_sigma_deg"] = 2.0
    scene = scene_from_settings(values, "narrow")
    vectors = signatures(scene, 300, np.random.default_rng(1))
    assert (vectors[:, 0] * 1023 >= scene.signature.peak_weight * (1 - 1e-12)).all()


def test_the_exact_truth_is_that_of_stable_angles_where_cosines_are_all_one():
    rng = np.random.default_rng(8)
    for query in rng.standard_normal((20, 6)):
        rows = query + 1e-9 * rng.standard_normal((50, 6))
        assert nearest_exactly(rows, query) == {int(spectral_angle(rows, query).argmin())}


def test_the_exact_truth_tells_apart_what_float64_cannot():
    tiny = 2.0**-60
    rows = np.array([[1, 2 * tiny], [1, tiny], [2, 2 * tiny], [-1, 0], [4, tiny * 12]])
    assert nearest_exactly(rows, np.array([3.0, tiny])) == {1, 2}
    assert nearest_exactly(rows, np.array([-3.0, tiny])) == {3}
    assert nearest_exactly(-rows[:2], np.array([3.0, -3 * tiny])) == {0}
    assert nearest_exactly(np.array([[1.0, 1.0], [1.0, -1.0]]), np.array([1.0, 0])) == {0, 1}


@pytest.mark.parametrize(
    ("found", "right"), [(0, True), (1, True), (2, True), (3, False), (-1, False), (4, False)]
)
def test_a_row_counts_as_nearest_only_within_rounding(found, right):
    angles = np.array([0.3, 0.3, 0.3 + 1e-15, 0.3 + 1e-13])
    rows = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    assert is_nearest(rows, np.array([1.0, 0.0]), found, {0}) == right


def test_ours_is_right_in_every_hard_case(rows):
    cases = hard_cases(rows)
    for name, case in cases.items():
        said = verdict(BUILDERS[OURS], case)
        assert said.startswith("right"), f"{name}: {said}"
    assert cases["equal rows"].rows_right == {50, 250, 450}
    assert cases["1e-9 rad"].rows_right == nearest_exactly(
        cases["1e-9 rad"].rows, cases["1e-9 rad"].query
    )


@pytest.mark.parametrize(
    ("answer", "case", "said"),
    [
        ((400, 0.0), "1e-9 rad", "wrong angle: 0"),
        ((20, 0.0), "1e-9 rad", "wrong row at 4.0e-09 rad"),
        ((400, 1e-9), "1e-9 rad", "right"),
        ((400, np.nan), "1e-9 rad", "row 400, NaN"),
        ((250, None), "equal rows", "right"),
        ((0, None), "equal rows", "wrong row at"),
        ((-1, 0.0), "1e200 times", "wrong row: -1"),
        ((0, np.nan), "zero query", "row 0, NaN"),
        ((7, 1.57), "zero query", "row 7, 1.6 rad"),
        ((10, 0.0), "zero row", "wrong row: 10"),
        (ValueError("no"), "zero row", "right: refused"),
        (ValueError("no"), "zero query", "right: refused"),
        (ValueError("no"), "equal rows", "refused"),
    ],
)
def test_a_wrong_answer_is_called_by_its_name(rows, answer, case, said):
    hard = hard_cases(rows)[case]

    def search(queries):
        if isinstance(answer, Exception):
            raise answer
        row, angle = answer
        return np.array([row]), np.array([hard.angle if angle is None else angle])

    found = verdict(lambda _: search, hard)
    assert found.startswith(said)
    assert found == "right" or said != "right"


@pytest.mark.parametrize("name", BUILDERS)
def test_every_peer_that_is_here_answers_as_an_exact_search_where_that_is_easy(rows, name):
    if name in missing():
        pytest.skip(f"{name} is not installed")
    queries = signatures(load_scene("reference"), 30, np.random.default_rng(6))
    search = BUILDERS[name](rows)
    together, angles = search(queries)
    assert together.shape == angles.shape == (30,)
    for query, row, angle in zip(queries, together, angles, strict=True):
        assert row in nearest_exactly(rows, query)
        alone, own = search(query[None])
        assert alone.tolist() == [row]
        assert own == pytest.approx(angle, abs=1e-5)


def test_a_wrong_peer_is_counted_and_the_right_one_is_not(rows):
    def last(table):
        return lambda queries: (np.full(len(queries), len(table) - 1), np.zeros(len(queries)))

    builders = {OURS: BUILDERS[OURS], "last": last}
    queries = signatures(load_scene("reference"), 20, np.random.default_rng(7))
    answers = compare(builders, rows, queries, rounds=2, checks=15)
    missed = sum(599 not in nearest_exactly(rows, query) for query in queries[:15])
    assert missed > 10
    assert (answers["last"].missed, answers["last"].checked) == (missed, 15)
    assert (answers[OURS].missed, answers[OURS].checked) == (0, 15)
    assert answers[OURS].batch_queries == BATCH
    right = {"case": "right", "other": "right: refused"}
    found = figures(answers, {OURS: right, "last": right})
    assert found[OURS]["exact"]
    assert found[OURS]["ratio"] == found[OURS]["batch_ratio"] == 1
    assert not found["last"]["exact"]
    # A hard case alone takes the word away too.
    wrong = figures(answers, {OURS: {**right, "more": "row 0, NaN"}, "last": right})
    assert not wrong[OURS]["exact"]


def test_a_picture_names_each_peer_once_below_a_title_that_fits(monkeypatch, tmp_path):
    """Of peers that answer rightly in small tables and wrongly in large ones."""
    figures_drawn = []
    monkeypatch.setattr(report, "save", lambda figure, path: figures_drawn.append(figure))
    peers = {name: {"query_us": 3.0, "batch_us": 2.0} for name in BUILDERS}
    searches = [
        {"rows": rows, "peers": {name: {**each, "exact": exact} for name, each in peers.items()}}
        for rows, exact in ((1000, True), (10000, False))
    ]
    report.draw(searches, tmp_path / "peers.png")
    (figure,) = figures_drawn
    figure.draw_without_rendering()
    legend = figure.axes[1].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == list(BUILDERS)
    (title,) = figure.texts
    box = title.get_window_extent()
    assert figure.bbox.x0 < box.x0 < box.x1 < figure.bbox.x1


@pytest.mark.parametrize("rows_at_once", [1, 3, 1000])
def test_a_batch_that_is_cut_into_parts_is_put_together_again(monkeypatch, rows, rows_at_once):
    monkeypatch.setattr(libraries, "ANGLES_AT_ONCE", rows_at_once * len(rows))
    queries = rows[5:18] * 3.0
    found, angles = BUILDERS["SciPy cdist"](rows)(queries)
    assert found.tolist() == list(range(5, 18))
    assert (angles < 1e-6).all()


def test_peers_that_are_not_here_are_named_in_one_line_with_the_cure(
    only_ours, capsys, tmp_path, monkeypatch
):
    picture, drawn = tmp_path / "peers.png", []
    monkeypatch.setattr(report, "save", lambda figure, path: drawn.append(path))
    run("--rows", 600, 700, "--poses", 3000, "--output", picture)
    out = capsys.readouterr().out
    (line,) = [line for line in out.splitlines() if line.startswith("not installed")]
    assert all(name in line for name in NEEDS)
    assert line.endswith("pip install -e '.[peers]'")
    assert "SciPy cdist" in out
    assert "700 signatures" in out
    assert "x floor" in out
    assert drawn == [picture]


def test_json_is_one_object_with_the_figures_of_each_peer(capsys):
    run("--rows", 800, 600, "--poses", 3000, "--json")
    out = capsys.readouterr().out
    found = json.loads(out)
    assert found["rows"] == 800
    assert [smaller["rows"] for smaller in found["smaller"]] == [600]
    here = [name for name in BUILDERS if name not in missing()]
    assert list(found["peers"]) == here
    for name, each in found["peers"].items():
        assert each["query_us"] > 0
        assert each["ratio"] == pytest.approx(each["query_us"] / found["peers"][OURS]["query_us"])
        assert each["exact"] == (
            each["missed"] == 0
            and all(said.startswith("right") for said in found["hard_cases"][name].values())
        )
    assert found["peers"][OURS]["exact"]
    assert not found["peers"]["NumPy"]["exact"], "it answers a zero query"
    light = found["simulation"]
    assert light["poses"] == 3000
    assert light["numpy"]["poses_per_s"] > 0
    assert light["numpy"]["times_floor"] > 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--rows", "10"], "--rows: 10"),
        (["--rows", "1e9"], "--rows: 1000000000"),
        (["--rows", "1000.5"], "--rows: 1000.5"),
        (["--rows", "nan"], "--rows: nan"),
        (["--poses", "-1"], "--poses: -1"),
        (["--poses", "inf"], "--poses: inf"),
    ],
)
def test_a_bad_count_is_refused_in_one_line(words, told):
    assert run(*words, code=1).startswith(f"peers: {told}")


def test_an_interrupt_keeps_what_was_measured(monkeypatch, capsys):
    def interrupted(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(program.light, "simulate", interrupted)
    run("--rows", 600, "--json", code=130)
    out = capsys.readouterr().out
    assert json.loads(out)["rows"] == 600
