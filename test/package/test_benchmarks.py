"""A benchmark of the nodes runs: what it measures is there under the name that it uses."""

import json
import re
import sys
from pathlib import Path

import pytest
from command_line import begun, ended

from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.closed_loops import kinds as closed_loop_kinds
from uuv_optical_array.studies.mismatches.kinds import kinds_named

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.mark.skipif(not BENCHMARKS.is_dir(), reason="the benchmarks are not installed")
def test_latency_prints_a_line_with_the_times_of_all_steps():
    few = ["--processes=1", "--sides=5", "--rates=50", "--seconds=0.4"]
    program = [sys.executable, BENCHMARKS / "latency.py", "--methods=sam_interpolated", *few]
    with begun(program) as process:
        out, _ = ended(process)
    head, figures = (
        [line[start : start + 9].strip() for start in range(0, len(line), 9)]
        for line in out.splitlines()[1:3]
    )
    assert head[-3:] == ["fit", "estimate", "track"]
    assert len(figures) == len(head)
    assert all(re.fullmatch(r"\d+(\.\d+)?", figure) for figure in figures)


@pytest.fixture
def promises():
    """The program, with four promises of the test's own."""
    module = pytest.importorskip("promises", reason="the benchmarks are not installed")

    def broken():
        raise OSError("no disk\nat all")

    def promise(group, bound, measure):
        return module.Promise(group, f"{group}: a thing", bound, "m", "README", measure, "x")

    mine = (
        promise("good", 0.5, lambda: {"x": 0.5}),
        promise("bad", 0.5, lambda: {"x": 0.51}),
        promise("ugly", 0.5, broken),
        promise("good", 0, lambda: {"x": 0}),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PROMISES", mine)
        yield module


def test_promises_hold_up_to_their_bound_and_what_is_not_measured_does_not(promises, capsys):
    assert promises.main([]) == 1
    text = capsys.readouterr().out
    lines = [line.split() for line in text.splitlines() if "a thing" in line]
    assert [line[3:] for line in lines] == [
        ["0.5", "0.5", "m", "holds", "README"],
        ["0.51", "0.5", "m", "falls", "short", "README"],
        ["-", "0.5", "m", *["not", "measured:", "OSError:", "no", "disk", "README"]],
        ["0", "0", "m", "holds", "README"],
    ]
    assert text.endswith("\n2 of 4 promises fall short\n")


@pytest.mark.parametrize(
    ("words", "code", "count"),
    [(["--only", "good"], 0, 2), (["--only=good,bad"], 1, 3), (["--exit-zero"], 0, 4)],
)
def test_the_exit_code_of_promises_is_that_of_the_chosen_ones(promises, capsys, words, code, count):
    assert promises.main([*words, "--json"]) == code
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(found) == count
    assert found[0] == {
        **{"group": "good", "promise": "good: a thing", "figure": 0.5, "bound": 0.5, "unit": "m"},
        **{"where": "README", "holds": True, "error": ""},
    }


def test_an_unknown_group_of_promises_is_refused_with_those_that_there_are(promises, capsys):
    with pytest.raises(SystemExit, match="2"):
        promises.main(["--only", "best"])
    assert "'best' is unknown; choose from good, bad, ugly" in capsys.readouterr().err


@pytest.mark.skipif(not BENCHMARKS.is_dir(), reason="the benchmarks are not installed")
def test_every_promise_is_one_of_figures_that_are_measured():
    """Cheaply: each names a function of its module, and a kind or scene that there is."""
    import promised
    import promises

    known = {kind.name for kind in kinds_named(None, load_scene("follow"))}
    assert promises.FALSE.keys() < known
    for promise in promises.PROMISES:
        measure = getattr(promise.measure, "func", promise.measure)
        assert vars(promised)[measure.__name__] is measure, promise.what
        if measure is promised.closed_loop:
            closed_loop_kinds.kinds_named(promise.measure.args[0])
    assert len({promise.what for promise in promises.PROMISES}) == len(promises.PROMISES)
