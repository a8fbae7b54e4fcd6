"""Calibration of a lamp whose beam is no Gaussian: its shape, what it leaves, and refusals."""

import numpy as np
import pytest
import second_forward
from calibrated_seas import drive, named, recorded, sea, seen
from scenes import changed, ready

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.calibration.fit.beam_shape import BINS, missing_shape, residuals_by_angle
from uuv_optical_array.calibration.fit.fit import CalibrationFit
from uuv_optical_array.calibration.likelihood.likelihood import CalibrationLikelihood
from uuv_optical_array.calibration.likelihood.parameters import SHAPE, Layout
from uuv_optical_array.forward.lamp.beam import gaussians_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, save_scene

# A flat top with a wide foot, and a peak with one, as real lamps have them.
FLAT, PEAKED = (-0.17, 0.69, 0.48), (0.4, -0.27, 0.87)
WIDTHS = [0.6, 1.0, 1.6]
POSE_STD = np.array([0.02, 0.02, 0.02, 0.009, 0.009])
MIRRORED = np.array([1.0, -1.0, -1.0, -1.0, -1.0])


def lamp_of(weights):
    """Return a sea whose lamp has such a beam of about the half-width of the ready one."""
    lamp = {"beam_sigma_deg": 9.0, "beam_widths": WIDTHS, "beam_weights": list(weights)}
    return changed(sea("follow"), lamp=lamp)


def free():
    """Return the ready scene, of one Gaussian, whose prior does not know the beam's shape."""
    return changed("follow", prior={"beam_shape_std": 0.05})


@pytest.mark.parametrize(
    ("weights", "pose_std"),
    [(FLAT, POSE_STD), (PEAKED, None), ((0.0, 1.0, 0.0), POSE_STD)],
    ids=["flat by odometry", "peaked at exact places", "one Gaussian by odometry"],
)
def test_the_shape_of_the_beam_is_found_from_its_width_alone(weights, pose_std, tmp_path):
    scene = lamp_of(weights)
    images, poses, rolls = recorded(scene, 150, seed=4)
    if pose_std is not None:
        poses = poses + np.random.default_rng(5).normal(size=poses.shape) * pose_std
    found = calibrate(free(), images, poses, rolls, pose_std=pose_std)
    assert not found.refusal
    told = named(found)
    for k, weight in ((0, weights[0]), (2, weights[2])):
        parameter = told[f"lamp.beam_weights.{k}"]
        assert abs(parameter.value - weight) < 5 * parameter.std
        assert parameter.std < 0.05
    assert abs(told["lamp.beam_sigma_deg"].value - 9.0) < 5 * told["lamp.beam_sigma_deg"].std
    assert told["prior.beam_shape_std"].value < 0.002
    assert found.scene.prior.beam_shape_std == pytest.approx(
        told["prior.beam_shape_std"].value, rel=5e-3, abs=1e-9
    )
    save_scene(found.scene, tmp_path / "found.yaml", "Found.")
    shape = gaussians_of(load_scene(tmp_path / "found.yaml").lamp)
    assert shape[0].sum() == pytest.approx(1, abs=1e-9)
    assert shape[0, 2] == pytest.approx(told["lamp.beam_weights.2"].value, abs=1e-8)


def test_what_the_shape_leaves_is_relative_to_the_light():
    """Independent errors of 1 % of each reading are found again, but for what the fit takes up."""
    scene, rng = lamp_of(FLAT), np.random.default_rng(6)
    poses, rolls = drive(rng, 200)
    model = ForwardModel(scene)
    light = model.light(poses, rolls)
    images = model.read(light * (1 + 0.01 * rng.standard_normal(light.shape)), rng)
    found = calibrate(free(), images, poses, rolls)
    left = named(found)["prior.beam_shape_std"]
    assert left.value == pytest.approx(0.01, abs=5 * left.std)
    # By hand: each reading tells its own error as far as it exceeds the noise of a count.
    spread, noise = (0.01 * light) ** 2, 1 + 1 / 12
    bound = np.sqrt(2 / ((light**2 / (noise + spread)) ** 2).sum()) / (2 * 0.01)
    assert left.std == pytest.approx(bound, rel=0.1)
    assert not found.refusal


@pytest.mark.parametrize(
    ("weights", "pose_std"),
    [(FLAT, None), (PEAKED, POSE_STD)],
    ids=["flat at exact places", "peaked by odometry"],
)
def test_another_beam_is_refused_by_its_name_and_not_by_that_of_the_odometry(weights, pose_std):
    images, poses, rolls = recorded(lamp_of(weights), 150, seed=7)
    if pose_std is not None:
        poses = poses + np.random.default_rng(8).normal(size=poses.shape) * pose_std
    found = calibrate(load_scene("follow"), images, poses, rolls, pose_std=pose_std)
    assert "beam of the lamp has another shape" in found.refusal
    assert "lamp.photometry" in found.refusal
    assert "odometry" not in found.refusal


@pytest.mark.parametrize(("spread", "named"), [(0.05, True), (0.1, False)])
def test_a_beam_that_is_a_part_of_the_cause_is_named_beside_the_others(spread, named):
    """The shape is worth some 14 in the mean square, and independent errors 38 or 150."""
    scene, rng = lamp_of(PEAKED), np.random.default_rng(7)
    poses, rolls = drive(rng, 150)
    model = ForwardModel(scene)
    light = model.light(poses, rolls)
    images = model.read(light * (1 + spread * rng.standard_normal(light.shape)), rng)
    found = calibrate(load_scene("follow"), images, poses, rolls)
    assert "odometry_axes" in found.refusal
    assert ("lamp.photometry" in found.refusal) == named


@pytest.mark.parametrize("start", [free(), ready("follow")], ids=["free", "one Gaussian"])
def test_other_axes_are_not_taken_for_the_beam(start):
    images, poses, rolls = recorded(lamp_of((0.0, 1.0, 0.0)), 20, seed=9)
    found = calibrate(start, images, poses * MIRRORED, rolls)
    assert "odometry_axes" in found.refusal
    assert "photometry" not in found.refusal


def test_a_beam_that_no_three_gaussians_explain_is_refused_by_its_name():
    scene, rng = lamp_of((0.0, 1.0, 0.0)), np.random.default_rng(10)
    poses, rolls = drive(rng, 150)
    model = ForwardModel(scene)
    ringed = model.light(poses, rolls) * (1 + 0.05 * np.cos(2.0 * angles_deg(scene, poses, rolls)))
    found = calibrate(free(), model.read(ringed, rng), poses, rolls)
    assert "no beam of the scene's Gaussians" in found.refusal
    assert "odometry" not in found.refusal
    # Of a cosine the root mean square is its size over the root of 2.
    left = named(found)["prior.beam_shape_std"].value
    assert left == pytest.approx(0.05 / np.sqrt(2), rel=0.2)


def angles_deg(scene, poses, rolls):
    """Return the angles off the beam's axis by the second forward model."""
    array, side = scene.settings()["array"], scene.array.detectors_per_side
    rays = [
        [ray.off_axis for ray in second_forward.rays(array, pose, roll)]
        for pose, roll in zip(poses, rolls, strict=True)
    ]
    return np.degrees(np.array(rays)).reshape(-1, side, side)


def test_residuals_are_told_by_the_angle_off_the_axis():
    """With all else held, the residuals of a ring in the beam are that ring."""
    scene, rng = sea("follow", gains=None), np.random.default_rng(11)
    poses, rolls = drive(rng, 100)
    model = ForwardModel(scene)
    angles = angles_deg(scene, poses, rolls)
    ring = 0.03 * np.sin(0.8 * angles)
    images = model.read(model.light(poses, rolls) * (1 + ring), rng)
    names = Layout(scene).names
    found = calibrate(scene, images, poses, rolls, hold=[*names, "gains"])
    told = found.by_angle
    assert (np.diff(told.angles_deg) > 0).all()
    expected = 0.03 * np.sin(0.8 * told.angles_deg)
    # Over the width of a bin the ring changes, and background is no light of the lamp.
    near = told.angles_deg < 10
    np.testing.assert_allclose(told.relative[near], expected[near], atol=0.006)
    assert told.share > 0.9
    plain = calibrate(scene, model.expose(poses, rng, rolls), poses, rolls, hold=[*names, "gains"])
    assert plain.by_angle.share == 0
    assert (np.abs(plain.by_angle.relative) < 5 * plain.by_angle.std).all()
    # A reading is lit from three standard deviations on, of noise and of rounding to a count.
    light, noise = model.light(poses, rolls), np.sqrt(1 + 1 / 12)
    lit = (light > 3 * noise) & (light < 1023 - 5 * noise)
    groups = np.array_split(np.flatnonzero(lit)[np.argsort(angles[lit])], BINS)
    expected = [angles.flat[group].mean() for group in groups]
    np.testing.assert_allclose(plain.by_angle.angles_deg, expected, rtol=1e-3)
    expected = [noise / np.sqrt((light.flat[group] ** 2).sum()) for group in groups]
    np.testing.assert_allclose(plain.by_angle.std, expected, rtol=0.01)


def fitted(scene, images, poses, rolls, shape):
    likelihood = CalibrationLikelihood(scene, images, poses, rolls, None)
    likelihood = likelihood.with_shape() if shape else likelihood
    return CalibrationFit(likelihood, likelihood.layout.lacking, int)


def test_the_score_test_says_what_a_fit_of_the_shape_would_gain():
    """To first order, so of a small change; what is gained is a ratio of two likelihoods."""
    start = load_scene("follow")
    images, poses, rolls = recorded(lamp_of((0.02, 0.96, 0.02)), 150, seed=12)
    without, shaped = (fitted(start, images, poses, rolls, shape) for shape in (False, True))
    missing = missing_shape(without)
    shaped.likelihood.widen(0.0)
    gained = 2 * (without.state.cost - shaped.likelihood.evaluate(shaped.state.at).cost)
    assert missing.significance * max(1.0, without.agreement.misfit) == pytest.approx(
        gained, rel=0.15
    )
    found = shaped.state.at.parameters[list(SHAPE)]
    np.testing.assert_allclose(missing.weights, found, atol=0.02)
    assert not missing.explains(0.0)  # so little is no reason to refuse
    assert residuals_by_angle(shaped).share < 0.5


def test_a_value_that_ends_at_its_bound_is_a_refusal():
    """Light that does not fade off the axis is that of no width of the beam."""
    dim = {"reference_counts": 60.0, "beam_sigma_deg": 60.0}
    start, rng = changed("reference", lamp=dim), np.random.default_rng(13)
    poses, rolls = drive(rng, 60)
    model = ForwardModel(start)
    views = seen(poses, rolls, np.zeros(4), start.array.bow_m)
    angles = np.radians(angles_deg(start, *views))
    light = model.light(poses, rolls) * np.exp(0.5 * (angles / np.radians(60)) ** 2)
    found = calibrate(start, model.read(light, rng), poses, rolls)
    assert found.misfit < 1.5
    assert named(found)["lamp.beam_sigma_deg"].note == "at its bound"
    assert "lamp.beam_sigma_deg ends at its bound, 90 deg" in found.refusal
