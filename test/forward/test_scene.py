"""Scene files: what loads, what is refused and with which words, and the fingerprint."""

import copy
import functools
import math

import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import READY, coarse
from scenes import changed as changed_scene

from uuv_optical_array.core.settings import declared
from uuv_optical_array.core.storage.files import shared_file
from uuv_optical_array.forward.effects import EFFECTS
from uuv_optical_array.forward.lamp.lamps import BeaconLamp
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import GROUPS, load_scene, scene_from_settings

BLURRED = {"effects": {"forward_scatter": {"window_m": 0.3}}, "array": {"bow_m": 0.5}}
FULL = coarse(changed_scene("reference", **BLURRED)).settings()
# Another valid value of a key of each kind, from its documented range.
VALUES = {
    "lamp.beam_sigma_deg": st.floats(0.1, 90),
    "array.detectors_per_side": st.integers(2, 501),
    "array.bow_m": st.floats(-50, 50),
    "effects.attenuation.k_per_m": st.floats(0, 10),
    "effects.adc.bits": st.integers(1, 16),
    "signature.peak": st.sampled_from(["detector", "subdetector"]),
    "signature.lift": st.floats(0, 1e6),
    "table.x_m": st.tuples(st.floats(-1000, -500), st.floats(-4, 1000), st.integers(2, 10_000)),
    "table.yaw_deg": st.tuples(st.floats(-180, -1), st.floats(1, 180), st.integers(2, 10_000)),
}
MISSING = object()


def changed(path, value):
    """Return the full settings with the value at a dotted path replaced, added or left out."""
    result = copy.deepcopy(FULL)
    *parents, last = path.split(".")
    group = functools.reduce(dict.__getitem__, parents, result)
    if value is MISSING:
        del group[last]
    else:
        group[last] = value
    return result


def valid(values):
    return scene_from_settings(values, "test")


def refusal(values):
    with pytest.raises(ValueError, match="scene test: ") as caught:
        valid(values)
    return str(caught.value)


def respelt(values):
    """Copy nested settings, keys the other way round and each whole float as an int: 8.0 as 8."""
    if isinstance(values, dict):
        return {key: respelt(values[key]) for key in reversed(values)}
    if isinstance(values, list):
        return [respelt(value) for value in values]
    return int(values) if isinstance(values, float) and values.is_integer() else values


@pytest.mark.parametrize("name", READY)
def test_each_ready_scene_says_when_to_use_it_and_has_one_layout(name):
    lines = shared_file(f"config/scenes/{name}.yaml").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# Use ")
    assert lines[0].endswith(".")
    assert max(map(len, lines)) <= 100
    groups = [line.partition(":")[0] for line in lines if line and line[0].isalpha()]
    order = ["extends", "lamp", "lamps", "array", "effects", "signature", "table", "prior"]
    assert groups == [group for group in order if group in groups]
    scene = load_scene(name)
    assert scene.name == name
    again = scene_from_settings(yaml.safe_load(yaml.safe_dump(scene.settings())), name)
    assert (again, again.fingerprint) == (scene, scene.fingerprint)
    model = ForwardModel(scene)
    aligned = [-scene.lamp.reference_range_m, 0, 0, 0, 0]
    dark = model.light([-1000.0, 0, 0, 0, 0]).max()  # daylight, or a pedestal
    brightest = model.light(aligned).max()
    if not scene.lamps:
        assert brightest == pytest.approx(scene.lamp.reference_counts + dark, rel=1e-2)
    assert brightest < scene.full_scale_counts or not scene.effects
    far = model.light([scene.table.x_m.start, 0, 0, 0, 0]).max() - dark
    assert far > 10, "the table ends where light is left"


def test_a_scene_file_is_read_by_its_path_and_named_after_its_stem(tmp_path):
    file = tmp_path / "harbour.yaml"
    file.write_text(yaml.safe_dump(FULL))
    for path in (file, str(file)):
        scene = load_scene(path)
        assert scene.name == "harbour"
        assert scene.fingerprint == valid(FULL).fingerprint


def test_what_a_scene_leaves_out_takes_the_documented_default():
    values = {"lamp": FULL["lamp"], "array": {"shape": "planar", "detectors_per_side": 21}}
    scene = valid(values)
    assert scene.table == load_scene("follow").table
    assert (scene.array.width_m, scene.array.bow_m) == (0.4, 0.4), "Eren et al. (2016)"
    assert scene.array.radius_m is None
    assert scene.effects == {}
    assert scene.signature.peak == "subdetector"


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ({}, 900.0),
        ({"adc": {"bits": 8}}, 255.0),
        ({"saturation": {"level_counts": 600.0}}, 600.0),
        ({"saturation": {"level_counts": 600.0}, "adc": {"bits": 8}}, 255.0),
        ({"saturation": {"level_counts": 600.0}, "adc": {"bits": 12}}, 600.0),
    ],
)
def test_full_scale_is_the_lowest_limit_or_else_the_reference_reading(effects, expected):
    assert valid(changed("effects", effects)).full_scale_counts == expected


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("lamp.beam_sigma_rad", 8.0, ["lamp.beam_sigma_rad", "did you mean beam_sigma_deg?"]),
        ("prior.gain_error", 0.1, ["prior.gain_error: unknown key", "known here: known, lamp"]),
        ("lmap", {}, ["lmap: unknown key", "did you mean lamp?"]),
        ("array.colour", "red", ["array.colour: unknown key", "known here: shape, detectors"]),
        ("lamp.beam_sigma_deg", "8 deg", ["'8 deg' is not a number", "without a unit", "90 deg"]),
        ("lamp.beam_sigma_deg", True, ["lamp.beam_sigma_deg: True is not a number"]),
        ("lamp.beam_sigma_deg", 0.09, ["0.09 is out of bounds", "from 0.1 to 90 deg"]),
        ("lamp.beam_sigma_deg", math.nan, ["nan is out of bounds", "from 0.1 to 90 deg"]),
        ("array.detectors_per_side", 10**400, ["array.detectors_per_side: 1", "is out of bounds"]),
        ("lamp.reference_counts", math.inf, ["inf is out of bounds", "1 to 1e+06 counts"]),
        ("array.detectors_per_side", 5.0, ["5.0 is not a whole number", "from 2 to 501"]),
        ("array.shape", "sphere", ["array.shape: 'sphere'", "choose planar or curved"]),
        ("array.shape", "planar", ["array.radius_m: 0.32 m, but a planar array has none"]),
        ("lamp", MISSING, ["lamp.beam_sigma_deg: missing", "add it to the scene"]),
        ("lamp", [8.0], ["lamp: [8.0] is not a mapping"]),
        ("table.x_m", -5.0, ["table.x_m: -5.0 is not a span", "[from, to, how many]"]),
        ("table.x_m", [-8.0, "-4 m", 5], ["table.x_m[1]: '-4 m' is not a number"]),
        ("table.x_m", [-1001, -4.0, 5], ["table.x_m[0]: -1001 is out", "from -1000 to 1000 m"]),
        ("table.x_m", [-4.0, -8.0, 5], ["table.x_m: [-4, -8, 5] is not a span", "from < to"]),
        ("table.x_m", [-8.0, -4.0, 1], ["table.x_m: [-8, -4, 1] is not a span", "at least 2"]),
        (
            "effects.sea",
            {"water": "petzold_clear"},
            ["effects.attenuation: effects.sea absorbs", "leave one out"],
        ),
    ],
)
def test_a_wrong_setting_is_refused_with_its_key_value_bound_and_cure(path, value, words):
    message = refusal(changed(path, value))
    for word in words:
        assert word in message


def test_a_file_that_holds_no_scene_is_refused_by_name(tmp_path):
    file = tmp_path / "broken.yaml"
    for text, words in (
        (b"lamp: [8.0", "not YAML"),
        (b"\tlamp: 1", "not YAML"),
        (b"\x80\x04\x95\xff\xfe", "not YAML"),
        (b"lamp: \x00\x01", "not YAML"),
        (b"lamp: 2001-99-99", "not YAML"),
        (b"lamp: " + b"9" * 5000, "not YAML"),
        (b"", "None is not a mapping of groups"),
        (b"just words", "'just words' is not a mapping of groups"),
    ):
        file.write_bytes(text)
        with pytest.raises(ValueError, match=rf"scene .*broken.*{words}"):
            load_scene(file)


def test_a_missing_file_and_an_unknown_ready_scene_are_told_apart(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.yaml: no such file"):
        load_scene(tmp_path / "nowhere.yaml")
    with pytest.raises(FileNotFoundError, match=r"ready scene \(.*follow, .*reference.*\)"):
        load_scene("folow")


def test_the_fingerprint_ignores_key_order_int_spelling_and_name():
    scene, other = valid(FULL), scene_from_settings(respelt(FULL), "another")
    assert other.fingerprint == scene.fingerprint
    assert scene.differences(other) == []
    assert list(other.effects) == list(scene.effects), "in physical order"
    plus, minus = (valid(changed("signature.lift", zero)) for zero in (0.0, -0.0))
    assert plus.fingerprint == minus.fingerprint


@given(data=st.data())
@settings(max_examples=50)
def test_any_changed_value_is_the_only_difference_changes_the_fingerprint_and_survives_yaml(data):
    path = data.draw(st.sampled_from(list(VALUES)))
    value = data.draw(VALUES[path])
    # Minus zero is zero.
    if isinstance(value, tuple):
        value = [number + 0 for number in value]
    elif isinstance(value, float):
        value += 0
    group, key, *deeper = path.split(".")
    before = FULL[group][key][deeper[0]] if deeper else FULL[group][key]
    assume(value != before)
    scene, other = valid(FULL), valid(changed(path, value))
    assert other.fingerprint != scene.fingerprint
    (line,) = scene.differences(other)
    assert line.startswith(f"{path} is ")
    assert str(value) in line.split(" there and ")[0]
    assert str(before) in line.split(" there and ")[1]
    again = valid(yaml.safe_load(yaml.safe_dump(other.settings())))
    assert (again, again.fingerprint) == (other, other.fingerprint)


def test_an_effect_left_out_changes_the_fingerprint_and_reads_absent():
    scene, other = valid(FULL), valid(changed("effects.adc", MISSING))
    assert other.fingerprint != scene.fingerprint
    assert scene.differences(other) == ["effects.adc.bits is absent there and 10 here"]
    assert other.differences(scene) == ["effects.adc.bits is 10 there and absent here"]


def test_reading_a_scene_leaves_the_given_settings_alone():
    given_values = copy.deepcopy(FULL)
    scene = valid(given_values)
    scene.settings()["table"]["x_m"].append("more")
    assert given_values == FULL
    assert scene.settings()["table"]["x_m"] == [-8.0, -4.0, 5]


@pytest.mark.parametrize(
    ("line", "key"),
    [("lamp: {beam_sigma_deg: 9.0}", "lamp"), ("prior: {known: a, known: b}", "known")],
)
def test_a_key_given_twice_is_refused_with_its_line(tmp_path, line, key):
    file = tmp_path / "twice.yaml"
    file.write_text(f"lamp: {FULL['lamp']}\n{line}\n")
    with pytest.raises(ValueError, match=f'twice.yaml: not YAML: line 2: .* key "{key}"; keep one'):
        load_scene(file)


def test_a_number_may_be_spelt_in_each_way_that_yaml_1_2_has(tmp_path):
    file = tmp_path / "spelt.yaml"
    for spelt in ("1e-3", "1E-3", "1.e-3", "+1e-03", ".001", "0.1e-2"):
        file.write_text(yaml.safe_dump(FULL).replace("k_per_m: 0.1", f"k_per_m: {spelt}"))
        assert load_scene(file).effects["attenuation"]["k_per_m"] == 1e-3


def test_every_number_of_a_scene_has_bounds():
    effects = (effect.function for effect in EFFECTS.values())
    settings = [
        (o, *item) for o in (*GROUPS.values(), BeaconLamp, *effects) for item in declared(o).items()
    ]
    numbers = [
        (owner, name, one.quantity)
        for owner, name, one in settings
        if not one.choices and one.kind is not str
    ]
    assert len(numbers) > 60
    for owner, name, quantity in numbers:
        assert -math.inf < quantity.low < quantity.high < math.inf, (owner, name)
