"""A scene that extends another: what it takes over, changes and takes away, and what is refused."""

import copy
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_scene import FULL

from uuv_optical_array.forward.scene import load_scene, scene_from_settings
from uuv_optical_array.forward.scene_files import MAX_FILES, Layer, merged


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a scene file as JSON, which is YAML, and returns its path."""

    def written(name, values):
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps(values), encoding="utf-8")
        return file

    return written


def test_the_same_settings_are_one_scene_however_they_are_written(write):
    """So they share a table: its name has the fingerprint."""
    whole = copy.deepcopy(FULL)
    del whole["effects"]["sensor_noise"]
    whole["effects"]["window"] = {}
    whole["table"]["x_m"] = [-9.0, -4.0, 6]
    write("base.yaml", FULL)
    changes = {"sensor_noise": None, "window": {}}
    file = write(
        "sea.yaml", {"extends": "base.yaml", "effects": changes, "table": {"x_m": [-9.0, -4.0, 6]}}
    )
    assert load_scene(file).fingerprint == scene_from_settings(whole, "whole").fingerprint


def test_a_path_leads_from_the_folder_of_the_file_that_names_it(write, monkeypatch, tmp_path):
    write("deep/base.yaml", {"extends": "../first.yaml", "array": {"bow_m": 0.2}})
    write("first.yaml", FULL)
    file = write("sea.yaml", {"extends": "deep/base.yaml"})
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for path in (file, "../sea.yaml"):
        assert load_scene(path).array.bow_m == 0.2
    own = write("coastal.yaml", {"extends": "coastal"})
    assert load_scene(own) == load_scene("coastal"), "a ready scene's name is no file's"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"extends": "folow"}, ["sea.yaml: extends: scene folow: neither", "mean follow?"]),
        ({"extends": "b.yaml"}, ["sea.yaml: extends: scene ", "b.yaml: no such file"]),
        ({"extends": "sea.yaml"}, ["extends: sea.yaml -> sea.yaml is a circle", "remove extends"]),
        ({"extends": "round.yaml"}, ["sea.yaml -> round.yaml -> sea.yaml is a circle"]),
        ({"extends": "list.yaml"}, ["list.yaml: [1] is not a mapping of groups"]),
        ({"extends": None}, ["sea.yaml: extends: None is not a scene; give the name"]),
        ({"extends": ["follow"]}, ["extends: ['follow'] is not a scene"]),
        (
            {"extends": "follow", "effects": {"plume": None}},
            ["sea.yaml: effects.plume: null removes", "does not have this one; leave it out"],
        ),
        (
            {"extends": "coastal", "effects": {"sea": {"absorption_per_m": 0.1}}},
            ["sea.water: given together with absorption_per_m", "null removes"],
        ),
        ({"extends": "follow", "array": {"shape": "planar"}}, ["radius_m: 0.32 m", "null"]),
        ({"extends": "follow", "lamp": [8.0]}, ["lamp: [8.0] is not a mapping"]),
        ({"extends": "follow", "lamp": {"power": 1}}, ["lamp.power: unknown key"]),
    ],
)
def test_a_scene_that_cannot_extend_another_says_why(write, values, words):
    write("round.yaml", {"extends": "sea.yaml"})
    write("list.yaml", [1])
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        load_scene(write("sea.yaml", values))
    for word in words:
        assert word in str(caught.value)


def test_scenes_extend_each_other_in_a_row_of_eight_and_no_more(write):
    write("1.yaml", FULL)
    for number in range(2, MAX_FILES + 2):
        file = write(f"{number}.yaml", {"extends": f"{number - 1}.yaml"})
        if number <= MAX_FILES:
            assert load_scene(file).array.detectors_per_side == 5
    with pytest.raises(ValueError, match=r"9\.yaml -> 8\.yaml .* are more than 8 files"):
        load_scene(file)


def patched(target, patch):
    """Merge as the pseudocode of RFC 7396, section 2, does; KeyError for what it lets pass."""
    if not isinstance(patch, dict):
        return patch
    target = dict(target) if isinstance(target, dict) else {}
    for name, value in patch.items():
        if value is None:
            del target[name]
        else:
            target[name] = patched(target.get(name), value)
    return target


KEYS = st.sampled_from("abc")
LEAVES = st.integers(0, 9) | st.lists(st.integers(0, 9), max_size=2)
TREES = st.recursive(LEAVES, lambda inside: st.dictionaries(KEYS, inside, max_size=3), max_leaves=8)
PATCHES = st.recursive(
    LEAVES | st.none(), lambda inside: st.dictionaries(KEYS, inside, max_size=3), max_leaves=8
)


@given(base=st.dictionaries(KEYS, TREES), change=st.dictionaries(KEYS, PATCHES))
def test_merging_is_that_of_rfc_7396_but_takes_nothing_away_that_is_not_there(base, change):
    before = copy.deepcopy((base, change))
    layers = [Layer("sea.yaml", change, "base.yaml"), Layer("base.yaml", base, "")]
    try:
        wanted = patched(base, change)
    except KeyError:
        with pytest.raises(ValueError, match=r"scene sea\.yaml: .*: null removes"):
            merged(layers)
    else:
        assert merged(layers) == wanted
    assert (base, change) == before
