"""``uuv_array study approach``: paths and noise against theory, then real runs."""

import functools

import command_line
import numpy as np
import pytest
from command_line import json_of, text_of
from scenes import changed, coarse, with_prior
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.stats import kstest, norm, uniform

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, save_scene
from uuv_optical_array.studies import approach
from uuv_optical_array.studies.approach import (
    CASES,
    FRAMES,
    METHODS,
    ApproachErrors,
    as_object,
    assumed_scene,
    by_docking,
    draw_offsets,
    expose,
    gathered,
    simulate,
)

WIDTH = 10.23  # 1 % of 1023 counts


@pytest.fixture(scope="module")
def tank_file(tmp_path_factory):
    """The tank with a table that is quickly built."""
    path = tmp_path_factory.mktemp("scene") / "tank.yaml"
    save_scene(coarse("eren2017_tank"), path, "The tank.")
    return str(path)


@pytest.fixture(scope="module")
def tank(tank_file):
    return load_scene(tank_file)


@pytest.fixture
def cut(monkeypatch):
    """Return what leaves of the study the last so many frames of some cases."""

    def cut_to(frames, *names):
        monkeypatch.setattr(approach, "FRAMES", frames)
        for name in ("TIMES_S", "RANGES_M"):
            monkeypatch.setattr(approach, name, getattr(approach, name)[-frames:])
        cases = [CASES[name]._replace(path=CASES[name].path[-frames:]) for name in names]
        monkeypatch.setattr(approach, "CASES", dict(zip(names, cases, strict=True)))
        return cases

    return cut_to


run = functools.partial(command_line.run, "study", "approach")


def test_a_dive_goes_down_by_its_pitch_and_a_zigzag_leaves_and_comes_back():
    dive, path = CASES["dive"].path, CASES["zigzag"].path
    np.testing.assert_allclose(
        dive[[0, -1], :3], [[-8.5, 0, 0], [-4.5, 0, -4 * np.tan(np.pi / 18)]]
    )
    np.testing.assert_allclose(np.degrees(dive[:, 3:]), [[10, 0]] * 41)
    np.testing.assert_allclose(path[[0, -1], 1:3], [[-0.2, 0.1]] * 2)
    np.testing.assert_allclose(np.degrees(path[[0, -1], 4]), [-10, 10])

    def yaw_deg(seconds):
        return np.interp(seconds, [3, 5], [-10, 10])

    farthest, _ = quad(lambda s: 0.5 * np.tan(np.radians(yaw_deg(s))), 0, 4, points=[3])
    assert path[20, 1] == pytest.approx(-0.2 + farthest, abs=1e-3)


@pytest.mark.parametrize("name", CASES)
def test_the_vehicle_moves_along_its_heading(name):
    path = CASES[name].path
    ways = np.diff(path[:, :3], axis=0)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    middle = (path[1:, 3:] + path[:-1, 3:]) / 2
    headings = Rotation.from_euler("ZY", middle[:, ::-1]).apply([1, 0, 0])
    np.testing.assert_allclose(ways, headings, atol=1e-4)


def test_offsets_have_the_papers_spread():
    drawn = draw_offsets(20_000, np.random.default_rng(1))
    degrees = np.expm1(drawn["lamp.power"]) / (-2 / 576)
    for values, std in ((degrees, 3), (drawn["attenuation.k_per_m"], 0.015)):
        assert kstest(values, norm(0, std).cdf).pvalue > 1e-3
    both = np.corrcoef(drawn["lamp.power"], drawn["attenuation.k_per_m"])[0, 1]
    assert abs(both) < 4 / np.sqrt(20_000)


def test_noise_is_uniform_and_the_estimator_assumes_its_spread(tank):
    case = CASES["zigzag"]
    scene = assumed_scene(tank, case)
    # Without the converter, whose rounding is taken into account apart.
    analogue = changed(scene, effects={"adc": None})
    rng = np.random.default_rng(2)
    sea = draw_offsets(30, rng)
    plain = ForwardModel(analogue)
    images = expose(plain, case.path, sea, rng)
    assert images.shape == (30, FRAMES, 5, 5)
    assert scene.effects["ambient"]["level_counts"] == pytest.approx(WIDTH / 2)
    lit = ForwardModel(changed(analogue, effects={"ambient": {"level_counts": 0.0}}))
    std = WIDTH / 12**0.5
    for index in range(30):
        off = {name: np.full(FRAMES, values[index]) for name, values in sea.items()}
        residual = (images[index] - lit.light(case.path, 0.0, off))[images[index] < 1000]
        assert kstest(residual, uniform(0, WIDTH).cdf).pvalue > 1e-4
        assert residual.min() >= 0
        assert residual.max() <= WIDTH
    # The variance that the estimator assumes of a reading, rounding included.
    variance, slope = ForwardModel(scene).variance(np.array(500.0))
    assert variance == pytest.approx(std**2 + 1 / 12, rel=1e-9)
    assert slope == 0


def test_the_lamp_stays_the_same_in_murkier_water(tank):
    clear, murky = (assumed_scene(tank, CASES[name]) for name in ("zigzag", "zigzag, murky"))
    poses = CASES["zigzag"].path
    clear_light, murky_light = (
        ForwardModel(scene).light(poses) - scene.effects["ambient"]["level_counts"]
        for scene in (clear, murky)
    )
    brightest = clear_light.max(axis=(1, 2)), murky_light.max(axis=(1, 2))
    lost_m = np.log(brightest[0] / brightest[1]) / 0.11
    # The brightest detector sits on the sphere, 0.19 m in front of base_link.
    np.testing.assert_allclose(lost_m, np.linalg.norm(poses[:, :3], axis=1) - 0.19, atol=0.02)


def test_a_scene_without_attenuation_is_refused(tank):
    clear = changed(with_prior(tank, k_std_per_m=0.0), effects={"attenuation": None})
    with pytest.raises(ValueError, match=r"no effects.attenuation; add it"):
        assumed_scene(clear, CASES["dive"])


def test_statistics_of_planted_errors_are_the_closed_ones():
    rng = np.random.default_rng(3)
    bound = rng.uniform(0.1, 2, (FRAMES, 5))
    errors = 0.5 + 2 * bound * rng.standard_normal((4000, FRAMES, 5))
    errors[7, 3] = np.nan
    result = ApproachErrors(dict.fromkeys(METHODS, errors), bound, bound)
    assert as_object(CASES["dive"], result)["runs"] == 4000
    found = as_object(CASES["dive"], result)["methods"]["docking"]
    in_degrees = np.array([1, 1, 1, 180 / np.pi, 180 / np.pi])

    def of(key):
        return np.array(list(found[key].values())) / in_degrees

    assert found["without_pose"] == 1
    np.testing.assert_allclose(of("mean_end"), 0.5, atol=0.35)
    ratio = np.array([list(values.values()) for values in found["ratio_to_bound"].values()])
    np.testing.assert_allclose(ratio, np.sqrt(4 + (0.5 / bound[::5]) ** 2), rtol=0.06)
    np.testing.assert_allclose(of("end_95_about_mean"), 1.96 * 2 * bound[-1], rtol=0.1)
    for key, frame in (("start_95", 0), ("end_95", -1)):
        both = norm(0.5, 2 * bound[frame])
        within = both.cdf(of(key)) - both.cdf(-of(key))
        np.testing.assert_allclose(within, 0.95, atol=0.02)


def test_a_run_whose_first_frame_has_no_pose_gets_none_from_the_smoother(monkeypatch):
    def docking(motion, images, first):
        assert len(images) == len(first) == 1
        return np.broadcast_to(first[:, None], (1, FRAMES, 5)), None, None

    monkeypatch.setattr(approach, "smoothed", docking)
    first = np.array([[np.nan] * 5, [1.0] * 5])
    poses = by_docking(None, np.zeros((2, FRAMES, 5, 5)), first)
    assert np.isnan(poses[0]).all()
    assert (poses[1] == 1).all()


@pytest.mark.usefixtures("sketched")
def test_json_has_every_case_and_method_and_a_seed_fixes_it(tank, tank_file, tmp_path, cut):
    (dive,) = cut(11, "dive")
    picture = tmp_path / "approach.png"
    result = json_of(run, "--scene", tank_file, "--runs", 1, "--output", picture)
    assert result["picture"] == str(picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    batches = list(simulate(tank, dive, 2, np.random.default_rng(1), batch=1))
    assert [errors.shape for errors in batches] == 2 * [(len(METHODS), 1, 11, 5)]
    again = gathered(tank, dive, batches)
    assert len(again.errors["moments"]) == 2
    assert result["cases"]["dive"] == as_object(dive, gathered(tank, dive, batches[:1]))
    assert (result["asked_runs"], result["seed"]) == (1, 1)
    (case,) = result["cases"].values()
    assert case["runs"] == 1
    assert case["published"]["end_95"]["x_m"] == CASES["dive"].end_95[0]
    assert case["published"]["start_95"]["yaw_deg"] is None
    assert list(case["methods"]) == list(METHODS)
    for values in case["methods"].values():
        assert all(np.isfinite(number) for number in values["end_95"].values())
        assert list(values["ratio_to_bound"])[-1] == "4.5 m"
    # The estimators that look at the whole image find the lamp.
    assert abs(case["methods"]["docking"]["mean_end"]["x_m"]) < 0.5


@pytest.mark.usefixtures("sketched")
def test_a_case_that_was_cut_short_is_the_last_and_is_printed(
    tank_file, tmp_path, monkeypatch, cut
):
    cut(11, *CASES)

    def simulate(scene, case, runs, rng):
        yield np.zeros((len(METHODS), 2, 11, 5))
        if len(seen) == 1:
            raise KeyboardInterrupt
        seen.append(case)

    seen = []
    monkeypatch.setattr(approach, "simulate", simulate)
    words = ("--scene", tank_file, "--runs", 3, "--output", tmp_path / "cut.png")
    text = text_of(run, *words, code=130)
    assert text.endswith("interrupted: only complete runs count\n")
    assert "dive, runs: 2" in text
    assert "zigzag, runs: 2" in text
    assert "murky" not in text
    # The aim: a fifth of 0.43, 0.20 and 0.28 m, and angles as published.
    aim = next(line for line in text.splitlines() if "the aim" in line)
    assert aim.split()[2:] == ["0.086", "0.040", "0.056", "1.000", "1.000"]


def test_the_docking_smoother_beats_the_tracker_and_single_images(tank, cut):
    (dive,) = cut(21, "dive")  # from 6.5 m on
    result = gathered(tank, dive, list(simulate(tank, dive, 5, np.random.default_rng(6))))
    last = {m: np.sqrt(np.nanmean(result.errors[m][:, -10:] ** 2, axis=(0, 1))) for m in METHODS}
    assert (last["docking"][1:] < last["least_squares"][1:]).all()
    assert (last["docking"][:3] < last["moments"][:3] / 3).all()
    squares = np.mean(result.errors["least_squares"] ** 2, axis=0) / result.bound**2
    ratio = np.sqrt(np.mean(squares))
    # 5 runs of 21 frames, each with nuisances of its own.
    assert 0.7 < ratio < 1.3
