"""The censored Gaussian against SciPy's distributions, numerical derivatives and integrals."""

import numpy as np
import pytest
from needs import numba
from scipy.integrate import quad
from scipy.stats import norm

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.information.likelihood import (
    information,
    likelihood_of,
    log_likelihood,
)
from uuv_optical_array.forward.noise import MIN_VARIANCE, ReadingNoise

pytestmark = [pytest.mark.filterwarnings("error"), pytest.mark.usefixtures("strict_arithmetic")]

ADC, FREE = (0.0, 1023.0), (-np.inf, np.inf)


def one(reading, light, variance=1.0, slope=0.0, limits=ADC):
    """Return value, score and curvature of one detector; the variance is that in the dark."""
    noise = ReadingNoise(variance, slope, *limits)
    return tuple(map(float, log_likelihood(np.array(reading), np.array(light), noise)))


def told_by(light, variance=1.0, slope=0.0, limits=ADC):
    """Return the information of one detector."""
    return float(information(np.array(light), ReadingNoise(variance, slope, *limits)))


def scipy_value(reading, light, std, limits=ADC):
    """Log-probability of a reading; that of a censored one is the tail beyond half a count."""
    low, high = limits
    inside = norm.logpdf(reading, light, std)
    dark, full = norm.logcdf(low + 0.5, light, std), norm.logsf(high - 0.5, light, std)
    return np.select([reading >= high, reading <= low], [full, dark], inside)


def derivative(function, at, step):
    """Central differences, with one step of Richardson's extrapolation."""
    coarse = (function(at + 2 * step) - function(at - 2 * step)) / (4 * step)
    fine = (function(at + step) - function(at - step)) / (2 * step)
    return (4 * fine - coarse) / 3


def near_the_ends(rng, count):
    """Draw counts from 0 to 1100, of which some are at an end of the scale or beside it."""
    anywhere, ends = rng.uniform(0, 1100, count), rng.choice([0.0, 1.0, 1022.0, 1023.0], count)
    return np.where(rng.random(count) < 0.5, anywhere, ends)


@pytest.mark.parametrize("std", [0.2, 1.0, 3.0, 12.0, 30.0])
def test_value_and_score_are_those_of_scipys_log_probability(std):
    """Values by their difference from another light's, since they have no constant."""
    rng, noise = np.random.default_rng(4), ReadingNoise(std**2, 0.0, *ADC)
    readings = np.minimum(near_the_ends(rng, 400), 1023)
    # Anywhere, and where the reading is likely.
    light = np.where(rng.random(400) < 0.5, near_the_ends(rng, 400), rng.normal(readings, 3 * std))
    light, other = np.maximum(light, 0), near_the_ends(rng, 400)
    (value, score, _), (beside, _, _) = (
        log_likelihood(readings, at, noise) for at in (light, other)
    )
    theirs = scipy_value(readings, light, std) - scipy_value(readings, other, std)
    np.testing.assert_allclose(value - beside, theirs, rtol=1e-9, atol=1e-9)
    expected = derivative(lambda at: scipy_value(readings, at, std), light, std * 1e-3)
    np.testing.assert_allclose(score * std, expected * std, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("reading", [0.0, 1023.0])
@pytest.mark.parametrize("u", [-40.0, -37.5, -20.0, -5.0, -1.0, 0.0, 1.0, 5.0, 20.0, 40.0])
@pytest.mark.parametrize("std", [0.3, 1.0, 25.0])
def test_a_censored_reading_is_exact_far_into_both_tails(reading, u, std):
    """u counts standard deviations by which the light lies beyond the limit."""
    sign, bound = (1, 1022.5) if reading else (-1, 0.5)
    light = bound + sign * u * std
    value, score, curvature = one(reading, light, std**2)
    assert value == pytest.approx(norm.logcdf(u), rel=1e-9)
    hazard = np.exp(norm.logpdf(u) - norm.logcdf(u)) if u < 38 else 0.0
    assert sign * score * std == pytest.approx(hazard, rel=1e-9, abs=1e-200)
    # Of the second derivative phi (phi + u Phi) / Phi^2, between 0 and 1 everywhere.
    assert 0 <= curvature * std**2 <= 1
    if u < -10:  # the asymptotic series, where the formula cancels
        assert curvature * std**2 == pytest.approx(1 - 1 / u**2 + 6 / u**4, abs=60 / u**6 + 1e-6)
    else:
        assert curvature * std**2 == pytest.approx(hazard * (hazard + u), rel=1e-6, abs=1e-200)


@pytest.mark.parametrize("reading", [0.0, 1023.0])
@pytest.mark.parametrize("light", [1e6, -1e6, 1e12, -1e12])
def test_a_light_beyond_all_reason_leaves_a_finite_likelihood(reading, light):
    value, score, curvature = one(reading, light, 1e-6)
    assert value <= 0
    assert np.isfinite([value, score, curvature]).all()
    if (light < 0) == (reading > 0):  # the light is pushed back as by a plain square
        bound = 1022.5 if reading else 0.5
        assert score == pytest.approx((bound - light) / 1e-6, rel=1e-6)
        assert curvature == pytest.approx(1e6, rel=1e-3)
    else:
        assert score == pytest.approx(0.0, abs=1e-200)


@pytest.mark.parametrize("slope", [0.01, 0.3, 10.0])
@pytest.mark.parametrize("dark", [0.1, 4.0, 50.0])
def test_noise_that_grows_with_the_light_is_in_value_and_score(dark, slope):
    rng = np.random.default_rng(5)
    readings, light = rng.uniform(1, 1000, (2, 200))
    light[:100] = readings[:100] * rng.uniform(0.9, 1.1, 100)
    noise = ReadingNoise(dark, slope, *ADC)

    def scipys(at):
        return norm.logpdf(readings, at, np.sqrt(dark + slope * at))

    value, score, curvature = log_likelihood(readings, light, noise)
    beside, _, _ = log_likelihood(readings, np.full(200, 500.0), noise)
    np.testing.assert_allclose(value - beside, scipys(light) - scipys(500.0), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(score, derivative(scipys, light, 1e-3 * light), rtol=1e-5, atol=1e-6)
    told = information(light, ReadingNoise(dark, slope, *FREE))
    np.testing.assert_allclose(curvature, told, rtol=1e-12)


@pytest.mark.parametrize("slope", [0.0, 1 / 50])
def test_each_reading_of_many_images_is_as_it_is_alone(slope):
    rng = np.random.default_rng(1)
    readings = np.array([0.0, 0.0, 17.0, 900.0, 1023.0, 1023.0])
    light = rng.uniform(0, 1100, (2, 3, 6))
    found = log_likelihood(readings, light, ReadingNoise(1.0, slope, *ADC))
    for part in found:
        assert part.shape == (2, 3, 6)
    for i in np.ndindex(2, 3, 6):
        alone = one(readings[i[-1]], light[i], 1.0, slope)
        np.testing.assert_allclose([part[i] for part in found], alone, rtol=1e-12)


def test_a_variance_below_the_least_counts_as_that():
    found, least = (one(40.3, 40.0, variance) for variance in (1e-9, MIN_VARIANCE))
    assert found == least == pytest.approx((-0.045e6, 0.3e6, 1e6))


def test_below_the_least_variance_shot_noise_does_not_grow_and_tells_nothing_more():
    """Of 300 electrons a count and no other noise, a ten-thousandth of a count is darkness."""
    light, noise = 1e-4, (0.0, 1 / 300, FREE)
    _, score, curvature = one(2e-3, light, *noise)
    assert score == pytest.approx((2e-3 - light) / MIN_VARIANCE)
    assert curvature == told_by(light, *noise) == pytest.approx(1 / MIN_VARIANCE)


def test_the_light_below_zero_has_the_noise_of_the_dark():
    for light in (-3.0, 0.0):
        found, score, _ = one(5.0, light, 2.0, 0.5, FREE)
        # Less the constant, which two lights of one variance share.
        assert found + 0.5 * np.log(2.0) == pytest.approx(-0.5 * (5.0 - light) ** 2 / 2.0)
        assert score == pytest.approx((5.0 - light) / 2.0)


@numba
@pytest.mark.parametrize("slope", [0.0, 1 / 50])
@pytest.mark.parametrize("limits", [ADC, FREE])
@np.errstate(under="ignore")
def test_compiled_readings_are_as_likely_as_in_numpy(slope, limits):
    rng = np.random.default_rng(2)
    light = np.concatenate([rng.uniform(-60, 1100, 3000), rng.choice([-1e9, 0.0, 1e9], 100)])
    readings = np.clip(rng.normal(light, rng.choice([0.1, 3.0, 40.0], 3100)), 0, 1023)
    noise = ReadingNoise(2.0, slope, *limits)
    plain, fast = np.empty((2, 3, 3100))
    likelihood_of(readings, light, noise, plain)
    compilation.compiled(likelihood_of)(readings, light, noise, fast)
    np.testing.assert_allclose(fast[:2], plain[:2], rtol=1e-11, atol=1e-300)
    # Far beyond a limit the curvature is the difference of two numbers 1000 times its size.
    np.testing.assert_allclose(fast[2], plain[2], rtol=1e-9, atol=1e-300)
    assert np.isfinite(plain).all()


def expected_square_of_score(light, std, limits):
    """Fisher information of a reading, by integration over the readings."""

    def score_squared(reading):
        return ((reading - light) / std**2) ** 2 * norm.pdf(reading, light, std)

    low, high = limits[0] + 0.5, limits[1] - 0.5
    bottom, top = max(low, light - 12 * std), min(high, light + 12 * std)
    total = quad(score_squared, bottom, top, epsabs=1e-14)[0] if bottom < top else 0.0
    for u in ((low - light) / std, (light - high) / std):
        if np.isfinite(u):  # probability of the limit, times the square of its score
            total += np.exp(2 * norm.logpdf(u) - norm.logcdf(u)) / std**2
    return total


@pytest.mark.parametrize("std", [0.5, 1.0, 20.0])
@pytest.mark.parametrize("u", [-8.0, -3.0, -1.0, 0.0, 0.5, 2.0, 6.0, 30.0])
@pytest.mark.parametrize("limits", [ADC, (0.0, np.inf), (-np.inf, 1023.0)])
@np.errstate(under="ignore")
def test_the_information_is_the_mean_square_of_the_score(std, u, limits):
    for light in (0.5 + u * std, 1022.5 - u * std):
        found = told_by(light, std**2, limits=limits) * std**2
        expected = expected_square_of_score(light, std, limits) * std**2
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("slope", [0.0, 0.02, 10.0])
@pytest.mark.parametrize("std", [1e-3, 1.0, 30.0, 1e3])
@np.errstate(under="ignore")
def test_limits_never_add_information(std, slope):
    near = np.linspace(-100, 1200, 1301)
    light = np.concatenate([near, [-1e6, -1e4, 1e4, 1e6]])
    limited, free = (
        information(light, ReadingNoise(std**2, slope, *limits)) for limits in (ADC, FREE)
    )
    assert (limited >= 0).all()
    assert (limited <= free * (1 + 1e-12)).all()
