"""Calibration: beside a second implementation, its standard errors, and what it cannot know."""

import functools
import re

import numpy as np
import pytest
import second_forward
from calibrated_seas import (
    AIMS,
    HIGHEST,
    LOWEST,
    TURNED,
    check_consistency,
    drive,
    largest_pull,
    named,
    pulls,
    recorded,
    sea,
    seen,
    truth_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import changed
from scipy import optimize, stats

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import reading_variance
from uuv_optical_array.forward.scene import load_scene, save_scene

reproducible = settings(max_examples=8)


def test_light_and_least_squares_written_a_second_time_find_the_same():
    """All of it again, with SciPy's solver, gains by their logarithm and the gauge by the mean."""
    no_limits = {"saturation": None, "adc": None}
    scene, start = (
        changed(some, effects=no_limits) for some in (sea(gains=(0.08, 4)), "reference")
    )
    images, poses, rolls = recorded(scene, 12, 2, TURNED)
    found = calibrate(start, images, poses, rolls)

    readings, plain = images.reshape(12, 25), start.settings()
    names = [
        *("lamp.power", "lamp.beam_sigma_deg", "attenuation.k_per_m", "ambient.level_counts"),
        *("field_of_view.cosine_power", "array.radius_m", *AIMS),
    ]
    count = len(names)

    @functools.cache
    def unit_light(sigma_deg, k, cosine_power, log_radius, *aims):
        water = {"attenuation": {"k_per_m": k}}
        offsets = {
            "lamp.beam_sigma_deg": sigma_deg - plain["lamp"]["beam_sigma_deg"],
            "field_of_view.cosine_power": cosine_power - 1,
            "array.radius_m": log_radius - np.log(plain["array"]["radius_m"]),
        }
        views = zip(*seen(poses, rolls, aims, plain["array"]["bow_m"]), strict=True)
        return np.array(
            [
                second_forward.image_of(plain, 1.0, water, pose, roll, offsets=offsets).ravel()
                for pose, roll in views
            ]
        )

    def residuals(x):
        gains = np.exp(x[count:] - x[count:].mean())
        light = np.exp(x[0]) * unit_light(x[1], x[2], *x[4:count]) + x[3]
        return np.append((readings - gains * light).ravel(), x[count:].sum())

    first = [9.0, 8.0, 0.1, 0.0, 1.0, np.log(0.32), *np.zeros(4), *np.zeros(25)]
    other = optimize.least_squares(residuals, first, x_scale="jac")
    covariance = np.linalg.inv(other.jac.T @ other.jac)
    units = np.ones(count)
    units[[0, 5]] = np.exp(other.x[[0, 5]])
    values = np.where(units == 1, other.x[:count], units)
    std = np.sqrt(np.diag(covariance)[:count]) * units
    parameters = [named(found)[name] for name in names]
    np.testing.assert_allclose([p.std for p in parameters], std, rtol=5e-3)
    np.testing.assert_allclose(([p.value for p in parameters] - values) / std, 0, atol=0.01)
    gains = np.exp(other.x[count:] - other.x[count:].mean())
    np.testing.assert_allclose(found.gains.ravel(), gains, rtol=1e-5)
    project = np.eye(25) - 1 / 25
    gain_std = gains * np.sqrt(np.diag(project @ covariance[count:, count:] @ project))
    np.testing.assert_allclose(found.gain_std.ravel(), gain_std, rtol=5e-3)
    freedoms = readings.size - count - 24
    assert found.misfit == pytest.approx((residuals(other.x) ** 2).sum() / freedoms, rel=1e-6)


POSE_STD = np.array([0.02, 0.02, 0.02, 0.01, 0.01])


@pytest.mark.parametrize(
    ("name", "fits", "count", "pose_std"),
    [("follow", 12, 60, None), ("reference", 12, 40, POSE_STD)],
    ids=["scattering", "absorbing, with errors of poses"],
)
def test_errors_are_as_large_as_the_standard_errors_say(name, fits, count, pose_std):
    rng = np.random.default_rng(11)
    misfit = check_consistency(lambda _: sea(name), sea(name), fits, count, rng, pose_std)
    assert misfit == pytest.approx(1.0, abs=5 * np.sqrt(2 / (fits * (25 * count - 25))))


def test_so_they_are_with_noise_that_grows_with_the_light_and_readings_at_both_limits():
    """A lamp so bright that a part of the readings is saturated, a sea so dark that many are 0."""
    scene = sea(
        lamp__reference_counts=4000.0,
        lamp__beam_sigma_deg=4.0,
        attenuation__k_per_m=0.25,
        ambient__level_counts=0.1,
        shot_noise__electrons_per_count=20.0,
    )
    start = sea(gains=None, ambient__level_counts=0.3, shot_noise__electrons_per_count=20.0)
    rng = np.random.default_rng(12)
    poses, rolls = drive(rng, 2000)
    images = ForwardModel(scene).expose(poses, rng, rolls)
    assert (images == 0).mean() > 0.03
    assert (images == 1023).mean() > 0.03
    check_consistency(lambda _: scene, start, 12, 40, rng)


def test_a_pose_that_is_off_by_far_more_than_told_is_left_out_and_errors_not_told_are_noticed():
    scene, start = sea(), load_scene("reference")
    images, poses, rolls = recorded(scene, 80, seed=15)
    errors = np.random.default_rng(15).normal(size=poses.shape)
    told = poses + errors * POSE_STD
    told[21, 4] += 0.12  # twelve standard deviations of the yaw
    found = calibrate(start, images, told, rolls, pose_std=POSE_STD)
    assert found.outlying_images == (21,)
    assert largest_pull(found, scene) < 5
    found = calibrate(start, images, poses + 0.02 * errors, rolls)
    assert found.misfit > 10
    for words in ("correlated", "does not explain"):
        assert any(words in note for note in found.notes)


@reproducible
@given(
    sigma=st.floats(4.0, 20.0),
    reference=st.floats(150.0, 1500.0),
    k=st.floats(0.0, 0.4),
    ambient=st.floats(0.0, 200.0),
    spread=st.floats(0.0, 0.2),
    seed=st.integers(0, 1000),
    planar=st.booleans(),
)
def test_any_sea_is_found_from_the_ready_scene(sigma, reference, k, ambient, spread, seed, planar):
    start = load_scene("reference")
    scene = sea(
        gains=(spread, seed),
        lamp__beam_sigma_deg=sigma,
        lamp__reference_counts=reference,
        attenuation__k_per_m=k,
        ambient__level_counts=ambient,
    )
    if planar:
        array = {"shape": "planar", "detectors_per_side": 9, "radius_m": None}
        start, scene = (changed(some, array=array) for some in (start, scene))
    found = calibrate(start, *recorded(scene, 60, seed))
    assert largest_pull(found, scene) < 5.5
    assert found.misfit == pytest.approx(1.0, abs=0.2)


def test_the_written_scene_reads_back_and_gives_the_light_of_the_fit(tmp_path):
    start = load_scene("coastal")  # a water type, a spread
    images, poses, rolls = recorded(sea("coastal"), 50, 5, TURNED)
    found = calibrate(start, images, poses, rolls)
    save_scene(found.scene, tmp_path / "found.yaml", "Found.")
    again = load_scene(tmp_path / "found.yaml")
    assert again.settings() == found.scene.settings()
    # The lamp and the array of a scene are straight.
    aims = [named(found)[name].value for name in AIMS]
    light = ForwardModel(again).light(*seen(poses, rolls, aims, again.array.bow_m))
    light, noise = light.reshape(50, 25), ForwardModel(start).noise._replace(square=0.0)
    residuals = (images.reshape(50, 25) - light) / np.sqrt(reading_variance(light, noise))
    within = found.uncensored
    np.testing.assert_allclose(residuals[within], found.residuals[within], atol=1e-5)
    fixed = {"sea", "field_of_view", "ambient", "responsivity"}
    for name in again.effects.keys() - fixed:
        assert again.effects[name] == start.effects[name]
    dark = changed(again, effects={"ambient": {"level_counts": 0.0}})
    aligned = ForwardModel(dark).light([-4.0, 0, 0, 0, 0])
    reference = named(found)["lamp.reference_counts"]
    assert aligned.max() == pytest.approx(reference.value, rel=1e-7)
    power = named(found)["lamp.power"].value
    common = stats.gmean(again.effects["responsivity"]["gains"], axis=None)
    assert ForwardModel(again).power * common == pytest.approx(power, rel=1e-7)
    # Fitted again from its own answer it stays there.
    same = calibrate(again, images, poses, rolls)
    assert_same(same, found)


def assert_same(found, other):
    for name, parameter in named(found).items():
        off = parameter.value - named(other)[name].value
        assert abs(off) < 1e-3 * parameter.std, name


def test_one_range_does_not_tell_attenuation_from_power():
    rng = np.random.default_rng(7)
    poses, _ = drive(rng, 60)
    poses[:, :3] *= (6.0 / np.linalg.norm(poses[:, :3], axis=1))[:, None]
    # Level and of one attitude, so that each detector has one range too.
    poses[:, 3:] = 0.0
    scene = sea()
    images = ForwardModel(scene).expose(poses, rng)
    found = calibrate(load_scene("reference"), images, poses)
    power, k = (named(found)[name] for name in ("lamp.power", "attenuation.k_per_m"))
    assert (k.value, k.note) == (0.1, "not known")
    assert np.isnan(k.std)
    assert power.note == "only together with attenuation.k_per_m"
    # By hand: it takes up 0.02 /m of K over about 5.4 m from the lamp to the detectors.
    assert power.std / power.value == pytest.approx(0.02 * 5.4, rel=0.05)
    note = next(note for note in found.notes if note.startswith("attenuation.k_per_m is not known"))
    array = scene.settings()["array"]
    rays = [ray for pose in poses for ray in second_forward.rays(array, pose)]
    bright = 1 / (ForwardModel(scene).power * np.exp(-0.17 * 5.4))  # a count, that of the noise
    ranges = [ray.range_m for ray in rays if second_forward.ideal(ray, 6.5) > bright]
    told = [float(number) for number in re.findall(r"\d\.\d\d", note)]
    expected = [np.min(ranges), np.max(ranges), np.max(ranges) / np.min(ranges)]
    assert told == pytest.approx(expected, abs=0.1)
    assert "factor of 2" in note
    assert np.isnan(found.correlation[2]).all()
    # Held at its true value, the power is the true one.
    told = sea(gains=None, ambient__level_counts=0.0)
    held = calibrate(told, images, poses, hold=["attenuation.k_per_m"])
    assert named(held)["attenuation.k_per_m"].note == "held"
    assert named(held)["lamp.power"].note == ""
    assert abs(pulls(held, scene)[0]["lamp.power"]) < 5


def test_a_detector_that_saw_no_lamp_keeps_its_gain_and_is_named():
    """Turned far to port, the outer starboard detectors of the sphere never see the lamp."""
    rng = np.random.default_rng(9)
    low, high = LOWEST.copy(), HIGHEST.copy()
    low[4], high[4] = 1.05, 1.15
    low[0], high[0] = -6.0, -3.0
    poses, rolls = drive(rng, 150, low, high)
    start = load_scene("reference")
    scene = sea(ambient__level_counts=0.0)
    seen = ForwardModel(scene).light(poses, rolls).max(axis=0)
    dark = seen < 1e-9
    assert 2 <= dark.sum() <= 20
    found = calibrate(start, ForwardModel(scene).expose(poses, rng, rolls), poses, rolls)
    assert np.isnan(found.gain_std[dark]).all()
    np.testing.assert_allclose(found.gains[dark], 1.0)
    bright = seen > 30
    assert np.isfinite(found.gain_std[bright]).all()
    row, column = np.argwhere(dark)[0]
    assert any(f"[{row}, {column}]" in note and "turn and shift" in note for note in found.notes)
    # And its gain is still none of the mean.
    known = np.isfinite(found.gain_std)
    assert stats.gmean(found.gains[known]) == pytest.approx(1.0)


def test_no_light_at_all_is_an_error_that_says_what_to_do():
    rng, far = np.random.default_rng(10), np.array([35.0, 0, 0, 0, 0])
    poses, rolls = drive(rng, 40, LOWEST - far, HIGHEST - far)
    images = ForwardModel(sea()).expose(poses, rng, rolls)
    with pytest.raises(ValueError, match="too little light of the lamp; record closer"):
        calibrate(load_scene("reference"), images, poses, rolls)


@pytest.mark.parametrize(
    ("sigma", "reference", "k", "count"),
    [
        (8.0, 2.0, 0.1, 8),
        (1.5, 900.0, 1.0, 80),
        (60.0, 20000.0, 0.0, 8),
        (20.0, 900.0, 3.0, 8),
        (2.0, 1.0, 1.0, 8),
    ],
)
def test_a_start_that_is_far_off_does_not_hide_what_can_be_known(sigma, reference, k, count):
    scene = sea()
    images, poses, rolls = recorded(scene, count, seed=16)
    start = sea(
        gains=None,
        lamp__reference_counts=reference,
        lamp__beam_sigma_deg=sigma,
        attenuation__k_per_m=k,
    )
    found = calibrate(start, images, poses, rolls)
    assert largest_pull(found, scene) < 5
    assert found.used.all()


def test_bad_frames_are_left_out_counted_and_named_and_do_no_harm():
    scene = sea()
    images, poses, rolls = recorded(scene, 120, seed=17)
    images[10] = 0.0  # the lamp was off
    images[30] = images[31]  # a frame that came again with another stamp
    images[77] = 1023.0  # somebody's torch
    images[5, 2, 3] += 40.0  # single spikes
    images[99, 0, 0] += 300.0
    found = calibrate(load_scene("reference"), images, poses, rolls)
    assert found.outlying_images == (10, 30, 77)
    assert found.outliers == 2
    assert not found.used[5, 13]
    assert not found.used[99, 0]
    assert found.used.sum() == 117 * 25 - 2
    assert largest_pull(found, scene) < 5
    assert found.misfit == pytest.approx(1.0, abs=0.15)


def test_a_dead_detector_is_noticed_and_one_that_the_scene_names_is_left_out():
    scene = sea()
    images, poses, rolls = recorded(scene, 60, seed=18)
    images[:, 1, 4], images[:, 3, 0] = 0.0, 512.0
    found = calibrate(load_scene("reference"), images, poses, rolls)
    bad = np.zeros((5, 5), dtype=bool)
    bad[1, 4] = bad[3, 0] = True
    np.testing.assert_array_equal(np.isnan(found.gain_std), bad)
    assert [note.split(" counts")[0] for note in found.notes] == [
        "detector [1, 4] always reads 0",
        "detector [3, 0] always reads 512",
    ]
    off, _ = pulls(found, scene)
    del off["lamp.power"], off["lamp.reference_counts"], off["ambient.level_counts"]
    assert np.abs(list(off.values())).max() < 4
    faults = {"dead": [[1, 4]], "stuck": [[3, 0]], "stuck_counts": 512.0}
    start = changed("reference", effects={"detector_faults": faults})
    again = calibrate(start, images, poses, rolls)
    assert not again.notes
    assert_same(again, found)
    assert again.scene.effects["detector_faults"] == faults


def test_a_background_that_would_be_negative_is_at_its_bound():
    rng = np.random.default_rng(19)
    scene = changed(sea(ambient__level_counts=0.0), effects={"adc": None})
    for _ in range(4):
        poses, rolls = drive(rng, 60)
        images = ForwardModel(scene).expose(poses, rng, rolls) - 0.5  # an amplifier's offset
        found = calibrate(scene, images, poses, rolls)
        background = named(found)["ambient.level_counts"]
        assert (background.value, background.note) == (0.0, "at its bound")
        assert background.std > 0


@pytest.mark.parametrize(("true", "started"), [(2.0, 0.5), (0.4, 3.0), (1.0, 0.0)])
def test_noise_is_found_from_the_residuals(true, started):
    scene = sea(sensor_noise__sigma_counts=true)
    images, poses, rolls = recorded(scene, 200, seed=20)
    start = sea(gains=None, sensor_noise__sigma_counts=started)
    found = calibrate(start, images, poses, rolls, fit_noise=True)
    noise = named(found)["sensor_noise.sigma_counts"]
    assert noise.start == started
    assert abs(noise.value - true) < 4 * noise.std
    # That of a standard deviation from n numbers, but for the rounding.
    total = true**2 + 1 / 12
    assert noise.std == pytest.approx(total / true / np.sqrt(2 * 5000), rel=0.1)
    assert found.scene.effects["sensor_noise"]["sigma_counts"] == noise.value
    assert found.misfit == pytest.approx(1.0, abs=1e-3)
    assert largest_pull(found, scene) < 5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"images": np.zeros((3, 4, 4))}, "images: shape"),
        ({"images": np.zeros((0, 5, 5)), "poses": np.zeros((0, 5))}, "images: shape"),
        ({"images": np.full((3, 5, 5), np.nan)}, "images: not finite"),
        ({"poses": np.zeros((2, 5))}, "poses: shape"),
        ({"poses": np.full((3, 5), np.inf)}, "poses: not finite"),
        ({"pose_std": [0.1, 0.1, 0.1]}, "pose_std: .0.1, 0.1, 0.1.; give five numbers > 0"),
        ({"pose_std": [0.1, 0.1, 0.1, 0.0, 0.1]}, "give five numbers > 0"),
        ({"hold": ["lamp"]}, "hold lamp: unknown; choose from lamp.power"),
        ({"fit_noise": True, "scene": load_scene("ideal")}, "no effects.sensor_noise"),
    ],
)
def test_bad_input_is_refused_by_name(change, words):
    given = {
        "scene": load_scene("reference"),
        "images": np.full((3, 5, 5), 10.0),
        "poses": np.tile([-5.0, 0, 0, 0, 0], (3, 1)),
        **change,
    }
    with pytest.raises(ValueError, match=words.replace("(", r"\(")):
        calibrate(**given)


@pytest.mark.parametrize(
    "held",
    [
        ("lamp.power", "attenuation.k_per_m", *AIMS[:2]),
        ("lamp.beam_sigma_deg", "array.radius_m", "ambient.level_counts", "gains"),
    ],
)
def test_what_is_held_stays(held):
    start = sea(gains=(0.03, 2), lamp__reference_counts=620.0)
    found = calibrate(start, *recorded(sea(), 40, seed=22), held)
    values, gains = truth_of(start)
    assert np.isnan(found.gain_std).all() == ("gains" in held)
    assert np.allclose(found.gains, gains) == ("gains" in held)
    for parameter in found.parameters:
        assert (parameter.note == "held") == (parameter.name in held)
        assert np.isnan(parameter.std) == (parameter.name in held)
        same = parameter.value == pytest.approx(values[parameter.name], rel=1e-9)
        assert same == (parameter.name in held)
