"""Property tests try the same examples in each run, whatever else a process has loaded."""

import importlib.util
import sys

from hypothesis import given, settings
from hypothesis import strategies as st


def drawn():
    numbers = []

    @settings(max_examples=100, database=None)
    @given(st.floats(allow_nan=False), st.integers())
    def draw(real, whole):
        numbers.append((real, whole))

    draw()
    return numbers


def test_numbers_of_a_module_that_is_loaded_later_are_not_drawn(tmp_path, monkeypatch):
    before, file = drawn(), tmp_path / "module.py"
    file.write_text("NUMBERS = 1234.5678, 987654321123, 0.0625125, 55555.5\n", encoding="utf-8")
    spec = importlib.util.spec_from_file_location("loaded_later", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setitem(sys.modules, "loaded_later", module)
    assert drawn() == before
