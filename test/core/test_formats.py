"""Results as text for other programs, read back by the readers of Python."""

import csv
import io
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uuv_optical_array.core.storage.formats import columns, csv_text, json_text

SCALARS = st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats() | st.text()
NESTED = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner) | st.tuples(inner) | st.dictionaries(st.text(), inner),
    max_leaves=5,
)


def expected(value):
    """Return what a reader of JSON finds."""
    if isinstance(value, dict):
        return {name: expected(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return list(map(expected, value))
    if isinstance(value, float) and (math.isnan(value) or math.isinf(value)):
        return None
    return value


def refuse(constant):
    raise AssertionError(f"{constant} is no JSON")


@given(NESTED)
@settings(max_examples=50)
def test_json_is_one_line_and_reads_back(value):
    text = json_text(value)
    assert "\n" not in text
    assert json.loads(text, parse_constant=refuse) == expected(value)


def test_json_takes_what_numpy_makes():
    value = {"a": np.array([[1.5, np.nan]]), "b": np.float32(0.5), "c": np.int64(3), "d": np.inf}
    assert json.loads(json_text(value)) == {"a": [[1.5, None]], "b": 0.5, "c": 3, "d": None}


@given(st.lists(st.tuples(st.text('aé,;" \n'), st.floats(allow_nan=False), st.integers())))
def test_csv_reads_back(rows):
    names = ["text", "number", "count"]
    text = csv_text(names, [dict(zip(names, row, strict=True)) for row in rows])
    head, *lines = csv.reader(io.StringIO(text, newline=""))
    assert head == names
    assert [(a, float(b), int(c)) for a, b, c in lines] == rows


def test_csv_without_rows_has_its_columns_and_another_column_is_refused():
    assert csv_text(["a", "b"], []) == "a,b\n"
    with pytest.raises(ValueError, match="c"):
        csv_text(["a", "b"], [{"a": 1, "c": 2}])


def test_columns_are_as_wide_as_their_widest_cell():
    rows = [("name", "m"), ("a", 1.25), ("long name", -3, "met"), ()]
    assert columns(rows) == "name          m\na          1.25\nlong name    -3  met\n"
    assert columns([("a", "b"), ("cc", "dd")], left=2) == "a   b\ncc  dd"
