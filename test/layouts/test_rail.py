"""One detector on a rail in clear water, written and fitted without the package beside it."""

import numpy as np
import pytest
from command_line import json_of, run
from scipy.optimize import least_squares

from uuv_optical_array.forward.scene import load_scene

POWER, SIGMA_DEG, K = 9000.0, 10.0, 0.12  # counts m^2, deg, 1/m
SIGMA_COUNTS, COUNTS_PER_VOLT = 1.5, 1000.0
DETECTOR = "name,x_m,y_m,z_m,normal_x,normal_y,normal_z\npd,0,0,0,2,0,0\n"
SCENE = """extends: reference
effects:
  attenuation:
    k_per_m: 0.05
  adc: null
  saturation: null
  sensor_noise:
    sigma_counts: 1.5
"""
HOLD = [
    word
    for name in (
        "field_of_view.cosine_power",
        "lamp.aim_pitch_rad",
        "lamp.aim_yaw_rad",
        "array.aim_pitch_rad",
        "array.aim_yaw_rad",
        "ambient.level_counts",
    )
    for word in ("--hold", name)
]


def light(x, y, logarithm, sigma_deg, k):
    """Return the reading of a detector that faces +x, by the inverse square, Lambert and Beer."""
    r = np.hypot(x, y)
    off = np.arctan2(np.abs(y), -x)
    beam = np.exp(-0.5 * (off / np.radians(sigma_deg)) ** 2)
    return np.exp(logarithm - k * r) / r**2 * beam * -x / r


@pytest.fixture(scope="module")
def rail(tmp_path_factory):
    """Places along three lines, m, their readings, counts, and the tables of both."""
    folder = tmp_path_factory.mktemp("rail")
    x = -np.tile(np.linspace(1.0, 5.0, 40), 3)
    y = np.repeat([0.0, 0.4, -0.4], 40)
    counts = light(x, y, np.log(POWER), SIGMA_DEG, K)
    counts += SIGMA_COUNTS * np.random.default_rng(4).standard_normal(len(x))
    rows = np.column_stack([counts / COUNTS_PER_VOLT, x, y])
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    text = "\n".join(["# a rail", "pd,x_m,y_m,comment", *(f"{line},ok" for line in lines), ""])
    (folder / "rail.csv").write_text(text)
    (folder / "detector.csv").write_text(DETECTOR)
    (folder / "bench.yaml").write_text(SCENE)
    return folder, x, y, counts


def command(folder, *words):
    return (
        "calibrate", folder / "rail.csv", "--detectors", folder / "detector.csv",
        "--scene", folder / "bench.yaml", "-o", folder / "found.yaml",
        "--set", f"counts_per_unit={COUNTS_PER_VOLT}", *words,
    )  # fmt: skip


KNOWN = ["--known", "z_m=0", "--known", "pitch_deg=0", "--known", "yaw_deg=0"]


def test_a_rail_calibrates_lamp_and_water_as_plain_least_squares_do(rail):
    folder, x, y, counts = rail
    alone = least_squares(
        lambda p: (light(x, y, *p) - counts) / SIGMA_COUNTS, [8.0, 8.0, 0.05], x_scale="jac"
    )
    errors = np.sqrt(np.linalg.inv(alone.jac.T @ alone.jac).diagonal())
    found = json_of(run, *command(folder, *KNOWN, *HOLD))
    assert found["mean_squared_residual"] == pytest.approx(2 * alone.cost / (len(x) - 3), rel=1e-3)
    wanted = {
        "lamp.power": (np.exp(alone.x[0]), np.exp(alone.x[0]) * errors[0]),
        "lamp.beam_sigma_deg": (alone.x[1], errors[1]),
        "attenuation.k_per_m": (alone.x[2], errors[2]),
    }
    for name, (value, error) in wanted.items():
        fit = found["parameters"][name]
        assert abs(fit["fitted"] - value) < 0.02 * error, name
        assert fit["std_error"] == pytest.approx(error, rel=0.02), name
    # The scene keeps its own array, whose reading is that of its brightest detector.
    written = load_scene(folder / "found.yaml")
    assert written.array == load_scene(folder / "bench.yaml").array
    # That in the middle of the sphere faces the lamp from 0.72 m before base_link.
    there = 4.0 - 0.4 - 0.32
    expected = light(np.array(-there), 0.0, *alone.x)
    assert written.lamp.reference_counts == pytest.approx(expected, rel=1e-5)


def test_what_a_rail_cannot_tell_is_said(rail):
    folder, *_ = rail
    found = json_of(run, *command(folder, *KNOWN))
    for name in ("field_of_view.cosine_power", "lamp.aim_pitch_rad", "array.aim_yaw_rad"):
        assert found["parameters"][name]["note"] == "not known", name
    assert any("field_of_view.cosine_power is not known" in note for note in found["notes"])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "z_m: no value for 120 of 120 places; add a column, or give --known z_m=VALUE"),
        (["--known", "z_m"], "--known z_m: no value; give z_m=VALUE"),
        (
            [*KNOWN, "--set", "counts_per_unit=1"],
            "the brightest reading is 7.98131 counts; a scene needs 10 at least",
        ),
        ([*KNOWN, "--places", "x.csv"], "--places: its table has complete poses"),
    ],
)
def test_what_is_missing_of_a_place_is_named(rail, words, told):
    folder, *_ = rail
    code = 2 if told.startswith("--") else 1
    assert told in run(*command(folder, *words), code=code)


def test_a_known_part_without_a_value_is_named_before_the_table_is_read(rail, tmp_path):
    folder, *_ = rail
    (tmp_path / "long.csv").write_text("no table\n")
    told = run("calibrate", tmp_path / "long.csv", *command(folder, "--known", "z_m")[2:], code=2)
    assert "--known z_m: no value; give z_m=VALUE" in told


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("pd,x_m", "diode,x_m", "no column pd of a detector; its columns are diode, x_m, y_m"),
        ("# a rail\n", "", None),
        ("-1,0,ok", "-1 m,0,ok", "line 3: x_m: '-1 m' is not a number; give one"),
        ("-1,0,ok", "-4000,0,ok", "line 3: x_m: -4000; it must be from -1000 to 1000"),
        ("-1,0,ok", ",0,ok", "x_m: no value for 1 of 120 places"),
    ],
)
def test_a_bad_table_of_readings_is_refused_by_line(rail, tmp_path, old, new, told):
    folder, *_ = rail
    text = (folder / "rail.csv").read_text()
    assert old in text
    path = tmp_path / "other.csv"
    path.write_text(text.replace(old, new, 1))
    words = command(folder, *KNOWN, *HOLD)
    words = (words[0], path, *words[2:])
    if told is None:
        run(*words)
    else:
        assert told in run(*words, code=1)


def test_readings_beyond_full_scale_are_refused_with_the_cure(rail, tmp_path):
    folder, *_ = rail
    scene = tmp_path / "short.yaml"
    scene.write_text(SCENE.replace("adc: null", "adc: {bits: 10}"))
    words = command(folder, *KNOWN, "--scene", scene)
    told = run(*words, code=1)
    assert "readings are above full scale, 1023 counts, at 1000 counts a unit" in told
    assert "set counts_per_unit, or the scene's adc and saturation" in told
