"""Poses of readings of any detectors, of which parts are known."""

import numpy as np
import pytest
from command_line import run, text_of
from needs import rosbags
from scenes import changed, ready, with_prior
from scipy.stats import norm

from uuv_optical_array.core.geometry import wrapped
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.layouts.detectors import Detectors, layout_of, of_scene, write_detectors
from uuv_optical_array.layouts.poses import PoseFit

FACING = np.array([[1.0, 0.0, 0.0]])
ONE = Detectors(("pd",), np.zeros((1, 3)), FACING, np.ones(1))
SIGMA = 0.5
EXACT = np.full(5, 1e-6)


def fit_of(scene, detectors, max_misfit=1e-5):
    return PoseFit(layout_of(scene, detectors), max_misfit)


def test_the_range_of_one_detector_is_that_of_the_inverse_square():
    """On the axis in clear water: r = sqrt(P / E), and its error sigma r^3 / (2 P)."""
    scene = changed(ready("ideal"), effects={"sensor_noise": {"sigma_counts": SIGMA}})
    fit = fit_of(scene, ONE)
    power = ForwardModel(scene).power
    for reading in (300.0, 900.0):
        image = np.zeros((2, 2))
        image[0, 0] = reading
        found = fit.one(image, np.array([np.nan, 0, 0, 0, 0]), EXACT, 0.0)
        r = np.sqrt(power / reading)
        assert not found.reason
        assert found.pose[0] == pytest.approx(-r, rel=1e-6)
        # With a prior as wide as the table, 4.6 m, on its middle, which says next to nothing.
        std = np.sqrt(found.covariance[0, 0])
        assert std == pytest.approx(SIGMA * r**3 / (2 * power), rel=1e-3)
        assert np.abs(found.pose[1:]).max() < 1e-6


@pytest.mark.parametrize("off", [0.5, 3.0, 5.0])
def test_the_misfit_of_one_reading_is_the_chance_of_a_normal_number(off):
    """At a known pose, with one degree of freedom; a range that is sought leaves none."""
    scene = changed(ready("ideal"), effects={"sensor_noise": {"sigma_counts": SIGMA}})
    fit, pose = fit_of(scene, ONE), np.array([-5.0, 0, 0, 0, 0])
    image = np.zeros((2, 2))
    image[0, 0] = ForwardModel(scene).power / 25 + off * SIGMA
    found = fit.one(image, pose, EXACT, 0.0)
    # What 1 um may add to the noise is less than a thousandth of it.
    assert found.misfit == pytest.approx(2 * norm.sf(off), rel=0.01)
    assert found.reason == ("outlier: residuals too large" if found.misfit < 1e-5 else "")
    pose[0] = np.nan
    sought = fit.one(image, pose, EXACT, 0.0)
    assert not sought.reason
    assert np.isnan(sought.misfit)


def test_what_one_detector_cannot_tell_is_named():
    fit = fit_of(changed(ready("ideal"), effects={"sensor_noise": {"sigma_counts": SIGMA}}), ONE)
    image = np.zeros((2, 2))
    image[0, 0] = 500.0
    found = fit.one(image, np.array([np.nan, np.nan, 0, 0, 0]), EXACT, 0.0)
    assert found.reason.startswith("not determined by these detectors: y to ")
    assert np.isnan(found.pose).all()
    dark = fit.one(np.zeros((2, 2)), np.array([np.nan, 0, 0, 0, 0]), EXACT, 0.0)
    assert dark.reason == "no light: the brightest detector reads 0"


def test_either_side_of_a_beam_is_ambiguous_to_one_detector():
    """As y is only told by how far it is off the axis, the other side is as good."""
    fit = fit_of(changed(ready("ideal"), effects={"sensor_noise": {"sigma_counts": SIGMA}}), ONE)
    model = layout_of(ready("ideal"), ONE).model()
    image = model.light(np.array([-5.0, 0.5, 0, 0, 0]))
    image[0, 1] = image[1, 0] = image[1, 1] = 0
    found = fit.one(image, np.array([-5.0, np.nan, 0, 0, 0]), EXACT, 0.0)
    assert found.reason.startswith("ambiguous: the light fits as well at y ")
    assert abs(float(found.reason.split()[-2])) == pytest.approx(0.5, abs=0.01)


@pytest.fixture(scope="module")
def sphere():
    """The array of the default scene, drawn truths with their images, and where they were."""
    scene, rng = ready("follow"), np.random.default_rng(5)
    poses = rng.uniform([-7, -0.5, -0.5, -0.3, -0.3], [-4, 0.5, 0.5, 0.3, 0.3], (25, 5))
    return scene, poses, ForwardModel(scene).expose(poses, rng)


def test_a_sphere_as_a_layout_has_the_poses_of_the_estimator(sphere):
    """Both are the most probable pose of the same prior: of even light, and a sphere as drawn."""
    scene, _, images = sphere
    scene = with_prior(scene, uneven_probability=0.0, radius_std=0.0)
    fit, estimator = fit_of(scene, of_scene(scene)), Estimator(scene, compiled=False)
    nothing = np.full(5, np.nan)
    for image in images[:4]:
        found, other = fit.one(image, nothing, EXACT, 0.0), estimator.estimate(image)
        assert not found.reason
        apart = wrapped(found.pose - other.pose)
        assert apart @ np.linalg.solve(other.covariance, apart) < 0.05
        ratio = np.sqrt(found.covariance.diagonal() / other.covariance.diagonal())
        np.testing.assert_allclose(ratio, 1.0, atol=0.05)


def test_a_known_part_makes_the_others_better_as_the_bound_says(sphere):
    """Where all but the pose is known: the inverse of the information of what is left open."""
    poses = sphere[1][:12]
    exact = changed(ready("follow"), prior={"known": "exactly"})
    fit = fit_of(exact, of_scene(exact))
    model, rng = ForwardModel(exact), np.random.default_rng(6)
    squares = []
    for pose in poses:
        given = np.array([np.nan, np.nan, pose[2], pose[3], np.nan])
        found = fit.one(model.expose(pose, rng), given, EXACT, 0.0)
        assert not found.reason
        bound = np.linalg.inv(cramer_rao_bound(model, pose).covariance)
        free = [0, 1, 4]
        expected = np.linalg.inv(bound[np.ix_(free, free)])
        own = found.covariance[np.ix_(free, free)]
        np.testing.assert_allclose(np.sqrt(own.diagonal() / expected.diagonal()), 1, atol=0.2)
        off = (found.pose - pose)[free]
        squares.append(off @ np.linalg.solve(own, off))
    # A chi-square of 36: 5 of its standard deviations.
    assert abs(np.sum(squares) - 36) < 5 * np.sqrt(2 * 36)


def test_readings_of_another_beam_are_an_outlier(sphere):
    scene, _, images = sphere
    odd = images[0].copy()
    odd[::2, ::2] *= 0.3
    found = fit_of(scene, of_scene(scene)).one(odd, np.full(5, np.nan), EXACT, 0.0)
    assert found.reason == "outlier: residuals too large"


@rosbags
def test_a_table_of_readings_has_poses_beside_its_own_columns(sphere, tmp_path):
    scene, poses, images = sphere
    own = of_scene(scene)
    write_detectors(tmp_path / "d.csv", own, "sphere")
    head = ",".join(["time_s", *own.names, "x_m", "z_m"])
    rows = [
        [0.1 * i, *image.ravel(), pose[0], pose[2]]
        for i, (image, pose) in enumerate(zip(images[:4], poses, strict=False))
    ]
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    (tmp_path / "r.csv").write_text("\n".join([head, *lines, ""]))
    words = "estimate", tmp_path / "r.csv", "--detectors", tmp_path / "d.csv"
    text = text_of(run, *words, "--known", "z_m", "-o", tmp_path / "out")
    assert "4 poses" in text
    assert "rms error by its columns: x 0" in text
    assert "pitch" not in text  # which has no column
    frames = np.genfromtxt(tmp_path / "out/frames.csv", delimiter=",", names=True)
    np.testing.assert_allclose(frames["z_m"], poses[:4, 2], atol=1e-5)
    assert (np.abs(frames["x_m"] - poses[:4, 0]) < 5 * frames["std_x_m"]).all()
    told = run(*words, "--known", "y_m", "-o", tmp_path / "no", code=1)
    assert "--known y_m: no value for 4 of 4 images; fill its column, or give y_m=VALUE" in told
    told = run(*words, "--track", "-o", tmp_path / "no", code=2)
    assert "for the scene's array alone" in told
