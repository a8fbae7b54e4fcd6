"""Where fits start, and large arrays by few of their detectors."""

from contextlib import suppress

import numpy as np
import pytest
from fits import CountedProblem, guide_to, kinds_of
from scenes import changed, ready, seen_in

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import wrapped
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.frame import (
    BELIEVED,
    NOWHERE,
    estimate_frame,
    frame_result,
)
from uuv_optical_array.estimation.least_squares.hypotheses import Image
from uuv_optical_array.estimation.least_squares.problem import (
    evaluate,
    light_at,
    lit,
    longest_step,
    refine,
    settle,
    start_at,
)
from uuv_optical_array.estimation.least_squares.starts import direction, guide_of, light_of
from uuv_optical_array.estimation.least_squares.thinned import (
    kept_of,
    readings_of,
    thinned,
    thinned_blur,
    thinned_optics,
)
from uuv_optical_array.forward.aim import apparent
from uuv_optical_array.forward.drawn_sea import draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import lit_poses

POSE = np.array([-5.0, 0.3, -0.2, 0.1, -0.15])
BLUR = {"effects": {"forward_scatter": {"window_m": 0.05}}}


def of_side(side, scene="follow", **groups):
    return ForwardModel(changed(scene, array={"detectors_per_side": side}, **groups))


@pytest.mark.parametrize("side", [2, 5, 9, 16, 17, 21, 24, 51, 101, 501])
def test_the_detectors_that_are_kept_of_a_row_are_few_evenly_spaced_and_about_the_middle(side):
    kept = kept_of(side)
    assert len(set(np.diff(kept))) == 1
    assert len(kept) == side if side < 17 else 9 <= len(kept) <= 16
    assert abs(kept[0] - (side - 1 - kept[-1])) <= 1


@pytest.mark.parametrize(
    ("model", "tolerance"),
    [
        (of_side(21), 1e-12),
        (of_side(21, "leading_lights"), 1e-12),
        (of_side(34, "coastal"), 1e-12),
        (of_side(21, **BLUR), 6e-3),  # light between the detectors that are kept is nearly linear
    ],
)
def test_few_detectors_have_the_light_that_they_have_among_all(model, tolerance):
    side, lamps, kept = model.array.side, model.scene.lamp_count, kept_of(model.array.side)
    whole = model.light(POSE).reshape(lamps, side, side)[:, kept[:, None], kept].reshape(-1)
    optics, readings = model.optics(), readings_of(side, lamps)
    few = thinned_optics(optics, readings, thinned_blur(optics.blur, side))
    np.testing.assert_allclose(light_of(few, POSE[None])[0], whole, rtol=tolerance)


def test_the_problem_of_few_readings_is_that_of_all_without_the_others():
    model = of_side(21, "leading_lights")
    guide = guide_to(model)
    readings = model.expose(POSE, np.random.default_rng(2)).ravel()
    problem = Image(readings, 0.1).problem(kinds_of(model)[-1])
    few, at = thinned(problem, guide.readings, guide.blur), start_at(problem, POSE)
    weights = np.zeros_like(readings)
    weights[guide.readings] = 1
    own, other = evaluate(few, at), evaluate(problem._replace(weights=weights), at)
    assert own.cost == pytest.approx(other.cost, rel=1e-9)
    for told, wanted in (
        (own.gradient, other.gradient),
        (own.information, other.information),
    ):
        np.testing.assert_allclose(told, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_allclose(light_at(few, at), light_at(problem, at)[guide.readings])


def test_starts_of_a_large_array_are_compared_by_few_detectors_whose_light_they_have():
    model = of_side(101)
    guide = guide_of(model, 3, 4.0)
    assert guide.roots.shape == (81, len(guide.poses))
    chosen = [0, 700, len(guide.poses) - 1]
    images = model.converted(model.light(guide.poses[chosen]))
    few = images.reshape(3, -1)[:, guide.readings]
    np.testing.assert_allclose(guide.roots[:, chosen].T ** 2, few, atol=1e-9)
    # The signature of an image is that of its start.
    of_start = Image(images[0].ravel(), 0.0).problem(kinds_of(model)[0])
    np.testing.assert_allclose(direction(of_start.readings, guide), guide.units[:, 0], atol=1e-12)


@pytest.mark.parametrize("yaw_deg", [80, 90, 100, -105])
def test_an_array_that_looks_past_its_lamp_sees_it_by_the_edge_and_takes_it_for_no_nearer_one(
    yaw_deg, compiled_fit
):
    scene, rng = ready("follow"), np.random.default_rng(5)
    model, estimator = ForwardModel(scene), Estimator(scene).wait()
    far = []
    for _ in range(40):
        sea, pose = draw_sea(scene, rng), np.array([-4.5, 0.2, 0.1, 0.05, np.radians(yaw_deg)])
        (seen,) = apparent(scene, pose[None], sea.aims[None])
        with suppress(NoPose):
            found = estimator.estimate(seen_in(model, sea, seen, rng))
            off = wrapped(found.pose - pose) / np.sqrt(found.covariance.diagonal())
            far.append(abs(off).max())
    assert len(far) >= 36
    assert np.mean(np.array(far) > 6) < 0.05  # nine of ten at 100 deg, by starts that all face it


@pytest.mark.parametrize("level", [0.0, 30.0])
def test_what_daylight_may_read_is_not_lit(level):
    ambient = {"effects": {"ambient": {"level_counts": level}}}
    scene = changed("follow", **ambient, prior={"known": "exactly", "ambient_std_counts": 5.0})
    problem = kinds_of(ForwardModel(scene))[0].problem
    for daylight in (0.0, 9.0):
        readings = np.full(25, level + daylight)
        readings[:5] = level + daylight + 7.0
        readings[5:9] += 5.0
        assert lit(readings, problem) == 5
    # Nor is that of an array which a lamp lights evenly, beyond what daylight may be.
    assert lit(readings + 20, problem) == 25


@pytest.mark.parametrize(("side", "seed"), [(21, 1), (51, 2), (51, 3)])
def test_a_fit_of_a_large_array_ends_where_all_of_its_readings_have_their_minimum(side, seed):
    model, rng = of_side(side), np.random.default_rng(seed)
    guide = guide_to(model)
    stds = model.scene.prior.nuisance_std()
    sea = {name: std * rng.standard_normal() for name, std in stds.items()}
    image = Image(model.expose(POSE, rng, offsets=sea).ravel(), 0.0)
    problem = image.problem(kinds_of(model)[0])
    found = frame_result(estimate_frame, problem, guide, BELIEVED, NOWHERE).best
    best = evaluate(problem, np.append(start_at(problem, found[:5])[:5], found[5:]))
    pull, information = best.gradient, best.information
    assert pull @ np.linalg.solve(information, pull) < 0.1  # in squared standard deviations
    # It is no worse than what the true pose and sea lead to.
    truth = np.append(start_at(problem, POSE)[:5], list(sea.values()))
    assert best.cost < settle(problem, truth).cost + 0.1


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_narrow_valley_that_bends_is_followed_in_few_steps(sign):
    model, pose = of_side(51), np.array([-6.3, 0.59, -0.16, 0.03, -0.33])
    problem = CountedProblem(*Image(model.light(pose).ravel(), 0.0).problem(kinds_of(model)[0]))
    truth = start_at(problem, pose)  # where light without noise has its minimum
    state = evaluate(problem, truth)
    longest = np.array([longest_step(problem, i) for i in range(len(truth))])
    scale = np.outer(longest, longest)
    _, axes = np.linalg.eigh(state.information * scale)
    before = problem.evaluations
    best = settle(problem, truth + sign * longest * axes[:, 0])
    assert best.cost == pytest.approx(state.cost, abs=0.02)
    assert 1 < problem.evaluations - before <= 7  # steps that only lead downhill take 31 and more


def test_a_step_that_ends_beside_a_bent_valley_is_not_taken_back_at_once():
    """Against a descent that takes back each step uphill, in as many steps as it needs."""
    model, rng = of_side(51), np.random.default_rng(3)
    guide, clear = guide_to(model), kinds_of(model)[0]
    poses = lit_poses(of_side(5), 12, rng)  # of many poses images of the larger take long
    stds = model.scene.prior.nuisance_std()
    seas = {name: std * rng.standard_normal(12) for name, std in stds.items()}
    for image, pose in zip(model.expose(poses, rng, offsets=seas), poses, strict=True):
        problem = CountedProblem(*Image(image.ravel(), 0.0).problem(clear))
        few = thinned(problem, guide.readings, guide.blur)
        start = refine(few, start_at(few, pose)).at
        problem.evaluations = 0
        best = settle(problem, start)
        assert 1 < problem.evaluations <= 7
        assert best.cost < refine(problem, best.at, 300).cost + 0.05
