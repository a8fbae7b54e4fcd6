"""The likelihood of a calibration and the steps of its solver: gradient, bounds, what is held."""

import numpy as np
import pytest
from calibrated_seas import drive, lights, sea, truth_of

from uuv_optical_array.calibration.fit import (
    MAX_STEP,
    CalibrationProblem,
    evaluate,
    outward,
    propose,
    refine,
)
from uuv_optical_array.calibration.identifiability import undetermined
from uuv_optical_array.calibration.likelihood import CalibrationLikelihood, Unknowns
from uuv_optical_array.calibration.parameters import BACKGROUND, POWER, SIGMA, K, Layout
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

FIRST_GAIN = 11  # of one lamp


@pytest.mark.parametrize(
    ("start", "pose_std", "images_a_place"),
    [
        ("follow", None, 1),
        ("reference", None, 1),
        ("reference", [0.02, 0.01, 0.01, 0.01, 0.02], 1),
        ("reference", [0.02, 0.01, 0.01, 0.01, 0.02], 3),
        ("leading_lights", None, 1),
        ("leading_lights", [0.02, 0.01, 0.01, 0.01, 0.02], 3),
    ],
)
def test_the_gradient_is_that_of_the_value(start, pose_std, images_a_place):
    rng = np.random.default_rng(3)
    scene = sea(start, shot_noise__electrons_per_count=30.0)
    scene = lights(rng) if scene.lamps else scene
    poses, rolls = drive(rng, 24)
    places = np.arange(24) % (24 // images_a_place)
    poses, rolls = poses[places], rolls[places]
    images = ForwardModel(scene).expose(poses, rng, rolls)
    std = None if pose_std is None else np.array(pose_std)
    start = load_scene(start)
    likelihood = CalibrationLikelihood(start, images, poses, rolls, std, places)
    middle = likelihood.unshifted(likelihood.start())
    shifts = rng.normal(size=middle.shifts.shape) * (0 if std is None else likelihood.pose_std)
    here = middle.parameters + 0.05 * rng.standard_normal(len(middle.parameters))
    if std is not None:
        # Of the shifts that follow the parameters, so that they leave nothing to gain.
        for _ in range(60):
            shifts = shifts + likelihood.evaluate(Unknowns(here, shifts)).shift_step
        assert np.abs(likelihood.evaluate(Unknowns(here, shifts)).shift_step).max() < 1e-5
        aside = 1e-5 * rng.normal(size=shifts.shape) * likelihood.pose_std
        ahead, behind = (likelihood.evaluate(Unknowns(here, shifts + x)) for x in (aside, -aside))
        assert abs(ahead.cost - behind.cost) / 2e-5 < 1e-2
    gradient = likelihood.evaluate(Unknowns(here, shifts)).gradient
    for i, step in enumerate(1e-5 * np.eye(len(here))):
        ahead, behind = (likelihood.evaluate(Unknowns(here + x, shifts)) for x in (step, -step))
        slope = (behind.cost - ahead.cost) / 2e-5
        assert slope == pytest.approx(gradient[i], rel=5e-5, abs=1e-2)


def problem_of(pose_std=None, held=(), seed=3):
    """Return a problem of 30 images, and a place aside of where the fit starts."""
    scene = sea()
    rng = np.random.default_rng(seed)
    poses, rolls = drive(rng, 30)
    images = ForwardModel(scene).expose(poses, rng, rolls)
    std = None if pose_std is None else np.array(pose_std)
    likelihood = CalibrationLikelihood(load_scene("reference"), images, poses, rolls, std)
    shifts = rng.normal(size=poses.shape) * (0 if std is None else 0.3 * std)
    steps = []
    problem = CalibrationProblem(likelihood, frozenset(held), lambda: steps.append(1))
    return (
        problem,
        Unknowns(truth(likelihood, scene) + 0.01 * rng.standard_normal(36), shifts),
        steps,
    )


def truth(likelihood, scene):
    """Return the parameters of a scene."""
    values, gains = truth_of(scene)
    layout = likelihood.layout
    found = np.append([values.get(name, 1.0) for name in layout.names], gains)
    return np.where(layout.logarithm, np.log(np.maximum(found, 1e-9)), found)


@pytest.mark.parametrize("damping", [1e-9, 0.3])
@pytest.mark.parametrize("pose_std", [None, [0.02, 0.01, 0.01, 0.01, 0.02]])
def test_a_step_promises_half_of_the_slope_of_the_cost_along_it(pose_std, damping):
    """It holds for the solution of damped normal equations alone, shifts of the poses included."""
    problem, at, steps = problem_of(pose_std)
    state = evaluate(problem, at)
    trial, decrement = propose(problem, state, damping)
    assert len(steps) == 1
    step = np.array(trial.parameters) - at.parameters, trial.shifts - at.shifts
    assert np.abs(step[0]).max() > 1e-3
    assert step[0][FIRST_GAIN:].sum() == pytest.approx(0, abs=1e-12)
    ahead, behind = (
        evaluate(problem, Unknowns(at.parameters + x * step[0], at.shifts + x * step[1])).cost
        for x in (1e-4, -1e-4)
    )
    assert (behind - ahead) / 2e-4 == pytest.approx(2 * decrement, rel=1e-3)


def test_a_step_keeps_to_the_bounds_and_leaves_what_is_held():
    held = [SIGMA, FIRST_GAIN + 3]
    problem, at, _ = problem_of(held=held)
    layout = problem.likelihood.layout
    far = at.parameters.copy()
    far[POWER], far[K], far[BACKGROUND] = 3.0, 0.05, 3.0
    state = evaluate(problem, Unknowns(far, at.shifts))
    trial, _ = propose(problem, state, 1e-3)
    assert trial.parameters[POWER] - far[POWER] == pytest.approx(MAX_STEP)
    np.testing.assert_array_equal(trial.parameters[held], far[held])
    found = refine(problem, Unknowns(far, at.shifts))
    np.testing.assert_array_equal(found.at.parameters[held], far[held])
    assert found.cost < state.cost
    # Readings less than dark: the background is at its bound, what goes inwards is free.
    problem.likelihood.readings = problem.likelihood.readings - 100.0
    dark = at.parameters.copy()
    dark[BACKGROUND] = 0.0
    state = evaluate(problem, Unknowns(dark, at.shifts))
    assert BACKGROUND in outward(layout, state)
    trial, _ = propose(problem, state, 1e-3)
    assert trial.parameters[BACKGROUND] == 0
    assert (trial.parameters >= layout.low).all()
    assert (trial.parameters <= layout.high).all()
    dark[BACKGROUND] = 1.0
    assert BACKGROUND not in outward(layout, evaluate(problem, Unknowns(dark, at.shifts)))


def test_poses_are_fitted_even_where_every_parameter_is_held():
    problem, at, _ = problem_of([0.02, 0.01, 0.01, 0.01, 0.02], held=range(36))
    found = refine(problem, at)
    np.testing.assert_array_equal(found.at.parameters, at.parameters)
    aside = evaluate(problem, at)
    assert found.cost < aside.cost - 1
    assert np.abs(found.shift_step / problem.likelihood.pose_std).max() < 0.02


@pytest.mark.parametrize(("reach_m", "gains_known"), [(0.24, True), (0.26, False)])
def test_gains_are_held_where_an_unknown_attenuation_would_shift_them_by_half_a_per_cent(
    reach_m, gains_known
):
    """At one pose K, uncertain by 0.02 /m, shifts a gain by 0.02 /m times its excess range."""
    excess = np.linspace(-reach_m, reach_m, 9)
    layout = Layout(sea(gains=None, array__detectors_per_side=3))
    slopes = np.zeros((9, FIRST_GAIN + 9))
    slopes[:, POWER], slopes[:, K], slopes[:, FIRST_GAIN:] = 1.0, -(6.0 + excess), np.eye(9)
    information = 1e6 * slopes.T @ slopes
    others = frozenset(range(FIRST_GAIN)) - {POWER, K}
    unknown, correlated = undetermined(layout, information, others)
    assert unknown == ({K} if gains_known else {K, *range(FIRST_GAIN, FIRST_GAIN + 9)})
    assert correlated[POWER] == K
