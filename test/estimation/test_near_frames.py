"""Frames from near by: few readings are between dark and full scale, and many poses fit them."""

from contextlib import suppress

import numpy as np
import pytest
from fits import fit_of
from scenes import changed
from scipy.special import ndtri

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.frame import DISTINCT, RIVAL, cover
from uuv_optical_array.estimation.least_squares.problem import (
    State,
    evaluate,
    problem_of,
    start_at,
)
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses


@pytest.fixture(scope="module")
def estimator(compiled_fit):
    water = {"attenuation": {"k_per_m": 0.1}, "forward_scatter": {"window_m": 0.3}}
    scene = changed("follow", effects={"sea": None, **water}, prior={"known": "calibrated"})
    return Estimator(scene).wait()


def distance(estimator, image, truth):
    """Return how far an estimate is off, in standard deviations of each degree of freedom."""
    estimate = estimator.estimate(image)
    return np.abs(estimate.pose - truth) / np.sqrt(estimate.covariance.diagonal())


@pytest.mark.parametrize(
    "truth", [(-1.04, 0.07, 0.08, 0.08, 0.2), (-1.03, -0.08, -0.11, 0.3, 0.07)]
)
def test_the_true_pose_is_found_in_each_sea_of_the_prior(estimator, truth):
    # From the three nearest rows of the table fits end in a false minimum as good as the true one.
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(9)
    for _ in range(10):
        sea = {
            name: np.array(std * rng.standard_normal())
            for name, std in estimator.scene.prior.nuisance_std().items()
        }
        image = model.read(model.light(truth, 0.0, sea), rng)
        assert (distance(estimator, image, truth) < 5).all()


@pytest.mark.parametrize("truth", [(-0.869, 0, 0, -0.006, 0.095), (-0.875, 0, 0, -0.028, 0.128)])
def test_the_true_pose_is_found_where_two_detectors_are_saturated(compiled_fit, truth):
    # The way to its minimum is so narrow and bent that a fit of plain steps stops before the end.
    estimator = Estimator(load_scene("follow")).wait()
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(9)
    for _ in range(20):
        assert (distance(estimator, model.expose(truth, rng), truth) < 6).all()


def minimum(pose, cost):
    zeros, square = np.zeros(5), np.zeros((5, 5))
    return State(cost, zeros, zeros, square, tuple(pose), 0.0, square)


def test_a_covariance_covers_each_minimum_that_is_as_likely():
    rng = np.random.default_rng(3)
    root = rng.standard_normal((5, 5))
    covariance, pose = root @ root.T + 0.1 * np.eye(5), rng.standard_normal(5)
    near, far = root @ np.full(5, 0.5), root @ np.full(5, 9.0)
    wide, same = covariance.copy(), covariance.copy()
    minima = [minimum(pose, 1.0), minimum(pose + near, 2.0), minimum(pose + far, 3.0)]
    assert cover(minima, pose, wide)
    assert far @ np.linalg.solve(wide, far) == pytest.approx(DISTINCT**2)
    # By a multiple of that one direction, and no other.
    assert np.linalg.matrix_rank(wide - covariance, tol=1e-8) == 1
    # One that is much less likely, or near, changes nothing.
    assert not cover([*minima[:2], minimum(pose + far, 1.1 + RIVAL)], pose, same)
    assert (same == covariance).all()


@pytest.mark.parametrize(
    ("pose", "possible"),
    [
        ((-3.0, 0.0, 0.0, 0.0, 0.0), True),
        ((-3.0, 0.0, 0.0, 1.0, 0.0), True),
        ((-3.0, 0.0, 0.0, 1.1, 0.0), False),  # on its tail
        ((-3.0, 0.0, 0.0, 0.0, 1.8), True),
        ((-3.0, 0.0, 0.0, 0.0, 2.9), False),  # with its back to the lamp
    ],
)
def test_no_pose_is_impossible_for_a_vehicle(pose, possible):
    model = ForwardModel(load_scene("reference"))
    problem = problem_of(model, np.zeros(5), np.full(5, 9.0), {})
    with np.errstate(all="ignore"):
        state = evaluate(problem, start_at(problem, np.array(pose)))
    assert np.isfinite(state.cost) == possible


def answered(estimator, poses, rng):
    """Count the poses whose images have an estimate, none of which is far off."""
    count = 0
    for pose, image in zip(poses, ForwardModel(estimator.scene).expose(poses, rng), strict=True):
        with suppress(NoPose):
            assert (distance(estimator, image, pose) < 5).all(), pose
            count += 1
    return count


@pytest.mark.parametrize("pitch_deg", [-70, 62, 65, 75])
def test_a_follower_that_is_steeper_than_any_fit_gets_no_false_pose(estimator, pitch_deg):
    rng, pitch = np.random.default_rng(5), np.radians(pitch_deg)
    poses = rng.uniform([-7, -0.5, -0.5, pitch, 0], [-4, 0.5, 0.5, pitch, 0], (15, 5))
    answered(estimator, poses, rng)


def test_a_frame_from_beside_the_lamp_is_right_or_wide_or_refused(estimator):
    rng = np.random.default_rng(8)
    poses = rng.uniform([-3, -0.5, -0.5, -0.35, -0.35], [-0.8, 0.5, 0.5, 0.35, 0.35], (60, 5))
    assert answered(estimator, poses, rng) > 45  # the others are far beside the beam


def test_every_frame_between_the_lamp_and_the_table_has_its_pose(estimator):
    rng = np.random.default_rng(6)
    poses = rng.uniform([-2.5, -0.1, -0.1, -0.1, -0.1], [-1.5, 0.1, 0.1, 0.1, 0.1], (30, 5))
    poses[:, 1:3] *= -poses[:, :1]  # in a cone
    assert answered(estimator, poses, rng) == 30


def test_one_detector_below_full_scale_leaves_a_pose(compiled_fit):
    """Full steps to all else at an attitude overshoot there: the others have no slope."""
    bright = Estimator(changed("reference", lamp={"reference_counts": 2e4})).wait()
    model, rng = ForwardModel(bright.scene), np.random.default_rng(5)
    poses = lit_poses(model, 150, rng)
    light = model.light(poses)
    poses = poses[np.sum(light < 1000, axis=(1, 2)) == 1]
    far = []
    for pose, image in zip(poses, model.expose(poses, rng), strict=True):
        with suppress(NoPose):
            far.append(distance(bright, image, pose).max())
    assert len(poses) > 25
    assert len(far) > 0.8 * len(poses)
    assert max(far) < 6


@pytest.fixture(scope="module")
def harbour(compiled_fit):
    return Estimator(load_scene("harbour")).wait()


@pytest.mark.parametrize(
    ("truth", "image"),
    [
        (
            (-1.0152, 0.0008, -0.0286, -0.1452, 0.1342),
            "6 5 7 6 4 7 31 922 1023 661 7 568 1023 1023 1023 8 909 1023 1023 1023 5 97 1023 1023 "
            "276",
        ),
        (
            (-0.9648, 0.0235, -0.0043, -0.2043, -0.0807),
            "9 8 6 9 7 7 11 27 8 7 115 1023 1023 363 9 1023 1023 1023 1023 7 105 1023 1023 1023 7",
        ),
        (
            (-0.9812, 0.0085, -0.0308, -0.2023, 0.1694),
            "0 0 0 0 0 4 0 67 429 260 0 38 1023 1023 1023 0 165 1023 1023 1023 0 32 1023 1023 1023",
        ),
    ],
)
def test_no_start_by_signature_leads_to_the_likeliest_pose(harbour, truth, image):
    readings = np.array(image.split(), dtype=float)
    assert (distance(harbour, readings.reshape(5, 5), np.array(truth)) < 6).all()
    # A fit that is told the truth finds none that is likelier.
    fit = fit_of(harbour)
    found, best = (-ndtri(fit(readings, match=start).misfit) for start in (None, np.array(truth)))
    assert found < best + 0.5
