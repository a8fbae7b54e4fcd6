"""Frames that may be shaded: the mixture by evidence, against sampling and by its moments."""

import numpy as np
import pytest
from scenes import coarse, squared_error, with_prior

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.frame import FITTED, MISFIT, FrameResult
from uuv_optical_array.estimation.least_squares.frame_kinds import mixture
from uuv_optical_array.forward.model import ForwardModel

SCENE = coarse("reference")


def result(pose, std, outcome=FITTED):
    nothing, covariance = np.full(5, np.nan), np.diag(np.full(5, std**2))
    pose = np.array(pose, dtype=float)
    evidence, weights = (0.0, 0.0), np.ones(25)
    angles = np.array([0.1, 0.1])
    best = 0.0, nothing, np.nan, angles, pose, *evidence, weights, False
    return FrameResult(outcome, pose, covariance, *best)


def test_a_mixture_has_the_moments_of_draws_from_both_and_none_of_what_has_no_pose():
    one, other = result([-5, 0, 0, 0, 0], 0.1), result([-6, 0.2, 0, 0.1, 0], 0.3)
    lost, rng = result([-5, 0, 0, 0, 0], 0.1, MISFIT), np.random.default_rng(1)
    found, shares = mixture([one, other, lost], np.array([*np.log([0.75, 0.25]), 50.0]) + 7)
    np.testing.assert_allclose(shares, [0.75, 0.25, 0])
    draws = np.where(
        rng.random((400_000, 1)) < 0.75,
        one.pose + 0.1 * rng.standard_normal((400_000, 5)),
        other.pose + 0.3 * rng.standard_normal((400_000, 5)),
    )
    np.testing.assert_allclose(found.pose, draws.mean(axis=0), atol=5e-3)
    np.testing.assert_allclose(found.covariance, np.cov(draws.T), atol=5e-3)
    assert mixture([lost, lost], np.zeros(2))[0].outcome == MISFIT


def test_clear_frames_stay_sharp_and_shaded_ones_say_what_they_know():
    shady = with_prior(SCENE, shade_probability=0.3, shade_depth=0.2)
    model, rng = ForwardModel(shady), np.random.default_rng(3)
    believing, knowing = Estimator(SCENE), Estimator(shady)
    pose = np.array([-5.0, 0.2, -0.1, 0.1, 0.05])
    clear = model.expose(pose, rng)
    assert knowing.estimate(clear).clear > 0.5
    widths = [np.sqrt(e.estimate(clear).covariance.diagonal()) for e in (believing, knowing)]
    assert (widths[1] < 2.5 * widths[0]).all()
    errors, ranges = [], []
    for _ in range(40):
        sizes = np.array([0.05, 0.05, 0.0125, 0.0125, 0.0125]) * rng.standard_normal(5)
        off = {f"shade.mode_{k}": np.array(size) for k, size in enumerate(sizes, start=1)}
        even = np.exp(-0.2 + 0.2 * rng.standard_normal())
        rest = 1 + 0.0125 * rng.standard_normal((5, 5))
        found = knowing.estimate(model.read(model.light(pose, 0.0, off) * even * rest, rng))
        assert found.clear < 0.5
        errors.append(squared_error(found, pose))
        ranges.append((found.pose[0] - pose[0]) / np.sqrt(found.covariance[0, 0]))
    # A shade dims: what is dimmer than it should be is not farther away on average.
    assert abs(np.mean(ranges)) < 4 / np.sqrt(40)
    # Of a chi-square with five degrees of freedom, within five standard errors.
    assert np.mean(errors) < 5 + 5 * np.sqrt(10 / 40)
    assert max(errors) < 36


UNEVEN = with_prior(SCENE, uneven_probability=0.02)


def unevenly_lit(model, pose, share, rng):
    """Return an image with shade and daylight as their prior has them, or a share of it."""
    _, _, whole, *_ = model.scene.prior.lights(model.scene.full_scale_counts)
    stds = model.scene.prior.std_in(whole)
    off = {name: np.array(share * std * rng.standard_normal()) for name, std in stds.items()}
    rest = 1 + share * 0.0125 * rng.standard_normal((5, 5))
    return model.read(model.light(pose, 0.0, off) * rest, rng)


def squared_errors(estimator, model, share):
    """Return normalised squared errors of images that are lit unevenly."""
    rng = np.random.default_rng(4)
    pose, found = np.array([-5.0, 0.2, -0.1, 0.1, 0.05]), []
    for _ in range(40):
        estimate = estimator.estimate(unevenly_lit(model, pose, share, rng))
        found.append(squared_error(estimate, pose))
    return np.array(found)


def test_a_pose_in_uneven_light_is_as_wide_as_its_error():
    # None is refused, so that it is the covariance that is compared.
    believing, knowing = (Estimator(each, max_misfit=0.0) for each in (SCENE, UNEVEN))
    model = ForwardModel(UNEVEN)
    # Of a chi-square with five degrees of freedom, within five standard errors.
    assert abs(squared_errors(knowing, model, 1.0).mean() - 5) < 5 * np.sqrt(10 / 40)
    # Half of it leaves smaller residuals, by which a clear frame is sure and wrong. A few images
    # look like a smaller size, whose pose is too sure.
    half = squared_errors(knowing, model, 0.5)
    assert np.mean(half > 36) <= 0.05
    assert np.median(half) < 5
    assert squared_errors(believing, model, 0.5).max() > 100


def test_images_before_weigh_in_by_the_rule_of_bayes():
    model, rng = ForwardModel(UNEVEN), np.random.default_rng(5)
    image = unevenly_lit(model, np.array([-5.0, 0.2, -0.1, 0.1, 0.05]), 0.1, rng)
    estimator, odds = Estimator(UNEVEN), []
    # With such shares a linear look leaves doubt, and the image is taken for both.
    for share in (0.4, 0.5, 0.6):
        clear = estimator.estimate(image, uneven=share).clear
        assert 1e-4 < clear < 1 - 1e-4
        odds.append(clear / (1 - clear) * share / (1 - share))
    assert odds == pytest.approx([odds[0]] * 3, rel=1e-6)
