"""The censored Gaussian against SciPy's distributions, numerical derivatives and integrals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from uuv_optical_array.estimation.likelihood import Limits, information, log_likelihood

pytestmark = [
    pytest.mark.filterwarnings("error"),
    pytest.mark.usefixtures("strict_arithmetic"),
]

ADC = Limits(0.0, 1023.0)


def one(reading, light, variance=1.0, slope=0.0, limits=ADC):
    """Return value, score and curvature of one detector."""
    value, score, curvature = log_likelihood(
        *(np.array([each], dtype=float) for each in (reading, light, variance, slope)), limits
    )
    return float(value), float(score[0]), float(curvature[0])


def told_by(light, variance=1.0, slope=0.0, limits=ADC):
    """Return the information of one detector."""
    found = information(
        *(np.array([each], dtype=float) for each in (light, variance, slope)), limits
    )
    return float(found[0])


def scipy_value(reading, light, std, limits=ADC):
    """Log-probability of a reading; that of a censored one is the tail beyond half a count."""
    if reading >= limits.high:
        return norm.logsf(limits.high - 0.5, light, std)
    if reading <= limits.low:
        return norm.logcdf(limits.low + 0.5, light, std)
    return norm.logpdf(reading, light, std)


def derivative(function, at, step):
    """Central differences, with one step of Richardson's extrapolation."""
    coarse = (function(at + 2 * step) - function(at - 2 * step)) / (4 * step)
    fine = (function(at + step) - function(at - step)) / (2 * step)
    return (4 * fine - coarse) / 3


# Rounded, since SciPy itself squares what is tiny.
lights = st.floats(0.0, 1100.0).map(lambda light: round(light, 3))
readings = st.sampled_from([0.0, 1.0, 1022.0, 1023.0]) | lights.filter(lambda light: light < 1023)
stds = st.floats(0.2, 30.0)


@settings(deadline=None, max_examples=300)
@given(readings, lights, lights, stds)
def test_a_value_differs_from_another_lights_as_scipy_says(reading, light, other, std):
    """Differences, since the value has no constant."""
    ours = one(reading, light, std**2)[0] - one(reading, other, std**2)[0]
    theirs = scipy_value(reading, light, std) - scipy_value(reading, other, std)
    assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9)


@settings(deadline=None, max_examples=300)
@given(readings, lights, stds)
def test_the_score_is_the_derivative_of_scipys_log_probability(reading, light, std):
    score = one(reading, light, std**2)[1]
    expected = derivative(lambda at: scipy_value(reading, at, std), light, std * 1e-3)
    assert score * std == pytest.approx(expected * std, rel=1e-6, abs=1e-6)


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


@pytest.mark.parametrize(
    ("reading", "light"),
    [
        (reading, sign * light)
        for reading in (0.0, 1023.0)
        for light in (1e6, 1e12)
        for sign in (1, -1)
    ],
)
def test_a_light_beyond_all_reason_leaves_a_finite_likelihood(reading, light):
    value, score, curvature = one(reading, light, 1e-6)
    assert value <= 0
    assert np.isfinite([value, score, curvature]).all()
    wrong = (light < 0) == (reading > 0)
    if wrong:  # the light is pushed back as by a plain square
        bound = 1022.5 if reading else 0.5
        assert score == pytest.approx((bound - light) / 1e-6, rel=1e-6)
        assert curvature == pytest.approx(1e6, rel=1e-3)
    else:
        assert score == pytest.approx(0.0, abs=1e-200)


@settings(deadline=None, max_examples=300)
@given(st.floats(1.0, 1000.0), st.floats(1.0, 1000.0), st.floats(0.01, 10.0), st.floats(0.1, 50))
def test_noise_that_grows_with_the_light_is_in_value_and_score(reading, light, slope, dark):
    def variance(at):
        return dark + slope * at

    value, score, curvature = one(reading, light, variance(light), slope)
    other = one(reading, 500.0, variance(500.0), slope)[0]
    expected = norm.logpdf(reading, light, variance(light) ** 0.5)
    expected -= norm.logpdf(reading, 500.0, variance(500.0) ** 0.5)
    assert value - other == pytest.approx(expected, rel=1e-9, abs=1e-9)
    by_light = derivative(
        lambda at: norm.logpdf(reading, at, variance(at) ** 0.5), light, 1e-3 * light
    )
    assert score == pytest.approx(by_light, rel=1e-5, abs=1e-6)
    assert curvature == pytest.approx(told_by(light, variance(light), slope, Limits()), rel=1e-12)


def test_values_add_up_over_detectors_and_starts_stand_side_by_side():
    rng = np.random.default_rng(1)
    readings = np.array([0.0, 0.0, 17.0, 900.0, 1023.0, 1023.0])
    light = rng.uniform(0, 1100, (3, 6))
    variance, slope = 1 + light / 50, np.full((3, 6), 1 / 50)
    value, score, curvature = log_likelihood(readings, light, variance, slope, ADC)
    assert value.shape == (3,)
    for i in range(3):
        singles = [one(readings[j], light[i, j], variance[i, j], 1 / 50) for j in range(6)]
        # The constant of a reading is half the logarithm of the variance, as far as it varies.
        np.testing.assert_allclose(score[i], [single[1] for single in singles], rtol=1e-12)
        np.testing.assert_allclose(curvature[i], [single[2] for single in singles], rtol=1e-12)
        assert value[i] == pytest.approx(sum(single[0] for single in singles), rel=1e-12)


def expected_square_of_score(light, std, limits):
    """Fisher information of a reading, by integration over the readings."""

    def score_squared(reading):
        return ((reading - light) / std**2) ** 2 * norm.pdf(reading, light, std)

    low, high = limits.low + 0.5, limits.high - 0.5
    bottom, top = max(low, light - 12 * std), min(high, light + 12 * std)
    total = quad(score_squared, bottom, top, epsabs=1e-14)[0] if bottom < top else 0.0
    for u in ((low - light) / std, (light - high) / std):
        if np.isfinite(u):  # probability of the limit, times the square of its score
            total += np.exp(2 * norm.logpdf(u) - norm.logcdf(u)) / std**2
    return total


@pytest.mark.parametrize("std", [0.5, 1.0, 20.0])
@pytest.mark.parametrize("u", [-8.0, -3.0, -1.0, 0.0, 0.5, 2.0, 6.0, 30.0])
@pytest.mark.parametrize("limits", [ADC, Limits(0.0), Limits(high=1023.0)])
@np.errstate(under="ignore")
def test_the_information_is_the_mean_square_of_the_score(std, u, limits):
    for light in (0.5 + u * std, 1022.5 - u * std):
        expected = expected_square_of_score(light, std, limits) * std**2
        assert told_by(light, std**2, limits=limits) * std**2 == pytest.approx(
            expected, rel=1e-6, abs=1e-9
        )


def test_without_limits_the_information_is_the_textbooks():
    """N(m, v(m)): 1/v + v'^2 / (2 v^2), here as the mean square of a numerical score."""
    light, dark, slope = 40.0, 3.0, 0.5
    variance = dark + slope * light

    def logpdf(reading, at):
        return norm.logpdf(reading, at, (dark + slope * at) ** 0.5)

    def integrand(reading):
        score = derivative(lambda at: logpdf(reading, at), light, 1e-2)
        return score**2 * norm.pdf(reading, light, variance**0.5)

    with np.errstate(under="ignore"):
        expected = quad(integrand, light - 12 * variance**0.5, light + 12 * variance**0.5)[0]
    assert told_by(light, variance, slope, Limits()) == pytest.approx(expected, rel=1e-6)


@settings(deadline=None, max_examples=200)
@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e3), st.floats(0.0, 10.0))
def test_limits_never_add_information(light, std, slope):
    limited = told_by(light, std**2, slope)
    free = told_by(light, std**2, slope, Limits())
    assert 0 <= limited <= free * (1 + 1e-12)


def test_information_dies_where_the_limit_hides_the_light():
    assert told_by(1022.5 + 45.0) == pytest.approx(0.0, abs=1e-12)
    assert told_by(0.5 - 45.0) == pytest.approx(0.0, abs=1e-12)
    assert told_by(500.0) == pytest.approx(1.0)
