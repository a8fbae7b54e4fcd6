"""The Cramer-Rao bound: against independent sums, sampled scores, closed forms, known numbers."""

import math

import numpy as np
import pytest
from differences import differentiate
from scenes import SHAPES, WATER, make_scene, std_m_deg
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from uuv_optical_array.core.geometry import relative_pose
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound, fisher_information
from uuv_optical_array.forward.model import ForwardModel

pytestmark = pytest.mark.filterwarnings("error")

ALIGNED = np.array([[-4.0, 0, 0, 0, 0], [-6.0, 0, 0, 0, 0], [-8.0, 0, 0, 0, 0]])
ASIDE = np.array([-5.0, 0.4, -0.3, 0.1, 0.15])
AMBIENT = {"ambient": {"level_counts": 0.0}}
SHOT = {"shot_noise": {"electrons_per_count": 2.0}}
ADC = {"adc": {"bits": 10}}
# Strong noise and a low ceiling: many readings at either limit.
STD, CEILING = 200.0, 600.0
CENSORED = {
    "sensor_noise": {"sigma_counts": STD},
    "saturation": {"level_counts": CEILING},
    **ADC,
}
UNCERTAIN = {"lamp_power_std": 0.1, "k_std_per_m": 0.02, "ambient_std_counts": 5.0}


def make_model(*arguments, **settings):
    return ForwardModel(make_scene(*arguments, **settings))


def summed_information(model, pose, weight, offsets=()):
    """Fisher information about the pose and offsets at 0, by central differences of the light."""

    def light(at):
        given = {name: np.asarray(at[5 + i]) for i, name in enumerate(offsets)}
        return model.light(at[:5], 0.0, given).ravel()

    slopes = differentiate(light, np.concatenate([pose, np.zeros(len(offsets))]))
    return slopes.T @ np.diag(weight(model.light(pose).ravel())) @ slopes


def constant_noise(light):
    return np.ones_like(light)


def with_shot_noise(light):
    # Kay, 1993, eq. 3.31: 1 / v + v'^2 / (2 v^2), here with v = 1 + light / 2.
    variance = 1 + light / 2
    return 1 / variance + 0.5 * (0.5 / variance) ** 2


def censored(light):
    """Information of a reading of `CENSORED`: the score's mean square between and at the limits."""
    std = math.sqrt(STD**2 + 1 / 12)
    low, high = (0.5 - light) / std, (CEILING - 0.5 - light) / std
    between = norm.cdf(high) - norm.cdf(low) + low * norm.pdf(low) - high * norm.pdf(high)
    limits = norm.pdf(low) ** 2 / norm.cdf(low) + norm.pdf(high) ** 2 / norm.sf(high)
    return (between + limits) / std**2


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("effects", "weight"),
    [(WATER, constant_noise), ({**WATER, **SHOT}, with_shot_noise), (CENSORED, censored)],
)
def test_the_bound_is_that_of_explicit_sums_over_finite_differences(shape, effects, weight):
    model = make_model(shape, effects=effects)
    for pose in (ALIGNED[0], ASIDE):
        expected = summed_information(model, pose, weight)
        scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
        bound = cramer_rao_bound(model, pose)
        np.testing.assert_allclose(bound.information / scale, expected / scale, atol=1e-8)
        np.testing.assert_allclose(bound.std**2, np.linalg.inv(expected).diagonal(), rtol=1e-3)
        identity = bound.covariance @ bound.information
        np.testing.assert_allclose(identity, np.eye(5), atol=1e-5)
        assert bound.condition == pytest.approx(np.linalg.cond(expected), rel=1e-3)
        assert bound.observable.all()


def test_rounding_to_whole_counts_costs_a_twelfth_of_a_squared_count():
    light = np.linspace(300.0, 301.0, 11)
    counts = np.arange(295, 307)[:, None]

    def probability(light):
        return norm.cdf(counts + 0.5, light) - norm.cdf(counts - 0.5, light)

    h = 1e-5
    slope = (probability(light + h) - probability(light - h)) / (2 * h)
    exact = (slope**2 / probability(light)).sum(axis=0)  # of a rounded reading of sigma 1
    rounded = fisher_information(make_model(effects={**WATER, **ADC}), ASIDE)
    analogue = fisher_information(make_model(), ASIDE)
    np.testing.assert_allclose(rounded / analogue, exact.mean(), rtol=1e-3)


def test_curved_arrays_reach_the_numbers_worked_out_before():
    model = make_model("curved", beam_sigma_deg=15.0)
    std = std_m_deg(model, ALIGNED)
    for dof, known in ((1, [0.01, 0.07, 0.28]), (4, [0.3, 1.0, 2.8])):
        assert (np.abs(np.log(std[:, dof] / known)) < math.log(1.5)).all(), std[:, dof]
        np.testing.assert_allclose(std[:, dof], std[:, dof - 1 if dof == 4 else 2], rtol=1e-6)


def test_planar_arrays_reach_the_numbers_worked_out_before_a_little_off_alignment():
    # Exactly aligned is their worst pose: the image is even in y and yaw, which then hardly differ.
    model = make_model("planar", beam_sigma_deg=15.0)
    rng = np.random.default_rng(3)
    spread = rng.uniform(-1, 1, (500, 1, 5)) * [0, 0.1, 0.1, *np.radians([5, 5])]
    typical = np.median(std_m_deg(model, ALIGNED + spread), axis=0)
    aligned = std_m_deg(model, ALIGNED)
    for dof, known in ((1, [0.16, 1.8, 10]), (4, [10, 73, 290])):
        assert (np.abs(np.log(typical[:, dof] / known)) < math.log(1.5)).all(), typical[:, dof]
        ratio = aligned[:, dof] / known
        assert ((ratio > 1.5) & (ratio < 4)).all(), ratio


def test_planar_arrays_are_ill_conditioned_and_still_finite():
    model = make_model("planar", beam_sigma_deg=15.0)
    poses = np.zeros((21, 9, 5))
    poses[..., 0], poses[..., 1] = np.linspace(-8, -4, 21)[:, None], np.linspace(-1, 1, 9)
    bound = cramer_rao_bound(model, poses)
    assert bound.condition.max() > 1e7
    assert bound.observable.all()
    assert np.isfinite(bound.covariance).all()
    assert (np.linalg.eigvalsh(bound.covariance) > 0).all()
    curved = cramer_rao_bound(make_model("curved", beam_sigma_deg=15.0), poses)
    assert (curved.condition < bound.condition / 3).all()


@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_uncertain_counts_as_estimated_along_with_the_pose(shape):
    model = make_model(shape, effects={**WATER, **AMBIENT}, prior=UNCERTAIN)
    names = ("lamp.power", "attenuation.k_per_m", "ambient.level_counts")
    joint = summed_information(model, ASIDE, constant_noise, names)
    joint[range(5, 8), range(5, 8)] += 1 / np.array([0.1, 0.02, 5.0]) ** 2
    expected = np.sqrt(np.linalg.inv(joint).diagonal()[:5])
    np.testing.assert_allclose(cramer_rao_bound(model, ASIDE).std, expected, rtol=1e-3)


@pytest.mark.parametrize("prior", [None, {"lamp_power_std": 0.1, "k_std_per_m": 0.02}])
def test_without_light_nothing_is_observable(prior):
    ahead_of_the_lamp, turned_away = [6.0, 0, 0, 0, 0], [-6.0, 0, 0, 0, math.pi]
    far = [-900.0, 0, 0, 0, 0], [-1.0, 900.0, 0, 0, 0]
    bound = cramer_rao_bound(make_model(prior=prior), [ahead_of_the_lamp, turned_away, *far])
    assert not bound.observable.any()
    assert (bound.std == np.inf).all()
    assert (bound.condition == np.inf).all()
    assert np.isnan(bound.covariance[:, ~np.eye(5, dtype=bool)]).all()


def test_an_aligned_two_by_two_array_sees_the_range_and_nothing_else():
    # Three equations, left-right, up-down and the sum, for five unknowns.
    model = make_model("planar", 2)
    bound = cramer_rao_bound(model, ALIGNED[1])
    assert bound.observable.tolist() == [True, False, False, False, False]
    assert bound.condition == np.inf
    assert bound.std[0] == pytest.approx(bound.information[0, 0] ** -0.5, rel=1e-9)
    assert (bound.std[1:] == np.inf).all()
    assert np.isfinite(np.linalg.pinv(bound.information)).all()  # which would claim to know
    # What is seen is the limit of a prior that fades.
    weak = [np.linalg.inv(bound.information + np.eye(5) / std**2).diagonal() for std in (1e2, 1e3)]
    growth = weak[1] / weak[0]
    np.testing.assert_allclose(growth[bound.observable], 1, rtol=1e-6)
    np.testing.assert_allclose(growth[~bound.observable], 100, rtol=1e-2)


def test_many_poses_at_once_have_the_bounds_of_each():
    model = make_model(effects={**WATER, **AMBIENT}, prior=UNCERTAIN)
    poses = np.stack([ALIGNED, ALIGNED + 0.1])
    poses[1, 1, 4] = math.pi  # no light
    bound = cramer_rao_bound(model, poses)
    assert bound.observable.sum() == 25
    for i in np.ndindex(2, 3):
        one = cramer_rao_bound(model, poses[i])
        np.testing.assert_allclose(bound.std[i], one.std, rtol=1e-6)
        np.testing.assert_allclose(bound.covariance[i], one.covariance, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(bound.condition[i], one.condition, rtol=1e-6)
        assert (bound.observable[i] == one.observable).all()


def test_a_turn_about_the_beam_changes_neither_the_range_nor_how_well_it_is_known():
    model = make_model()
    turn = Rotation.from_rotvec([0.4, 0, 0])
    level = Rotation.from_euler("ZYX", [ASIDE[4], ASIDE[3], 0])
    pose, roll = relative_pose(
        np.zeros(3), np.eye(3), turn.apply(ASIDE[:3]), (turn * level).as_matrix()
    )
    assert roll == pytest.approx(0.4, abs=0.1)
    turned, before = cramer_rao_bound(model, pose, roll), cramer_rao_bound(model, ASIDE)
    assert turned.std[0] == pytest.approx(before.std[0], rel=1e-6)
    assert cramer_rao_bound(model, pose).std[0] != pytest.approx(before.std[0], rel=1e-2)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("effects", [{}, {**WATER, **AMBIENT, **SHOT, **ADC}])
def test_no_pose_makes_the_bound_stumble(shape, effects):
    model = make_model(shape, effects=effects, prior=UNCERTAIN if effects else None)
    rng = np.random.default_rng(5)
    poses = rng.uniform(-1, 1, (2000, 5)) * [10, 5, 5, 1.5, 3.1]
    poses[:5] = [[0] * 5, [-0.4, 0, 0, 0, 0], [-0.72, 0, 0, 0, 0], [-1e3] * 5, [1e3] * 5]
    with np.errstate(all="raise"):
        bound = cramer_rao_bound(model, poses)
        std = bound.std
    assert ((std > 0) & (np.isfinite(std) == bound.observable)).all()
    assert (bound.condition >= 1).all()
    both = bound.observable[:, :, None] & bound.observable[:, None, :]
    assert (np.isfinite(bound.covariance) == both).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_pose_that_is_not_finite_is_refused(bad):
    with pytest.raises(ValueError, match="poses: not finite"):
        cramer_rao_bound(make_model(), [[-6, 0, 0, 0, 0], [-6, 0, bad, 0, 0]])
