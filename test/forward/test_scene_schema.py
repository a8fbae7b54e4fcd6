"""The schema of scenes refuses what the loader refuses for a type or a bound, and nothing else."""

import json
import math
import re

import jsonschema
import pytest
from effect_settings import middle_settings
from generate_reference import schema_text
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import READY
from test_scene import FULL

from uuv_optical_array.core.settings import declared
from uuv_optical_array.core.storage import yaml_text
from uuv_optical_array.forward.effects import EFFECTS
from uuv_optical_array.forward.scene import GROUPS, load_scene, scene_from_settings
from uuv_optical_array.forward.scene_files import Layer, merged, scene_file

SCHEMA = json.loads(schema_text())
VALIDATOR = jsonschema.Draft7Validator(SCHEMA)
reproducible = settings(max_examples=200)

OWNERS = {
    **{(group,): owner for group, owner in GROUPS.items()},
    **{("effects", name): effect.function for name, effect in EFFECTS.items()},
}
PATHS = [(*owner, key) for owner in OWNERS for key in declared(OWNERS[owner])]
PATHS += [*OWNERS, ("effects",), ("effects", "fog"), ("lamp", "power"), ("lmap",)]
# What refuses a value by itself; what depends on other values is said in other words.
ALONE = (
    *("is not a", "is out of bounds", "is unknown", "unknown key"),
    *("empty;", "given twice"),
)
NUMBERS = st.integers(-(10**6), 10**6) | st.floats(allow_nan=False) | st.floats(-2, 2)
WORDS = st.sampled_from(["curved", "planar", "detector", "as_bought", "oceanic_i", "SM05PD1A", ""])
SINGLE = st.none() | st.booleans() | NUMBERS | WORDS
VALUES = SINGLE | st.recursive(
    SINGLE, lambda inside: st.lists(inside, max_size=3) | st.dictionaries(WORDS, inside, max_size=1)
)


def test_the_schema_is_one():
    jsonschema.Draft7Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("name", READY)
def test_a_ready_scene_is_valid_as_it_stands_and_with_all_its_settings(name):
    VALIDATOR.validate(yaml_text.read(scene_file(name)))
    VALIDATOR.validate(load_scene(name).settings())


def whole_in_point(value):
    """Say whether a value has a 5.0, a whole number in JSON and none for the loader."""
    if isinstance(value, list):
        return any(map(whole_in_point, value))
    return isinstance(value, float) and value.is_integer()


def with_value(path, value, base):
    """Return settings of a scene with one value."""
    found = json.loads(json.dumps(base))
    if path[0] == "effects" and len(path) > 1:
        own = middle_settings(path[1]) if base and path[1] in EFFECTS else {}
        found["effects"] = {path[1]: own}
    inner = found
    for name in path[:-1]:
        inner = inner.setdefault(name, {})
    inner[path[-1]] = value
    return found


def refused(values, extends=False):
    """Return why the loader refuses settings, "" where it takes them."""
    try:
        if extends:
            values = merged([Layer("sea.yaml", values, "full"), Layer("full", FULL, "")])
        scene_from_settings(values, "test")
    except ValueError as error:
        return str(error)
    return ""


@given(data=st.data(), path=st.sampled_from(PATHS), extends=st.booleans())
@reproducible
def test_what_the_loader_refuses_by_itself_is_refused_and_what_it_takes_is_taken(
    data, path, extends
):
    value = data.draw(VALUES)
    assume(not whole_in_point(value))
    values = with_value(path, value, {} if extends else FULL)
    refusal = refused(values, extends)
    valid = VALIDATOR.is_valid({"extends": "follow", **values} if extends else values)
    if not refusal:
        assert valid
    elif any(words in refusal for words in ALONE) and "null takes away" not in refusal:
        assert not valid, refusal


@given(data=st.data(), path=st.sampled_from(PATHS[: -4 - len(OWNERS)]))
@reproducible
def test_a_number_just_beyond_its_bounds_is_refused_and_one_within_is_taken(data, path):
    setting = declared(OWNERS[path[:-1]])[path[-1]]
    assume(setting.kind in (int, float))
    low, high = setting.quantity.low, setting.quantity.high
    step = 1 if setting.kind is int else max(abs(low), abs(high)) * 1e-9
    beyond = data.draw(st.sampled_from([low - step, high + step, math.inf, -math.inf]))
    base = {"extends": "follow"}
    assert not VALIDATOR.is_valid(base | with_value(path, beyond, {}))
    assert re.search(
        "is out of bounds|is not a whole number", refused(with_value(path, beyond, FULL))
    )
    within = data.draw(st.sampled_from([low, high]))
    assert VALIDATOR.is_valid(base | with_value(path, within, {}))
    refusal = refused(with_value(path, within, FULL))
    assert not any(words in refusal for words in ALONE)


@pytest.mark.parametrize(
    ("path", "values"),
    [
        ("table.x_m", [[-8, -4], [-8, -4, 5, 1], [-8, -4, 5.5], ["a", -4, 5], [-8, -4, 10_001]]),
        ("effects.detector_faults.dead", [[1], [[1]], [[1, 2, 3]], [[1, 2.5]], [[1, 501]], 3]),
        ("effects.responsivity.gains", [[], [[]], [[-1.0]], [["a"]], 3]),
        ("array.wiring", [[*range(24), 0], [*range(24), -1], [*range(24), "a"], 3]),
    ],
)
def test_a_list_of_another_form_is_refused(path, values):
    for value in values:
        settings = with_value(tuple(path.split(".")), value, FULL)
        with pytest.raises(ValueError, match=re.escape(path)):
            scene_from_settings(settings, "test")
        assert not VALIDATOR.is_valid(settings), value
        assert not VALIDATOR.is_valid({"extends": "follow", **settings}), value


def test_what_must_be_given_is_missed_unless_another_scene_is_extended():
    for path in PATHS[: -4 - len(OWNERS)]:
        if declared(OWNERS[path[:-1]])[path[-1]].required:
            values = with_value(path, 1, FULL)
            inner = values
            for name in path[:-1]:
                inner = inner[name]
            del inner[path[-1]]
            with pytest.raises(ValueError, match="missing"):
                scene_from_settings(values, "test")
            assert not VALIDATOR.is_valid(values), path
            assert VALIDATOR.is_valid({"extends": "follow", **values}), path
