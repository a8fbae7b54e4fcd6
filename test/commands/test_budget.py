"""``uuv_array budget`` by closed forms, data sheets and the commands that say the same."""

import dataclasses
import math
import re

import numpy as np
import pytest
import yaml
from command_line import assert_picture, run, text_of
from differences import differentiate
from scenes import changed, make_scene
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from uuv_optical_array.commands import budget
from uuv_optical_array.commands.limits import aligned, reach
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.information.tolerances import tolerances
from uuv_optical_array.forward.effects import electronics
from uuv_optical_array.forward.link_budget import Instrument, scene_with
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

FOLLOW = load_scene("follow")


def test_counts_of_a_planar_array_in_clear_water_are_those_of_the_inverse_square():
    scene = scene_with(make_scene("planar", effects={}), it := Instrument(lamp_w=0.02))
    sigma, range_m = math.radians(8), 5.6  # the array is 0.4 m ahead of base_link
    whole, _ = quad(lambda eta: math.exp(-((eta / sigma) ** 2) / 2) * math.sin(eta), 0, math.pi)
    watts_per_m2 = 0.02 * 0.85 / (2 * math.pi * whole) / range_m**2
    volts = watts_per_m2 * 0.8 * 7.5e-6 * 0.32 * it.feedback_ohm
    reading = ForwardModel(scene).light(aligned([6.0]))[0, 2, 2]
    assert reading == pytest.approx(volts / 1.2 * 65535 + 100, rel=1e-4)  # and the pedestal


def test_the_lamp_of_a_ready_scene_gives_its_own_counts_and_noise():
    """`coastal` says its photodiode, so its power follows from watts, and its noise too."""
    coastal = load_scene("coastal")
    diode = coastal.effects["photodiode"]
    it = Instrument(
        part=diode["part"],
        bits=10,
        pedestal_counts=0,
        full_scale_v=1023 * diode["amps_per_count"] * diode["load_ohm"],
        feedback_ohm=diode["load_ohm"],
        average_s=0.5 / diode["bandwidth_hz"],
        amplifier_v_per_rthz=0.0,
        converter_v_per_rthz=0.0,
        amplifier_a_per_rthz=diode["amplifier_a_per_rthz"],
    )
    model = ForwardModel(coastal)
    watts = model.power / it.counts_per_w_per_m2 / it.intensity(8.0) * it.lamp_w
    found = ForwardModel(scene_with(coastal, dataclasses.replace(it, lamp_w=watts)))
    poses = aligned([2.0, 5.0, 8.0])
    np.testing.assert_allclose(found.light(poses), model.light(poses), rtol=1e-5)
    np.testing.assert_allclose(found.noise[:4], model.noise[:4], rtol=1e-5)


@pytest.mark.parametrize(("shunt_ohm", "nep"), [(25e9, 2.0e-15), (5e9, 4.5e-15)])
def test_the_noise_in_the_dark_is_the_nep_of_a_data_sheet(shunt_ohm, nep, monkeypatch):
    """Hamamatsu G1735 and G1737: 0.4 A/W at their peak, noise of the shunt resistance alone."""
    part = electronics.PhotodiodePart(1.66e-6, 0.4, 0.0, shunt_ohm)
    monkeypatch.setitem(electronics.PARTS, "BPW34", part)
    others = "capacitance_f", "amplifier_v_per_rthz", "amplifier_a_per_rthz", "converter_v_per_rthz"
    circuit = {"feedback_ohm": 1e10, "bits": 4, "full_scale_v": 1e-3, **dict.fromkeys(others, 0)}
    it = Instrument(lamp_w=1e-6, average_s=0.5, temperature_c=25, **circuit)
    noise = ForwardModel(scene_with(changed(FOLLOW, prior={}), it)).analogue_noise
    load = 1 / (1 + shunt_ohm / 1e10)  # the shunt's part of the conductance
    amps = math.sqrt(noise.variance * load) * it.amps_per_count
    assert amps / 0.4 == pytest.approx(nep, rel=0.025, abs=0)  # the sheet has two digits


def test_the_amplifiers_noise_is_the_mean_over_the_band():
    it = Instrument(average_s=1e-4, feedback_ohm=2e6, capacitance_f=3e-10, converter_v_per_rthz=0)

    def density(f):
        gain = 1 + (2 * math.pi * f * 2e6 * 3e-10) ** 2
        return it.amplifier_a_per_rthz**2 + it.amplifier_v_per_rthz**2 * gain / (2e6) ** 2

    total, _ = quad(density, 0, 5000)
    assert it.amplifier_noise() == pytest.approx(math.sqrt(total / 5000), rel=1e-9, abs=0)


@pytest.mark.parametrize(
    ("watts", "nm", "group"),
    [(0.1, 525, 0), (0.5, 525, 1), (0.5, 450, 1), (2, 450, 2), (25, 525, 1), (99, 525, 3)],
)
def test_the_risk_group_is_that_of_the_radiance(watts, nm, group):
    """Limits of IEC 62471 for the lens of 30 mm, 0.1 rad or more at 0.2 m."""
    found, blue, thermal = Instrument(lamp_w=watts, wavelength_nm=nm).risk_group(8.0)
    radiance = watts * 0.85 / (2 * math.pi * math.radians(8) ** 2) / (math.pi * 0.015**2)
    weight = {525: 10 ** (-75 / 50), 450: 0.94}[nm]
    assert blue == pytest.approx(weight * radiance, rel=0.01)
    assert thermal == pytest.approx(radiance * max(1, 10 * weight if nm < 500 else 1), rel=0.01)
    assert found == group


@pytest.mark.usefixtures("sketched")
def test_the_keys_that_are_printed_make_the_scene_that_is_told(tmp_path):
    picture = tmp_path / "budget.png"
    words = ("--scene", "coastal", "--set", "daylight_w_per_m2=0.01", "--output", picture)
    out = text_of(run, "budget", *words)
    text = out[out.index("extends: ") : out.index("picture: ")]
    printed = yaml.safe_load(text)
    assert printed["effects"]["ambient"]["level_counts"] > 100
    assert printed["prior"]["ambient_std_counts"] == pytest.approx(5 * 65535 / 1023, rel=1e-4)
    (tmp_path / "sea.yaml").write_text(text, encoding="utf-8")
    scene, it = load_scene(tmp_path / "sea.yaml"), Instrument(daylight_w_per_m2=0.01)
    assert scene.fingerprint == scene_with(load_scene("coastal"), it).fingerprint
    light = ForwardModel(scene).light(aligned([4.0])).max()
    (row,) = [line.split() for line in out.splitlines() if line.startswith("        4")]
    assert float(row[1]) == pytest.approx(light, rel=5e-4)
    near, far = reach(scene)
    assert f"10 deg: {near:g} to {far:g} m" in out
    assert_picture(picture)


@pytest.mark.usefixtures("sketched")
def test_the_written_file_is_the_scene_that_is_told_from_any_folder(tmp_path):
    folder = tmp_path / "boat"
    folder.mkdir()
    picture = "--output", tmp_path / "budget.png"
    base = tmp_path / "water.yaml"
    base.write_text("extends: coastal\n", encoding="utf-8")
    for scene, extends in (("coastal", "coastal"), (base, "../water.yaml")):
        written = folder / f"{len(extends)}.yaml"
        out = text_of(run, "budget", "--scene", scene, "--write", written, *picture)
        assert f"scene: {written}" in out
        assert yaml.safe_load(written.read_text("utf-8"))["extends"] == extends
        expected = scene_with(load_scene(scene), Instrument()).fingerprint
        assert load_scene(written).fingerprint == expected
    line = run("budget", "--scene", base, "--write", base, *picture, code=2)
    assert "it is the scene that it would extend; name another file" in line
    assert base.read_text("utf-8").startswith("extends: coastal")


@pytest.mark.usefixtures("sketched")
def test_the_eyes_see_each_of_several_lamps_by_itself(tmp_path):
    told = {
        scene: text_of(run, "budget", "--scene", scene, "--output", tmp_path / "budget.png")
        for scene in ("follow", "leading_lights")
    }
    one, three = (float(re.search(r"blue light (\S+),", text).group(1)) for text in told.values())
    assert three == pytest.approx(one / 3, rel=0.01)
    assert told["leading_lights"].startswith("3 lamps: 0.33 W in a beam of 8 deg")


@pytest.mark.usefixtures("sketched")
def test_the_watts_for_a_reach_are_the_least(tmp_path):
    text = text_of(run, "budget", "--reach", 4.5, "--output", tmp_path / "budget.png")
    watts = float(text.split()[1])
    for factor, within in ((1.0, True), (0.99, False)):
        scene = scene_with(FOLLOW, Instrument(lamp_w=factor * watts))
        std = cramer_rao_bound(ForwardModel(scene), aligned([4.5])).std[0]
        assert (std <= [0.2, 0.2, 0.2, *np.radians([10, 10])]).all() == within
    line = run("budget", "--reach", 50, "--output", tmp_path / "budget.png", code=1)
    assert "no lamp reaches so far" in line


@pytest.mark.usefixtures("sketched")
def test_more_counts_than_a_scene_takes_are_refused(tmp_path):
    line = run(
        *("budget", "--set", "feedback_ohm=1", "--set", "feedback_ohm=1e9"),
        *("--output", tmp_path / "budget.png"),
        code=1,
    )
    assert "would read 1.32e+07 counts" in line
    assert "change the feedback resistor or the lamp" in line


@pytest.mark.parametrize("apart", ["y_m", "z_m"])
def test_across_and_angle_are_the_worse_of_two(apart):
    """Of two lamps side by side, or one above the other, which tell one axis better."""
    lamps = [{"y_m": 0.0, "z_m": 0.0, apart: place} for place in (-0.3, 0.3)]
    scene = changed("leading_lights", lamps=lamps)
    _, y, z, pitch, yaw = cramer_rao_bound(ForwardModel(scene), aligned([5.0])).std[0]
    assert (y < 0.95 * z and yaw < 0.95 * pitch) == (apart == "y_m")
    ((_, _, _, across, angle),) = budget.rows(scene, [5.0])
    assert across == pytest.approx(max(y, z))
    assert angle == pytest.approx(math.degrees(max(pitch, yaw)))


def test_errors_of_building_move_a_fit_as_told():
    """Fits by SciPy to the light of arrays with one wrong reading each, and of a larger sphere."""
    dim = Instrument(lamp_w=0.02)  # so that the pedestal is a large part of each reading
    scene = scene_with(changed("reference", prior={"known": "calibrated"}), dim)
    pose = np.array([-5.0, 0.3, -0.2, 0.1, -0.15])
    model, stds = ForwardModel(scene), scene.prior.nuisance_std()
    right = model.light(pose).ravel()
    lit = right - 100  # without the pedestal
    sigma = np.sqrt(model.variance(right)[0])
    prior = np.array(list(stds.values()))

    start = np.zeros(5 + len(stds))

    def misfit(at, light=right):
        offsets = dict(zip(stds, at[5:], strict=True))
        seen = model.light(pose + at[:5], offsets=offsets).ravel()
        return np.append((seen - light) / sigma, at[5:] / prior)

    slopes = differentiate(misfit, start)  # which so small errors do not change

    def moved(light):
        fit = least_squares(misfit, start, lambda at, _: slopes, x_scale="jac", args=(light,))
        return fit.x[:5]

    told = tolerances(scene, pose)
    gains = np.array([moved(right + 0.01 * lit * one) for one in np.eye(25)])
    # Shifted detectors see what a shifted vehicle sees, tilted ones another cosine.
    body = Rotation.from_euler("ZYX", [pose[4], pose[3], 0])
    shifts = [np.append(pose[:3] + 1e-3 * body.apply(axis), pose[3:]) for axis in np.eye(3)]
    array = model.array
    to_lamp = body.inv().apply(-pose[:3]) - array.positions
    tilts = [Rotation.from_rotvec(np.radians(1) * axis).apply(array.normals) for axis in np.eye(3)]

    def cosine(normals):
        return (normals * to_lamp).sum(axis=1)

    changes = {
        "each gain off by 1 %": [np.full(25, 0.01)],
        "each detector off by 1 mm": [model.light(at).ravel() / lit - right / lit for at in shifts],
        "each detector tilted by 1 deg": [cosine(n) / cosine(array.normals) - 1 for n in tilts],
    }
    for name, relative in changes.items():
        errors = [change[:, None] / 0.01 * gains for change in relative]
        expected = np.sqrt(np.square(errors).sum(axis=(0, 1)))
        np.testing.assert_allclose(told[name], expected, rtol=0.05, err_msg=name)
    larger = ForwardModel(changed(scene, array={"radius_m": scene.array.radius_m + 1e-3}))
    larger.power = model.power
    np.testing.assert_allclose(
        told["the sphere's radius off by 1 mm"],
        np.abs(moved(larger.light(pose).ravel())),
        rtol=0.05,
        atol=1e-4,
    )
    aligned_errors = tolerances(scene, aligned([6.0])[0])
    degree = np.radians(1)
    np.testing.assert_allclose(
        [aligned_errors[f"the {part} turned by 1 deg"] for part in ("lamp", "array")],
        [[0, 6 * degree, 6 * degree, degree, degree], [0, *[0.4 * degree] * 2, degree, degree]],
        atol=1e-9,
    )
