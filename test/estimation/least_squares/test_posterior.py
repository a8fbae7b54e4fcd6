"""The published moments against long Markov chains, and against four thousand errors."""

from contextlib import suppress

import numpy as np
import pytest
from scenes import changed, coarse, squared_error
from scipy.stats import chi2

from uuv_optical_array.estimation.estimator import Estimator, NoPose
from uuv_optical_array.estimation.information.likelihood import log_likelihood
from uuv_optical_array.estimation.least_squares.problem import (
    MOST_STEPS,
    problem_of,
    refine,
)
from uuv_optical_array.estimation.signature_table import grid_axes
from uuv_optical_array.estimation.unknowns.coordinates import from_pose, to_lamp
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses

pytestmark = [pytest.mark.filterwarnings("error"), pytest.mark.usefixtures("strict_arithmetic")]

WALKERS = 400


def chains(log_density, starts, steps, seed):
    """Sample by affine-invariant stretch moves (J. Goodman and J. Weare, 2010)."""
    rng = np.random.default_rng(seed)
    walkers, density = starts.copy(), log_density(starts)
    count, size = walkers.shape
    kept = []
    for step in range(steps):
        for half in (np.arange(count // 2), np.arange(count // 2, count)):
            others = walkers[np.setdiff1d(np.arange(count), half)]
            stretch = (rng.random(len(half)) + 1) ** 2 / 2  # g(z) ~ z^-1/2 on [1/2, 2]
            partner = others[rng.integers(len(others), size=len(half))]
            trial = partner + stretch[:, None] * (walkers[half] - partner)
            new = log_density(trial)
            gain = (size - 1) * np.log(stretch) + new - density[half]
            accepted = np.log(rng.random(len(half))) < gain
            walkers[half[accepted]] = trial[accepted]
            density[half[accepted]] = new[accepted]
        if step >= steps // 3 and step % 5 == 0:
            kept.append(walkers.copy())
    return np.concatenate(kept)


def scene(table=(), array=()):
    return changed(coarse("reference", 7), table=dict(table), array=dict(array))


def chain_moments(scene, readings, pose, roll, steps):
    """Mean and covariance of the pose under its prior, by brute force from the true one."""
    model, axes = ForwardModel(scene), grid_axes(scene.table)
    middle = np.array([(axis[0] + axis[-1]) / 2 for axis in axes])
    wide = 3 * np.array([(axis[-1] - axis[0]) / 2 for axis in axes])
    problem = problem_of(model, middle, wide, {})
    frame, one = problem.frame, problem._replace(readings=readings, roll=roll)
    with np.errstate(all="ignore"):
        best = refine(one, from_pose(frame, np.array(pose), roll), MOST_STEPS)
    factor = np.linalg.cholesky(np.linalg.inv(best.information))
    start = best.at + np.random.default_rng(1).normal(size=(WALKERS, 5)) @ factor.T

    def log_density(coordinates):
        # The volume is compared with differences in test_coordinates.py.
        _, poses, log_volume = to_lamp(frame, coordinates.T, roll)
        prior = 0.5 * (((np.transpose(poses) - middle) / wide) ** 2).sum(axis=1)
        light = model.light(np.transpose(poses), roll).reshape(len(coordinates), -1)
        return log_likelihood(readings, light, model.noise)[0].sum(axis=1) + log_volume - prior

    with np.errstate(under="ignore"):
        poses = np.array(to_lamp(frame, chains(log_density, start, steps, 2).T, roll)[1])
    return poses.mean(axis=1), np.cov(poses)


WIDER = {"yaw_deg": [-60.0, 60.0, 9]}
PLANAR = {"shape": "planar", "radius_m": None}
FRAMES = {
    "far and dim": ([-7.5, 0.5, -0.5, 0.2, -0.1], {}, {}, 0.0),
    "rolled": ([-5.5, -0.3, 0.2, 0.1, 0.2], {}, {}, 0.35),
    # Detectors of the port edge stand within a few degrees of the sight line.
    "near grazing": ([-4.5, 0.1, 0.1, 0.05, -1.0], WIDER, {}, 0.0),
    # A ring of attitudes that look alike.
    "planar and far": ([-8.0, 0.3, -0.2, -0.1, 0.2], {}, PLANAR, 0.2),
}
# Chains of 200 steps know a mean to 0.05 and a deviation to 0.03 of itself; they go round a bent
# posterior in 900, which the estimate samples by few hundred points.
PLAIN, BENT = (0.12, 0.1, 200), (0.35, 0.3, 900)


@pytest.mark.parametrize("frame", FRAMES)
def test_mean_and_covariance_are_those_of_long_chains(frame):
    pose, changes, array, roll = FRAMES[frame]
    estimator = Estimator(scene(changes, array=array)).wait()
    model = ForwardModel(estimator.scene)
    image = model.expose(pose, np.random.default_rng(20), roll)
    if frame == "near grazing":
        light = model.light(pose)
        assert light.min() == 0 < light[light > 0].min() < 0.05 * light.max()
    answer = estimator.estimate(image, roll=roll)
    # A tenth of a deviation is a hundredth of the mean squared error.
    shift, share, steps = BENT if frame == "planar and far" else PLAIN
    mean, covariance = chain_moments(estimator.scene, image.ravel(), pose, roll, steps)
    std = np.sqrt(covariance.diagonal())
    assert (np.abs(answer.pose - mean) < shift * std).all()
    np.testing.assert_allclose(np.sqrt(answer.covariance.diagonal()), std, rtol=share)
    np.testing.assert_allclose(
        answer.covariance / np.outer(std, std), covariance / np.outer(std, std), atol=2 * share
    )


def test_what_no_image_tells_keeps_the_priors_deviation_and_is_named():
    """A beam so wide that it has no shape says nothing of where the array floats in it."""
    narrow = {"y_m": [-0.2, 0.2, 7], "z_m": [-0.2, 0.2, 7]}
    sea = changed(scene(narrow), lamp={"beam_sigma_deg": 90.0})
    estimator = Estimator(sea).wait()
    pose = np.array([-6.0, 0.1, 0.1, 0.05, 0.05])
    image = ForwardModel(sea).expose(pose, np.random.default_rng(21))
    answer = estimator.estimate(image)
    assert {"y", "z"} <= set(answer.unobservable)
    assert np.sqrt(answer.covariance[1, 1]) > 0.5
    assert "x" not in answer.unobservable


def normalised_errors(estimator, count, seed):
    """Squared errors of frames of at least 20 counts; 4 to 8 m, 0.9 m and 20 deg."""
    model, rng, errors = ForwardModel(estimator.scene), np.random.default_rng(seed), []
    poses = lit_poses(model, count, rng)
    for pose, image in zip(poses, model.expose(poses, rng), strict=True):
        with suppress(NoPose):
            errors.append(squared_error(estimator.estimate(image), pose))
    return np.array(errors)


def test_four_thousand_errors_are_as_large_as_their_covariances_say():
    sea = load_scene("reference")
    errors = normalised_errors(Estimator(sea).wait(), 4_000, 3)
    print(f"mean NEES {errors.mean():.3f} of {len(errors)} frames, largest {errors.max():.1f}")
    assert len(errors) > 3_980
    low, high = chi2.interval(0.95, 5 * len(errors)) / np.array(len(errors))
    assert low < errors.mean() < high
