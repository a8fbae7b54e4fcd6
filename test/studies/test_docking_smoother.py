"""The docking smoother: against dense algebra, an independent optimiser, and its own statistics."""

import numpy as np
import pytest
from differences import differentiate
from scenes import with_prior
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from uuv_optical_array.estimation.information.likelihood import information
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.docking_smoother import (
    STATE,
    Motion,
    PathProblem,
    bound,
    evaluate,
    predict,
    refine,
    smoothed,
    states_along,
)

STEP_S = 0.2
SETTINGS = {"speed_walk_m_per_s": 0.03, "slip_m": 0.02, "turn_walk_deg_per_s": 3.0}


@pytest.fixture(scope="module")
def model():
    return ForwardModel(load_scene("eren2017_tank"))


def straight(frames, yaw_deg=6.0, start=(-6.0, -0.1, 0.1)):
    """Straight ahead at 0.5 m/s."""
    heading = Rotation.from_euler("ZY", [yaw_deg, -4], degrees=True).apply([1, 0, 0])
    places = start + 0.5 * STEP_S * np.arange(frames)[:, None] * heading
    angles = np.broadcast_to(np.radians([-4, yaw_deg]), (frames, 2))
    return np.concatenate([places, angles], axis=1)


def exposed(model, path, runs, rng):
    """Images of runs along a path, each run with settings of its own."""
    off = {
        name: np.broadcast_to(rng.normal(0, std, (runs, 1)), (runs, len(path)))
        for name, std in model.scene.prior.nuisance_std().items()
    }
    return model.expose(np.broadcast_to(path, (runs, *path.shape)), rng, 0.0, off)


def step(state):
    """A step of the motion, by SciPy's rotations."""
    ahead = state.copy()
    pitch_yaw = state[..., 3:5] + STEP_S / 2 * state[..., 6:8]
    bow = Rotation.from_euler("ZY", pitch_yaw[..., ::-1].reshape(-1, 2)).apply([1, 0, 0])
    ahead[..., :3] += STEP_S * state[..., 5:6] * bow.reshape(*state.shape[:-1], 3)
    ahead[..., 3:5] += STEP_S * state[..., 6:8]
    return ahead


def noise_of_motion():
    """Process noise by what the settings mean, one number at a time."""
    walk, noise = np.radians(SETTINGS["turn_walk_deg_per_s"]) ** 2, np.zeros((STATE, STATE))
    for axis in range(3):
        noise[axis, axis] = SETTINGS["slip_m"] ** 2 * STEP_S
    noise[5, 5] = SETTINGS["speed_walk_m_per_s"] ** 2 * STEP_S
    for angle, rate in ((3, 6), (4, 7)):
        noise[angle, angle] = walk * STEP_S**3 / 3
        noise[angle, rate] = noise[rate, angle] = walk * STEP_S**2 / 2
        noise[rate, rate] = walk * STEP_S
    return noise


def first_prior(model):
    turn = np.radians(5.0)
    stds = model.scene.prior.nuisance_std().values()
    mean = np.zeros(STATE + len(stds))
    mean[0] = -6.0
    return mean, np.array([10, 5, 5, 2, 2, 1.0, turn, turn, *stds])


def test_motion_is_that_of_the_heading_and_its_derivatives_are_right():
    states = np.random.default_rng(1).normal(0, 0.4, (20, STATE))
    later, slopes = predict(states, STEP_S)
    np.testing.assert_allclose(later, [step(state) for state in states], atol=1e-12)
    for state, slope in zip(states, slopes, strict=True):
        np.testing.assert_allclose(slope, differentiate(step, state), atol=1e-8)


def test_bound_is_the_inverse_of_the_dense_information(model):
    """All frames' states in one information matrix, inverted whole, for each number of frames."""
    path = straight(6)
    found = bound(Motion(model, STEP_S, **SETTINGS), path)
    noise = np.linalg.inv(noise_of_motion())
    states = np.zeros((6, STATE))
    states[:, :5], states[:, 5] = path, 0.5
    off = {name: np.zeros(6) for name in model.scene.prior.nuisance_std()}
    light, jacobian = model.linearised(path, 0.0, off)
    weights = information(light, model.noise)
    for frames in range(1, 7):
        # Unknowns: the motion of each frame, then the settings once.
        whole = np.zeros((STATE * frames + 2,) * 2)
        settings = slice(STATE * frames, None)
        prior = first_prior(model)[1] ** -2.0
        whole[range(STATE), range(STATE)] += prior[:STATE]
        whole[settings, settings] += np.diag(prior[STATE:])
        for k in range(frames):
            seen = np.zeros((7, len(whole)))
            seen[:5, STATE * k : STATE * k + 5] = np.eye(5)
            seen[5:, settings] = np.eye(2)
            image = jacobian[k].T @ (weights[k][:, None] * jacobian[k])
            whole += seen.T @ image @ seen
            if k:
                link = np.zeros((STATE, len(whole)))
                link[:, STATE * (k - 1) : STATE * k] = -differentiate(step, states[k - 1])
                link[:, STATE * k : STATE * (k + 1)] = np.eye(STATE)
                whole += link.T @ noise @ link
        last = slice(STATE * (frames - 1), STATE * (frames - 1) + 5)
        std = np.sqrt(np.diag(np.linalg.inv(whole))[last])
        np.testing.assert_allclose(found[frames - 1], std, rtol=1e-5)


def test_the_path_is_the_most_probable_one(model):
    """An optimiser without derivatives of ours, from the path found, gains next to nothing."""
    rng = np.random.default_rng(3)
    path = straight(4)
    images = exposed(model, path, 1, rng)
    motion = Motion(model, STEP_S, **SETTINGS)
    poses, _, (found,) = smoothed(motion, images, path[None, 0])
    mean, std = first_prior(model)
    precision = np.linalg.inv(noise_of_motion())

    def cost(numbers):
        """The negative log-posterior, with Gaussian readings: none is at a limit."""
        states = numbers[..., :-2].reshape(*numbers.shape[:-1], 4, STATE)
        first = np.concatenate([states[..., 0, :], numbers[..., -2:]], axis=-1)
        total = 0.5 * (((first - mean) / std) ** 2).sum(axis=-1)
        apart = states[..., 1:, :] - step(states[..., :-1, :])
        total += 0.5 * np.einsum("...ki,ij,...kj", apart, precision, apart)
        spread = {
            name: np.broadcast_to(numbers[..., i, None], states.shape[:-1])
            for name, i in (("lamp.power", -2), ("attenuation.k_per_m", -1))
        }
        light = model.light(states[..., :5], 0.0, spread)
        variance = model.scene.effects["sensor_noise"]["sigma_counts"] ** 2 + 1 / 12
        return total + 0.5 * ((images[0] - light) ** 2).sum(axis=(-3, -2, -1)) / variance

    # What the solver accepts steps by is the same function, but for a constant.
    scales = [*np.tile([0.03] * 5 + [0.3] * 3, 4), 0.01, 0.01]
    moved = found + scales * rng.standard_normal(len(found))
    problem = PathProblem(motion, images.reshape(1, 4, 25))
    theirs = evaluate(problem, found[:, None]).cost, evaluate(problem, moved[:, None]).cost
    assert theirs[1][0] - theirs[0][0] == pytest.approx(cost(moved) - cost(found), rel=1e-9)
    assert images.min() > 0
    assert images.max() < 1023
    # The scale of a search, by the information.
    at_found = evaluate(problem, found[:, None])
    scale = np.sqrt(np.diag(np.linalg.inv(at_found.information[..., 0])))
    nudges = 1e-5 * np.eye(len(found))

    def slopes(u):
        ahead, behind = (cost(found + scale * (u + x)) for x in (nudges, -nudges))
        return (ahead - behind) / 2e-5

    units = np.zeros(len(found))
    best = minimize(lambda u: cost(found + scale * u), units, jac=slopes, method="BFGS")
    assert cost(found) - best.fun < 0.02
    np.testing.assert_array_equal(found[-10:-5], poses[0, -1])
    # All four images at once, from a straight path, lead there too.
    start = np.append(states_along(path, STEP_S), [0.0, 0.0])
    whole = refine(problem, start[:, None])
    assert whole.cost[0] == pytest.approx(theirs[0][0], abs=0.02)


def test_errors_are_those_of_the_bound_and_the_covariance_is_honest(model):
    rng = np.random.default_rng(4)
    path, runs = straight(12), 150
    images = exposed(model, path, runs, rng)
    motion = Motion(model, STEP_S, **SETTINGS)
    poses, covariances, _ = smoothed(motion, images, path[0] + rng.normal(0, 0.02, (runs, 5)))
    errors = poses[:, -1] - path[-1]
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / bound(motion, path)[-1]
    # The path is straighter than the motion it is expected of, so errors may be smaller.
    assert (ratio > 0.6).all()
    assert (ratio < 1.1).all()
    nees = (errors * np.linalg.solve(covariances[:, -1], errors[..., None])[..., 0]).sum(axis=1)
    assert 3.0 < nees.mean() < 5.7


def test_approaches_together_are_as_one_by_one(model):
    rng, path = np.random.default_rng(5), straight(5)
    images = exposed(model, path, 3, rng)
    motion, guess = Motion(model, STEP_S), np.broadcast_to(path[0], (3, 5))
    together = smoothed(motion, images, guess)
    for run in range(3):
        alone = smoothed(motion, images[run : run + 1], guess[:1])
        np.testing.assert_allclose(alone[0][0], together[0][run], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(alone[1][0], together[1][run], rtol=1e-9)


def test_a_known_sea_has_no_settings_to_estimate(model):
    known = ForwardModel(with_prior(model.scene, lamp_power_std=0.0, k_std_per_m=0.0))
    path = straight(6)
    motion = Motion(known, STEP_S, **SETTINGS)
    assert (bound(motion, path) < bound(Motion(model, STEP_S, **SETTINGS), path)).all()
    poses, _, _ = smoothed(motion, known.expected(path)[None], path[None, 0])
    np.testing.assert_allclose(poses[0, -1], path[-1], atol=5e-3)


@pytest.mark.parametrize("counts", [0.0, 1023.0])
def test_dark_and_saturated_images_leave_a_finite_pose_and_covariance(model, counts):
    path = straight(3)
    images = np.concatenate([model.expected(path[:1]), np.full((3, 5, 5), counts)])[None]
    motion = Motion(model, STEP_S)
    poses, covariances, _ = smoothed(motion, images, path[:1])
    assert np.isfinite(poses).all()
    assert (np.linalg.eigvalsh(covariances[0]) > 0).all()
    if counts == 0:
        assert covariances[0, -1, 0, 0] > covariances[0, 0, 0, 0]
