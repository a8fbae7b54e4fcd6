"""Images without the lamp: their probability, and that they get no pose where a lamp's get one."""

import re
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import changed, coarse, ready, seen_in, seen_in_each
from scipy.integrate import quad
from scipy.special import logsumexp
from scipy.stats import binom, multivariate_normal, norm

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.information.likelihood import log_likelihood
from uuv_optical_array.estimation.least_squares.frame_kinds import frame_kinds
from uuv_optical_array.estimation.least_squares.image_fit import SEEN, pose_prior
from uuv_optical_array.estimation.least_squares.no_lamp import NoLamp
from uuv_optical_array.forward.drawn_sea import draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import power_offsets

POSE = np.array([-6.0, 0.3, -0.2, 0.1, 0.05])
LEVEL, STD = 100.0, 8.0
DAYLIT = changed(
    coarse("reference"),
    effects={"sensor_noise": {"sigma_counts": 2.0}, "ambient": {"level_counts": LEVEL}},
    prior={"known": "exactly", "ambient_std_counts": STD, "uneven_probability": 0.1},
)
OUT = power_offsets([0.0], 1)


def no_lamp_of(scene):
    model = ForwardModel(scene)
    kinds = frame_kinds(model, *pose_prior(scene))
    return model, kinds, NoLamp(model, kinds)


def test_daylight_that_is_far_from_darkness_is_a_gaussian_of_many_readings():
    model, kinds, no_lamp = no_lamp_of(DAYLIT)
    variance, shares = model.noise.variance, [kind.share for kind in kinds]
    u, v = np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5))
    for seed in range(5):
        rng = np.random.default_rng(seed)
        slope = rng.normal(0, 10, 2)
        readings = (LEVEL + 6 + slope[0] * u + slope[1] * v).ravel() + rng.normal(0, 2, 25)
        logs = []
        for kind in kinds:
            rise = DAYLIT.full_scale_counts * 0.02 * kind.size
            spread = STD**2 * np.ones((25, 25))
            spread += rise**2 * sum(np.outer(way.ravel(), way.ravel()) for way in (u, v))
            covariance = variance * np.eye(25) + spread
            logs.append(multivariate_normal.logpdf(readings, np.full(25, LEVEL), covariance))
        expected = logsumexp(logs, b=shares) + 12.5 * np.log(2 * np.pi * variance)
        assert no_lamp.log_evidence(readings, shares) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("level", [1.0, 5.0, 30.0])
def test_daylight_of_few_photons_near_the_end_of_the_scale_is_integrated(level):
    effects = {"shot_noise": {"electrons_per_count": 2.0}, "ambient": {"level_counts": 3.0}}
    prior = {"known": "exactly", "ambient_std_counts": STD}
    scene = changed(DAYLIT, effects=effects, prior=prior)
    model, _, no_lamp = no_lamp_of(scene)
    readings = model.read(np.full((5, 5), level), np.random.default_rng(6)).ravel()

    def density(ambient):
        value, _, _ = log_likelihood(readings, np.full(25, ambient), model.noise)
        return np.exp(value.sum() - most) * norm.pdf(ambient, 3.0, STD)

    values, _, _ = log_likelihood(readings, np.full((25, 25), readings.mean()), model.noise)
    most = values[0].sum()
    whole, _ = quad(density, 0.0, 60.0, points=[level], limit=200)
    assert no_lamp.log_evidence(readings, [1.0]) == pytest.approx(np.log(whole) + most, abs=0.2)


@pytest.mark.parametrize("name", ["follow", "coastal", "night_plume", "formation"])
def test_what_bounds_the_probability_is_above_it(name):
    model, kinds, no_lamp = no_lamp_of(coarse(ready(name)))
    shares = [kind.share for kind in kinds]

    @given(st.integers(0, 2**32 - 1), st.floats(0, 60), st.floats(0, 200))
    def check(seed, level, rise):
        rng = np.random.default_rng(seed)
        light = level + rise * rng.random((5, 5)) ** 3
        readings = model.read(light, rng).ravel()
        assert no_lamp.log_evidence(readings, shares) <= no_lamp.most(readings) + 1e-6

    check()


def test_the_odds_that_a_refusal_says_are_those_of_sampled_poses(compiled_fit):
    scene = changed(DAYLIT, prior={"known": "exactly"}, effects={"ambient": None})
    model, rng = ForwardModel(scene), np.random.default_rng(3)
    middle, std = pose_prior(scene)
    poses = middle + std * rng.standard_normal((60_000, 5))
    # As no follower stands on its tail, or looks away from the lamp.
    poses = poses[(abs(poses[:, 3]) < np.pi / 3) & (poses[:, 0] < 0)]
    light, estimator, ratios = model.light(poses).reshape(-1, 25), Estimator(scene).wait(), []
    most = light.max(axis=1)
    dim = (most > 2) & (most < 4)
    lit = light[most > 1e-3]  # from elsewhere an image is as likely as in darkness
    for pose in poses[dim][:25]:
        image = model.expose(pose, rng)
        value, _, _ = log_likelihood(image.ravel(), lit, model.noise)
        alone, _, _ = log_likelihood(image.ravel(), np.zeros((1, 25)), model.noise)
        odds = np.exp(value.sum(axis=1) - alone.sum()).sum() + len(light) - len(lit)
        sampled = odds / 60_000
        if not 2 < sampled < SEEN / 2:
            continue
        with pytest.raises(NoPose, match="no light: the image is") as refusal:
            estimator.estimate(image)
        ratios.append(float(re.search(r"image is (\S+) times", str(refusal.value))[1]) / sampled)
    # A fit integrates about the best of the minima, which may be several alike.
    assert len(ratios) >= 5
    assert 0.3 < np.median(ratios) < 1
    assert max(ratios) < 1.2


@pytest.mark.parametrize("name", ["follow", "harbour", "clear_ocean"])
def test_of_images_without_the_lamp_in_drawn_daylight_no_more_get_a_pose_than_is_said(
    name, compiled_fit
):
    estimator, rng, posed = Estimator(ready(name)).wait(), np.random.default_rng(4), 100
    seas = [draw_sea(estimator.scene, rng) for _ in range(100)]
    for image in seen_in_each(ForwardModel(estimator.scene), seas, POSE, rng, OUT):
        with suppress(NoPose):
            estimator.estimate(image)
            continue
        posed -= 1
    assert posed <= binom.isf(1e-7, 100, 1 / SEEN)


def test_images_with_the_lamp_where_it_is_followed_all_get_a_pose(compiled_fit):
    scene, rng = ready("follow"), np.random.default_rng(5)
    model, estimator = ForwardModel(scene), Estimator(scene).wait()
    for range_m in np.linspace(3, 10, 100):
        sea = draw_sea(scene, rng)
        pose = np.array([-range_m, *rng.uniform(-0.1, 0.1, 2) * range_m, *rng.normal(0, 0.1, 2)])
        estimator.estimate(seen_in(model, sea, pose, rng))
