"""A benchmark of the nodes runs: what it measures is there under the name that it uses."""

import re
import sys
from pathlib import Path

import pytest
from command_line import begun, ended

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
