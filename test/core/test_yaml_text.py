"""YAML as it is written: the values first, and of the text before them what still holds."""

import dataclasses

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from uuv_optical_array.core.storage import yaml_text
from uuv_optical_array.forward.scene import load_scene, save_scene

reproducible = settings(max_examples=40)

MINE = """\
# The rig of our harbour.

extends: follow              # the nearest

lamp:
  # measured on the bench
  beam_sigma_deg: 7.5        # by its sheet
  reference_range_m: 4e0     # tape

effects:
  # what the diver saw
  sensor_noise: {sigma_counts: 2, relative: 0}  # loud
"""


def test_what_is_written_anew_keeps_comments_and_spellings_of_what_stays(tmp_path):
    (tmp_path / "mine.yaml").write_text(MINE, encoding="utf-8")
    scene = load_scene(tmp_path / "mine.yaml")
    save_scene(scene, tmp_path / "new.yaml", "Written.", MINE)
    text = (tmp_path / "new.yaml").read_text(encoding="utf-8")
    assert text.startswith("# Written.\n\n# The rig of our harbour.\n\nlamp:\n  # measured on")
    for line in MINE.splitlines()[5:8] + MINE.splitlines()[10:]:
        assert f"\n{line}\n" in text, "as it was"
    assert "extends" not in text, "every setting is there by itself"
    assert load_scene(tmp_path / "new.yaml") == dataclasses.replace(scene, name="new")


@pytest.mark.parametrize(
    "like",
    [
        "a: &x {k: 1}\nb: *x\n",
        "base: &x {k: 1}\na:\n  <<: *x\nb: {}\n",
        "a: [",
        "- a\n",
        "a: 1\na: 2\n",
        "# alone\n",
    ],
)
def test_values_come_before_comments(like):
    values = {"a": {"k": 2, "m": [1.0, 2.5]}, "b": {"k": 3}}
    assert yaml.safe_load(yaml_text.text_of(values, like)) == values


def test_who_changes_what_was_read_changes_it_for_nobody_else():
    text = "a: {b: [1]}"
    yaml_text.parse(text)["a"]["b"].append(2)
    assert yaml_text.parse(text) == {"a": {"b": [1]}}


LEAVES = (
    st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text("ab: #1e-", min_size=1)
)
VALUES = st.recursive(
    LEAVES,
    lambda inside: (
        st.lists(inside, max_size=4) | st.dictionaries(st.text("abc", min_size=1), inside)
    ),
    max_leaves=6,
)
MAPPINGS = st.dictionaries(st.text("abc", min_size=1), VALUES, max_size=3)


@given(values=MAPPINGS, before=MAPPINGS)
@reproducible
def test_what_is_written_is_read_again_whatever_stood_there(values, before):
    like = "# head\n" + yaml.safe_dump(before, sort_keys=False)
    for text in (yaml_text.text_of(values), yaml_text.text_of(values, like)):
        assert yaml_text.parse(text) == values


def test_a_list_of_numbers_is_on_one_line():
    numbers = [1.5] * 400
    assert yaml_text.text_of({"a": numbers}).count("\n") == 1
    assert yaml_text.text_of({"a": [numbers, numbers]}).count("\n") == 3
