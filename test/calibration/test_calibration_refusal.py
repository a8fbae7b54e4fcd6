"""Calibrations that refuse: wrong models, drives that tell too little, and what the scene keeps."""

import re

import numpy as np
import pytest
from bags import drive_messages, write_bag
from calibrated_seas import AIMS, drive, exposed, largest_pull, named, pulls, recorded, sea
from command_line import run, text_of
from needs import rosbags
from scenes import changed
from scipy import stats

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.calibration.fit.fit import CalibrationFit
from uuv_optical_array.calibration.likelihood.likelihood import CalibrationLikelihood
from uuv_optical_array.calibration.likelihood.parameters import (
    BACKGROUND,
    COSINE_POWER,
    KINDS,
    LAMP_AIM,
    POWER,
    SCATTER,
    SIGMA,
    SIZE,
    K,
)
from uuv_optical_array.calibration.notes import notes_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import (
    ABSORPTION,
    AMBIENT,
    BEAM_SIGMA,
    PRIORS,
    RADIUS,
    RESPONSE,
    SCATTERING,
)
from uuv_optical_array.forward.scene import load_scene, save_scene, scene_from_settings

HELD = RESPONSE, RADIUS, *AIMS
MIRRORED = np.array([1.0, -1.0, -1.0, -1.0, -1.0])  # other axes: y and z, pitch and yaw


def scene_of(lamp=(), prior="calibrated", **effects):
    """Return `reference` with nine detectors and a background, to be fast, and other values."""
    effects = {"ambient": {"level_counts": 10.0}, **effects}
    groups = {"array": {"detectors_per_side": 3}, "lamp": dict(lamp), "prior": {"known": prior}}
    return changed("reference", **groups, effects=effects)


def still(count):
    return np.tile([-5.0, 0.0, 0.0, 0.0, 0.0], (count, 1))


@pytest.mark.parametrize("fit_noise", [False, True])
def test_a_model_with_the_wrong_axes_is_refused_and_the_right_one_is_not(fit_noise):
    images, poses, rolls = recorded(scene_of(), 15, seed=1)
    assert not calibrate(scene_of(), images, poses, rolls, fit_noise=fit_noise).refusal
    found = calibrate(scene_of(), images, poses * MIRRORED, rolls, fit_noise=fit_noise)
    assert found.misfit > 100
    for word in ("does not explain", "degrees of freedom", "odometry_axes"):
        assert word in found.refusal
    assert "--noise" not in found.refusal


@pytest.mark.parametrize(("sigma", "refused"), [(1.5, False), (3.0, True)])
def test_noise_beyond_that_of_the_scene_widens_the_errors_and_beyond_twice_is_refused(
    sigma, refused
):
    scene = scene_of(sensor_noise={"sigma_counts": sigma})
    drive = recorded(scene, 100, seed=2)
    found, told = (calibrate(scene_of(), *drive, fit_noise=fit) for fit in (False, True))
    assert bool(found.refusal) is refused
    assert ("give --noise" in found.refusal) is refused
    assert not told.refusal
    assert found.misfit == pytest.approx((sigma**2 + 1 / 12) / (1 + 1 / 12), rel=0.1)
    notes = " ".join(found.notes)
    assert "does not explain the data" in notes
    (noise,) = re.findall(r"sensor_noise\.sigma_counts (\S+) and \S+ \S+ would explain", notes)
    assert float(noise) == pytest.approx(sigma, rel=0.05)
    assert largest_pull(found, scene) < 5.5
    for name, parameter in named(found).items():  # as large as with the noise that there is
        assert parameter.std == pytest.approx(named(told)[name].std, rel=0.05), name


def test_a_drive_that_stands_still_leaves_the_gains_as_they_were():
    """The beam is not known from one place, so neither are gains that would take it up."""
    rng = np.random.default_rng(5)
    gains = {"spread": 0.02, "seed": 7}
    start = scene_of(responsivity=gains)
    for lamp, limit in (({}, 1.3), ({"beam_sigma_deg": 7.5}, np.inf)):
        images = ForwardModel(scene_of(lamp, responsivity=gains)).expose(still(60), rng)
        found = calibrate(start, images, still(60))
        drawn = 1 + 0.02 * np.random.default_rng(7).standard_normal((3, 3))
        np.testing.assert_allclose(found.gains, drawn / stats.gmean(drawn, axis=None))
        assert np.isnan(found.gain_std).all()
        assert found.misfit < limit
        text = " ".join(found.notes)
        # A corner of the array, by hand: 0.2 m aside and 0.2 m up, at 4.6 m less 0.15 m of bulge.
        assert "lamp.beam_sigma_deg is not known: record poses up to 16 deg" in text
        assert "here lit detectors were up to 3.6 deg off the beam's axis" in text
        assert "the gains are not known" in text
    assert found.misfit > 1.2
    assert "each detector has the same error in all images" in text
    # No noise explains what is the same in every image.
    images = ForwardModel(scene_of({"beam_sigma_deg": 6.0}, responsivity=gains)).expose(
        still(60), rng
    )
    assert calibrate(start, images, still(60), fit_noise=True).refusal


def rig_like(start, rng):
    """Return a scene off in all that a calibration may hold, by as much as it takes that to be."""
    settings = start.settings()
    lamp, array, effects = settings["lamp"], settings["array"], settings["effects"]

    def off(kind):
        return KINDS[kind].largest * rng.standard_normal()

    lamp["beam_sigma_deg"] *= np.exp(off(SIGMA))
    lamp["reference_counts"] *= np.exp(off(POWER))
    array["radius_m"] *= np.exp(off(SIZE))
    effects["sea"]["absorption_per_m"] += off(K)
    effects["sea"]["scattering_per_m"] *= np.exp(off(SCATTER))
    effects["field_of_view"] = {"cosine_power": 1 + off(COSINE_POWER)}
    effects["ambient"] = {"level_counts": abs(off(BACKGROUND)) * start.full_scale_counts}
    effects["responsivity"] = {"spread": 0.01, "seed": int(rng.integers(10**6))}
    aims = KINDS[LAMP_AIM[0]].largest * rng.standard_normal(4)
    return scene_from_settings(settings, "rig"), aims


@pytest.mark.parametrize(
    ("near_m", "far_m", "aside_m", "swing", "unknown"),
    [
        (6.0, 6.0, 0.0, 0.0, {BEAM_SIGMA, ABSORPTION, SCATTERING, *HELD, AMBIENT}),
        (3.0, 8.0, 0.0, 0.0, {SCATTERING}),
        (3.0, 8.0, 0.8, 0.0, set()),
        (6.0, 6.0, 0.8, 0.1, {ABSORPTION}),
    ],
    ids=["on one spot", "on the axis", "without a turn", "at one range"],
)
def test_a_poor_drive_names_what_it_does_not_tell_and_the_errors_hold_it(
    near_m, far_m, aside_m, swing, unknown
):
    rng, squares = np.random.default_rng(12), []
    high = np.array([0.0, aside_m, aside_m, swing, swing])
    start, fits = load_scene("follow"), 4
    for _ in range(fits):
        scene, aims = rig_like(start, rng)
        poses = rng.uniform(-high, high, (80, 5))
        ranges = rng.uniform(near_m, far_m, 80)
        poses[:, 0] = -np.sqrt(ranges**2 - (poses[:, 1:3] ** 2).sum(axis=1))
        found = calibrate(start, exposed(scene, poses, rng, aims=aims), poses)
        assert {name for name, one in named(found).items() if one.note == "not known"} == unknown
        assert all(
            any(note.startswith(f"{name} is not") for note in found.notes) for name in unknown
        )
        off, of_gains = pulls(found, scene, aims)
        squares.append({name: pull**2 for name, pull in off.items()})
        if of_gains.size:
            squares[-1]["gains"] = np.mean(of_gains**2)
    low, high = stats.chi2.ppf(stats.norm.cdf([-4, 4]), fits) / fits
    for name in squares[0]:
        mean = np.mean([square[name] for square in squares])
        assert low < mean < high, name


@pytest.mark.parametrize("seed", [0, 2, 5])
def test_what_is_not_known_was_held_and_what_is_known_was_fitted(seed):
    """In the light of a dim lamp, at one range, some are determined at one place of a fit alone."""
    rng = np.random.default_rng(seed)
    start = changed("follow", lamp={"reference_counts": 60.0})
    scene, aims = rig_like(start, rng)
    poses = rng.uniform([-6, -0.8, -0.8, -0.1, -0.1], [-6, 0.8, 0.8, 0.1, 0.1], (60, 5))
    poses[:, 0] = -np.sqrt(36 - (poses[:, 1:3] ** 2).sum(axis=1))
    found = calibrate(start, exposed(scene, poses, rng, aims=aims), poses)
    for parameter in found.parameters:
        held = parameter.value == parameter.start
        assert held == (parameter.note == "not known"), parameter.name
    assert largest_pull(found, scene, aims) < 5.5


def test_a_long_bent_valley_is_followed_to_its_end():
    """On the axis gains, response, radius and beam nearly make up for each other."""
    rng = np.random.default_rng(4)
    scene = sea(
        "follow",
        gains=(0.01, 3),
        lamp__reference_counts=1400.0,
        lamp__beam_sigma_deg=8.8,
        sea__absorption_per_m=0.165,
        sea__scattering_per_m=0.05,
        field_of_view__cosine_power=0.88,
        array__radius_m=0.328,
        ambient__level_counts=1.0,
    )
    aims = np.array([0.03, 0.005, 0.0, 0.0])
    poses = np.zeros((100, 5))
    poses[:, 0] = -rng.uniform(3, 8, 100)
    found = calibrate(load_scene("follow"), exposed(scene, poses, rng, aims=aims), poses)
    assert largest_pull(found, scene, aims) < 5.5
    told = [note for note in found.notes if "turned by" in note]
    assert len(told) == 1, "the array's aim is not known to 0.002 rad"
    assert told[0].startswith("the lamp is turned by +1.")


def test_ranges_that_suffice_are_not_asked_for_again():
    scene = scene_of({"reference_counts": 60.0})
    found = calibrate(scene, *recorded(scene, 8, seed=7))
    (note,) = (note for note in found.notes if note.startswith("attenuation.k_per_m"))
    assert "which is enough: record more images" in note
    assert "differ by a factor" not in note


def test_the_scene_carries_the_standard_errors_as_its_prior():
    drive = recorded(scene_of(), 40, seed=8)
    found = calibrate(scene_of(), *drive, hold=["ambient.level_counts"])
    prior, parameters = found.scene.prior, named(found)
    assert prior.known == "calibrated"
    for key, name in (("lamp_power_std", "lamp.power"), ("radius_std", "array.radius_m")):
        relative = parameters[name].std / parameters[name].value
        assert getattr(prior, key) == pytest.approx(relative, rel=5e-3)
    for key, name in (
        ("beam_sigma_std_deg", "lamp.beam_sigma_deg"),
        ("k_std_per_m", "attenuation.k_per_m"),
        ("cosine_power_std", "field_of_view.cosine_power"),
    ):
        assert getattr(prior, key) == pytest.approx(parameters[name].std, rel=5e-3)
    for key, part in (("lamp_aim_std_deg", "lamp"), ("aim_std_deg", "array")):
        # The scene goes on taking them for straight.
        aims = [parameters[f"{part}.aim_{angle}_rad"] for angle in ("pitch", "yaw")]
        square = np.mean([aim.value**2 + aim.std**2 for aim in aims])
        assert getattr(prior, key) == pytest.approx(np.degrees(np.sqrt(square)), rel=5e-3)
    rms = np.sqrt(np.mean((found.gain_std / found.gains) ** 2))
    assert prior.gain_std == pytest.approx(rms, rel=5e-3)
    assert prior.ambient_std_counts == PRIORS["calibrated"]["ambient_std_counts"]  # held
    again = scene_from_settings(found.scene.settings(), "again")
    assert again.prior == prior


@pytest.mark.parametrize(
    ("known", "kept"), [("calibrated", "calibrated"), ("exactly", "as_bought")]
)
def test_what_is_not_known_is_not_exact(known, kept):
    rng = np.random.default_rng(9)
    start = scene_of(prior=known)
    found = calibrate(start, ForwardModel(start).expose(still(30), rng), still(30))
    for key in (
        *("beam_sigma_std_deg", "k_std_per_m", "cosine_power_std", "radius_std"),
        *("aim_std_deg", "lamp_aim_std_deg", "ambient_std_counts", "gain_std"),
    ):
        assert getattr(found.scene.prior, key) == PRIORS[kept][key], key


@pytest.mark.parametrize("housed", [{}, {"field_of_view": {"half_angle_deg": 60.0}}])
def test_a_prior_is_about_what_the_scene_has_and_keeps_what_was_not_fitted(housed):
    effects, rng = {"attenuation": None, **housed}, np.random.default_rng(1)
    start = changed("reference", effects=effects, prior={"known": "calibrated"})
    poses, _ = drive(rng, 100)
    # Farther off it is brighter, if by little: no attenuation at all fits best.
    brighter = np.exp(0.002 * np.linalg.norm(poses[:, :3], axis=1))[:, None, None]
    model = ForwardModel(start)
    found = calibrate(start, model.read(brighter * model.light(poses), rng), poses).scene
    assert "attenuation" not in found.effects
    assert found.prior.k_std_per_m == 0
    # The response behind a housing is not fitted, and known no better than before.
    assert (found.prior.cosine_power_std == start.prior.cosine_power_std) == bool(housed)


@rosbags
def test_the_command_writes_a_wrong_scene_only_by_force(tmp_path, capsys):
    images, poses, rolls = recorded(scene_of(), 12, seed=10)
    start = tmp_path / "start.yaml"
    save_scene(scene_of(), start, "Start.")
    messages = drive_messages(10**8 * np.arange(1, 13), poses, images, rolls)
    bag, output = write_bag(tmp_path / "sea", messages), tmp_path / "sea.yaml"
    words = ("calibrate", bag, "--scene", start, "-o", output)
    wrong = (*words, "--set", "beacon_position_m=0,0,1")
    line = run(*wrong, code=1)
    assert "no scene written: the model does not explain the images" in line
    assert "--force" in line
    assert not output.exists()
    assert "mean squared residual" in capsys.readouterr().out
    assert "scene:" in text_of(run, *wrong, "--force")
    forced = load_scene(output)
    run(*words)
    assert load_scene(output).settings() != forced.settings()


def test_gains_that_depend_on_the_gain_of_a_detector_name_it():
    """As of a fit that has gone astray."""
    images, poses, rolls = recorded(scene_of(), 15, seed=1)
    fit = CalibrationFit(CalibrationLikelihood(scene_of(), images, poses, rolls, None), (), int)
    first = fit.likelihood.layout.gains
    gains = range(first, first + 9)
    fit.unknown, fit.correlated = frozenset(gains), dict.fromkeys(gains, first + 5)
    told = notes_of(scene_of(), fit, ())
    assert [note for note in told if "most with the gain of [1, 2];" in note] == [told[0]]
