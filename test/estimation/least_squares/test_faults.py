"""Faulty detectors are found, named and left out, and take nothing else with them."""

from contextlib import suppress
from itertools import combinations, pairwise

import numpy as np
import pytest
from fits import kinds_of
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.stats import entropy

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.faults import (
    lines_of_neighbours,
    log_faulty,
    most_faulty,
    weigh,
)
from uuv_optical_array.estimation.least_squares.problem import MOST_STEPS, refine, start_at
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses

FAULTS = {
    "dead": lambda reading: 0.0,
    "stuck": lambda reading: 700.0,
    "full": lambda reading: 1023.0,
    "dirty": lambda reading: round(0.8 * reading),
    "glint": lambda reading: reading + 50,
}


@pytest.fixture(scope="module")
def estimator(compiled_fit):
    return Estimator(load_scene("follow")).wait()


def spoilt(images, fault, count, rng):
    """Return images of which some readings are faulty, and where."""
    images, places = images.copy(), []
    for image in images:
        # One that reads much, so that the fault is one.
        bright = np.flatnonzero(image.ravel() > 0.5 * image.max())
        at = rng.choice(bright, count, replace=False)
        image.flat[at] = [FAULTS[fault](reading) for reading in image.flat[at]]
        places.append({divmod(int(place), 5) for place in at})
    return images, places


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("fault", FAULTS)
def test_faulty_detectors_are_named_and_the_pose_is_right(estimator, fault, count):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(11)
    poses = lit_poses(model, 200, rng)
    poses = poses[model.light(poses).max(axis=(1, 2)) > 150][:12]
    images, places = spoilt(model.expose(poses, rng), fault, count, rng)
    refused = 0
    for pose, image, faulty in zip(poses, images, places, strict=True):
        try:
            estimate = estimator.estimate(image)
        except NoPose:
            refused += 1  # what is left does not fit well, or too little of it is lit
            continue
        assert faulty <= set(estimate.left_out)
        off = np.abs(estimate.pose - pose) / np.sqrt(estimate.covariance.diagonal())
        assert (off < 6).all()
    assert refused <= 1


def test_a_dead_detector_is_not_one_that_the_pose_turns_away(estimator):
    """The lowest port one is dead; a follower that pitches more sees less light there, too."""
    pose = np.array([-4.657, 0.780, -0.097, 0.161, -0.048])
    model = ForwardModel(estimator.scene)
    assert model.light(pose)[4, 0] > 15
    image = np.array(
        [
            [55, 127, 189, 228, 194],
            [80, 149, 215, 264, 261],
            [77, 138, 201, 246, 251],
            [55, 110, 159, 196, 190],
            [1, 63, 98, 117, 86],
        ]
    )
    estimate = estimator.estimate(image)
    assert estimate.left_out == ((4, 0),)
    assert (np.abs(estimate.pose - pose) < 3 * np.sqrt(estimate.covariance.diagonal())).all()


def test_an_image_without_a_fault_loses_no_reading(estimator):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(5)
    for image in model.expose(lit_poses(model, 60, rng), rng):
        assert estimator.estimate(image).left_out == ()


def test_four_faults_are_refused(estimator):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(6)
    images = model.expose(np.tile([-4.5, 0.1, 0.0, 0.05, 0.0], (10, 1)), rng)
    for image in spoilt(images, "stuck", 4, rng)[0]:
        with pytest.raises(NoPose, match="no fit"):
            estimator.estimate(image)


def test_what_a_faulty_detector_reads_has_no_part_in_the_pose(estimator):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(7)
    image = model.expose(np.array([-5.0, 0.2, -0.1, 0.05, 0.1]), rng)
    estimates = []
    for reading in (0.0, 600.0, 1023.0):
        image[1, 3] = reading
        estimates.append(estimator.estimate(image))
        assert estimates[-1].left_out == ((1, 3),)
    for other in estimates[1:]:
        std = np.sqrt(other.covariance.diagonal())
        np.testing.assert_allclose(other.pose, estimates[0].pose, atol=0.02 * std.min())
        np.testing.assert_allclose(other.covariance, estimates[0].covariance, rtol=0.05)


@pytest.mark.parametrize("side", [3, 5])
def test_lines_of_neighbours_are_those_that_hold_two_of_them(side):
    rng = np.random.default_rng(side)
    for share in (0.05, 0.2, 0.5):
        for out in rng.random((20, 2 * side, side)) < share:  # of two lamps
            lines = lines_of_neighbours(out)
            for i, j in np.ndindex(2 * side, side):
                first = i - i % side
                row, column = out[i], out[first : first + side, j]
                pairs = [*pairwise(row), *pairwise(column)]
                assert lines[i, j] == ((True, True) in pairs)


def behind_a_hull(estimator, seed, count, left):
    """Return how many images have a pose of which a row is dimmed, and how many false ones."""
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(seed)
    poses = lit_poses(model, count, rng)
    light = model.light(poses)
    light[:, -1] *= left
    answered, false = 0, 0
    for pose, image in zip(poses, model.read(light, rng), strict=True):
        with suppress(NoPose):
            estimate = estimator.estimate(image)
            off = np.abs(estimate.pose - pose) / np.sqrt(estimate.covariance.diagonal())
            answered, false = answered + 1, false + (off > 6).any()
    return answered, false


def test_a_row_behind_the_hull_is_left_out_as_a_whole(estimator):
    """Three of its five detectors can be left out as faults, and the other two mislead."""
    answered, false = behind_a_hull(estimator, 9, 60, 0.5)
    assert answered > 20
    assert false <= 4  # one in forty is; five standard deviations


@pytest.mark.parametrize(("left", "most"), [(0.6, 0.1), (0.7, 0.15)])
def test_a_row_that_a_hull_dims_is_as_likely_as_the_neighbours_alone(estimator, left, most):
    """Else those of it that nearly fit are believed, and every fifth answer is false."""
    answered, false = behind_a_hull(estimator, 10, 100, left)
    assert answered > 40
    assert false <= most * answered


def clear_problem(estimator):
    return kinds_of(ForwardModel(estimator.scene))[0].problem


def test_the_readings_left_out_are_the_best_of_all_pairs(estimator):
    """By trying each pair, from the true pose, in a fit without it."""
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(8)
    pose = np.array([-5.0, 0.2, -0.1, 0.05, 0.1])
    image = model.expose(pose, rng)
    image[[0, 3], [2, 1]] = [0.0, 500.0]
    problem = kinds_of(model)[0].problem._replace(readings=image.ravel())
    costs = {}
    for pair in combinations(range(25), 2):
        weights = np.ones(25)
        weights[list(pair)] = 0
        if not {2, 16} & set(pair):
            continue  # both faults stay: far off
        trial = problem._replace(weights=weights)
        costs[pair] = refine(trial, start_at(trial, pose), MOST_STEPS).cost
    best = min(costs, key=costs.__getitem__)
    assert estimator.estimate(image).left_out == tuple(divmod(place, 5) for place in best)


@pytest.mark.parametrize("heat", [1.0, 9.0])
def test_weights_are_the_least_of_their_cost(estimator, heat):
    """The cost of doubt, of what is left of the residual, and of being undecided, by SciPy."""
    problem, squares = clear_problem(estimator), np.linspace(0, 60, 25)
    problem = problem._replace(weights=np.ones(25))
    _, added = weigh(squares, heat, problem.weights)
    costs = 0.0
    for square, weight in zip(squares, problem.weights, strict=True):

        def cost(w, half=0.5 * square / heat):
            return w * half + 4.5 * (1 - w) - entropy([w, 1 - w])

        found = minimize_scalar(cost, bounds=(0, 1), method="bounded", options={"xatol": 1e-9})
        assert weight == pytest.approx(found.x, abs=1e-5)
        costs += cost(weight) - weight * 0.5 * square / heat
    assert added == pytest.approx(costs)


@pytest.mark.parametrize("slope", [0.0, 0.3])
@pytest.mark.parametrize("light", [0.0, 80.0])
def test_a_faulty_detector_is_as_often_dimmed_as_brighter(estimator, light, slope):
    """One in a hundred is either; light in the noise counts as three of its deviations."""
    noise = clear_problem(estimator).noise._replace(low=0.0, high=1e9, slope=slope, square=0.0)
    std = np.sqrt(noise.variance)
    left_out = np.sqrt(2 * np.pi) * (1.0 if slope else std)  # of all costs

    def density(reading):
        log = log_faulty(np.array([reading]), np.array([light]), noise, np.zeros(1), 1)
        return np.exp(log) / left_out

    own = max(light, 3 * std)
    assert quad(density, 0, own)[0] == pytest.approx(0.005)
    brighter, _ = quad(lambda inverse: density(1 / inverse) / inverse**2, 1e-6 / own, 1 / own)
    assert brighter == pytest.approx(0.005, rel=1e-5)
    for limit in (noise.low, noise.high):
        log = log_faulty(np.array([limit]), np.array([light]), noise, np.zeros(1), 1)
        assert np.exp(log) == pytest.approx(0.0025)


@pytest.mark.parametrize(
    ("dark", "full", "level", "count"),
    [
        *((0, 0, 300, 3), (4, 0, 300, 3), (5, 0, 300, 2)),
        *((0, 4, 300, 3), (12, 0, 300, 1), (19, 0, 300, 0)),
        (0, 3, 20, 3),  # two percent of full scale are more than 20 counts, and daylight 15
    ],
)
def test_what_need_not_be_believed_is_a_seventh_of_what_is_lit(estimator, dark, full, level, count):
    readings = np.full(25, float(level))
    readings[:dark], readings[25 - full :] = 0, 1023
    problem = clear_problem(estimator)._replace(readings=readings)
    assert most_faulty(problem) == count
