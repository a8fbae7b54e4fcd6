"""The tables of the tutorial on one's own light, calibrated and estimated by the command line."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import json_of, run, text_of
from needs import rosbags

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENE = """extends: follow
effects:
  adc: null
  saturation: null
prior:
  known: as_bought
"""
UNIT = "counts_per_unit=1000"


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    folder = tmp_path_factory.mktemp("light")
    before, sys.argv = sys.argv, ["light_tables", str(folder)]
    try:
        names = runpy.run_path(str(EXAMPLES / "light_tables.py"), run_name="__main__")
    finally:
        sys.argv = before
    (folder / "bench.yaml").write_text(SCENE)
    return folder, names


@pytest.fixture(scope="module")
def vehicle(light):
    """What the calibration of the vehicle found."""
    folder, _ = light
    return json_of(
        run, "calibrate", folder / "vehicle.csv", "--detectors", folder / "detectors.csv",
        "--trajectory", folder / "trajectory.csv", "--scene", folder / "bench.yaml",
        "--set", UNIT, "--noise", "-o", folder / "vehicle.yaml",
    )  # fmt: skip


def test_a_vehicle_of_six_detectors_is_calibrated_by_another_clock(light, vehicle):
    _, names = light
    clock = vehicle["clock"]
    assert clock["applied"]
    assert abs(clock["offset_s"] + names["LATE_S"]) < 5 * clock["std_s"]
    assert clock["std_s"] < 1e-3
    truth = {
        "lamp.beam_sigma_deg": names["LAMP"]["beam_sigma_deg"],
        "sea.absorption_per_m": names["EFFECTS"]["sea"]["absorption_per_m"],
        "sea.scattering_per_m": names["EFFECTS"]["sea"]["scattering_per_m"],
        "field_of_view.cosine_power": 1.0,
    }
    for name, value in truth.items():
        fit = vehicle["parameters"][name]
        assert abs(fit["fitted"] - value) < 5 * fit["std_error"], name
    # Of six detectors on a grid of nine places.
    gains = np.array(vehicle["gains"]).ravel()[:6]
    errors = np.array(vehicle["gain_std_errors"]).ravel()
    wanted = np.array(names["GAINS"]) / np.exp(np.mean(np.log(names["GAINS"])))
    assert (np.abs(gains - wanted) < 5 * errors[:6].astype(float)).all()
    assert np.isnan(errors[6:].astype(float)).all()


@rosbags
def test_a_dive_whose_depth_and_heading_are_known_has_places(light, vehicle, tmp_path):
    folder, _ = light
    rows = (folder / "dive.csv").read_text().splitlines(keepends=True)
    (tmp_path / "some.csv").write_text("".join([rows[0], *rows[1::5]]))
    words = (
        "estimate", tmp_path / "some.csv", "--detectors", folder / "vehicle_detectors.csv",
        "--scene", folder / "vehicle.yaml", "--set", UNIT, "--known", "z_m", "--known", "yaw_deg",
        "--known", "pitch_deg=0",
    )  # fmt: skip
    text_of(run, *words, "-o", tmp_path / "dive")
    frames = np.genfromtxt(tmp_path / "dive/frames.csv", delimiter=",", names=True)
    truth = np.genfromtxt(tmp_path / "some.csv", delimiter=",", names=True)
    assert len(frames) == len(truth) == 20
    squares = 0.0
    for name in ("x_m", "y_m"):
        off = (frames[name] - truth[name]) / frames[f"std_{name}"]
        assert np.abs(off).max() < 6
        squares += np.sum(off**2)
        assert np.sqrt(np.mean((frames[name] - truth[name]) ** 2)) < 0.06, name
    # What is known of lamp and gains is too wide for one calibration, so poses are better.
    assert squares < 40 + 5 * np.sqrt(2 * 40)
    np.testing.assert_allclose(frames["z_m"], truth["z_m"], atol=1e-5)


def test_an_unknown_heading_is_left_to_the_light(light, tmp_path):
    folder, names = light
    rows = [line.split(",") for line in (folder / "trajectory.csv").read_text().splitlines()]
    (tmp_path / "course.csv").write_text("".join(",".join(row[:5]) + "\n" for row in rows))
    lines = (folder / "vehicle.csv").read_text().splitlines(keepends=True)
    (tmp_path / "some.csv").write_text("".join([lines[0], *lines[1::10]]))
    words = (
        "calibrate", tmp_path / "some.csv", "--detectors", folder / "detectors.csv",
        "--trajectory", tmp_path / "course.csv", "--scene", folder / "bench.yaml",
        "--set", UNIT, "--hold", "gains", "-o", tmp_path / "found.yaml",
    )  # fmt: skip
    told = run(*words, code=1)
    assert "yaw_deg: no value for 40 of 40 places" in told
    found = json_of(run, *words, "--unknown", "yaw_deg", "--noise", "--force")
    clock, sigma = found["clock"], found["parameters"]["lamp.beam_sigma_deg"]
    assert clock["offset_s"] == pytest.approx(-names["LATE_S"], abs=0.05)
    assert sigma["fitted"] == pytest.approx(9.0, abs=0.5)


def test_a_course_that_is_not_there_is_refused(light, tmp_path):
    folder, _ = light
    text = (folder / "trajectory.csv").read_text()
    late = tmp_path / "late.csv"
    head, *rows = text.splitlines()
    moved = [f"{float(row.partition(',')[0]) + 1000},{row.partition(',')[2]}" for row in rows]
    late.write_text("\n".join([head, *moved, ""]))

    def told(course, readings="vehicle.csv"):
        return run(
            "calibrate", folder / readings, "--detectors", folder / "detectors.csv",
            "--trajectory", course, "--scene", folder / "bench.yaml", "--set", UNIT,
            "-o", tmp_path / "no.yaml", code=1,
        )  # fmt: skip

    assert "it has no pose at the readings' times, 1.120 to 41.020 s" in told(late)
    late.write_text(text.replace("time_s", "t", 1))
    assert "no column time_s; give the time of each pose" in told(late)
    late.write_text("\n".join([head, *rows[::-1]]))
    assert "sort the rows by it" in told(late)
    late.write_text("\n".join([head, *rows[::40], ""]))
    assert "it has no pose at the readings' times" in told(late)  # gaps of 2 s
