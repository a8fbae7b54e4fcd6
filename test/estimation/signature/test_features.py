"""The five key parameters against a slow second implementation, and every hard case by hand."""

import math

import numpy as np
import pytest
from needs import numba
from second_features import slow_key_parameters

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.signature.features import (
    FEATURE_NAMES,
    key_parameters,
    lifted,
    no_pattern,
    prepare,
    write_parameters,
)
from uuv_optical_array.forward.scene import SignatureSettings

pytestmark = [pytest.mark.filterwarnings("error"), pytest.mark.usefixtures("strict_but_for_zeros")]

FULL_SCALE = 1023.0
PEAKS = ("detector", "subdetector")


@pytest.mark.parametrize("peak", PEAKS)
@pytest.mark.parametrize("most", [1, 3, 1023])
@pytest.mark.parametrize("side", range(2, 9))
def test_any_image_has_the_parameters_of_the_slow_implementation(side, most, peak):
    """Its brightness scales the peak and nothing else; few counts make many ties."""
    rng = np.random.default_rng(side)
    for image in rng.integers(0, most + 1, (6, side, side)).astype(float):
        scale = 10.0 ** rng.choice([0.0, rng.uniform(-300, 300)])
        expected = slow_key_parameters(image, FULL_SCALE, peak)
        found = key_parameters(image * scale, FULL_SCALE, peak)
        assert found[0] == pytest.approx(expected[0] * scale, rel=1e-12, abs=0)
        np.testing.assert_allclose(found[1:], expected[1:], atol=1e-9)


@pytest.mark.parametrize("side", [3, 4, 5, 7, 21])
def test_the_subdetector_peak_of_a_sampled_paraboloid_is_its_vertex(side):
    rng, index = np.random.default_rng(side), np.arange(side)
    place = rng.uniform(0.51, side - 1.51, (100, 2, 1, 1))
    bend = rng.uniform(0.01, 1.0, (100, 2, 1, 1))
    (row, column), (down, across) = place.swapaxes(0, 1), bend.swapaxes(0, 1)
    images = 900 - down * (index[:, None] - row) ** 2 - across * (index - column) ** 2
    centred = place[:, ::-1, 0, 0] - (side - 1) / 2
    sub, whole = (key_parameters(images, FULL_SCALE, peak)[:, 1:3] for peak in reversed(PEAKS))
    np.testing.assert_allclose(sub, centred, atol=1e-9)
    rounded = np.rint(place[:, ::-1, 0, 0]) - (side - 1) / 2
    np.testing.assert_array_equal(whole, rounded)


@pytest.mark.parametrize("peak", PEAKS)
@pytest.mark.parametrize("side", [2, 3, 4, 5, 7, 21])
def test_no_light_is_five_zeros_and_full_light_sits_at_the_centre(side, peak):
    dark = key_parameters(np.zeros((side, side)), FULL_SCALE, peak)
    np.testing.assert_array_equal(dark, np.zeros(5))
    assert not np.signbit(dark).any()
    full = key_parameters(np.full((side, side), FULL_SCALE), FULL_SCALE, peak)
    # An even side has no central detector: a whole detector is then half a step off.
    off = 0.5 if side % 2 == 0 and peak == "detector" else 0.0
    np.testing.assert_array_equal(full, [1.0, -off, -off, 0.0, 0.0])
    prepare(side)  # compiled, where divisions may be by reciprocals
    compiled = key_parameters(np.full((side, side), FULL_SCALE), FULL_SCALE, peak)
    np.testing.assert_array_equal(compiled, full)


@pytest.mark.parametrize(
    ("saturated", "middle", "whole"),
    [
        ([(2, 2)], (0, 0), (0, 0)),
        ([(1, 2), (1, 3)], (-1, 0.5), (-1, 0)),
        ([(0, 0), (0, 1), (1, 0), (1, 1)], (-1.5, -1.5), (-2, -2)),
        ([(3, 1), (3, 2), (3, 3)], (1, 0), (1, 0)),
        # An L: the centroid (row 2.6, column 1.4) is nearest to row 3, column 1.
        ([(1, 1), (2, 1), (3, 1), (3, 2), (4, 2)], (0.6, -0.6), (1, -1)),
    ],
)
def test_a_saturated_top_has_its_peak_at_the_centroid(saturated, middle, whole):
    image = np.full((5, 5), 100.0)
    for place in saturated:
        image[place] = FULL_SCALE
    sub = key_parameters(image, FULL_SCALE, "subdetector")
    np.testing.assert_allclose(sub[:3], [1.0, middle[1], middle[0]], atol=1e-12)
    np.testing.assert_array_equal(
        key_parameters(image, FULL_SCALE, "detector")[:3], [1.0, whole[1], whole[0]]
    )
    expected = slow_key_parameters(image, FULL_SCALE, "subdetector")
    np.testing.assert_allclose(sub, expected, atol=1e-12)


@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e300])
def test_profiles_that_are_constant_or_evenly_sloped_have_no_skewness(scale):
    for image in (np.full((5, 5), scale), np.tile(np.arange(5) * scale, (5, 1))):
        np.testing.assert_array_equal(key_parameters(image, FULL_SCALE, "detector")[3:], [0.0, 0.0])


@pytest.mark.parametrize(
    ("images", "why"),
    [
        *((np.ones(shape), "shape") for shape in ((5,), (5, 4), (1, 1), (3, 4, 5), ())),
        *((np.array([[1.0, 2.0], [bad, 3.0]]), "not finite") for bad in (math.nan, -math.inf)),
        (np.stack([np.ones((5, 5)), np.full((5, 5), math.inf)]), "not finite"),
    ],
)
def test_images_that_are_not_square_or_not_finite_are_refused(images, why):
    with pytest.raises(ValueError, match=why):
        key_parameters(images, FULL_SCALE, "subdetector")


@pytest.mark.parametrize("peak", PEAKS)
def test_a_batch_answers_as_its_images_one_by_one_and_is_left_untouched(peak):
    assert key_parameters(np.empty((3, 0, 5, 5)), FULL_SCALE, peak).shape == (3, 0, 5)
    images = np.random.default_rng(3).integers(0, 6, (2, 3, 4, 5, 5)).astype(float)
    images[1, 2] = 0.0
    kept = images.copy()
    batch = key_parameters(images, FULL_SCALE, peak)
    assert batch.shape == (2, 3, 4, len(FEATURE_NAMES))
    for place in np.ndindex(2, 3, 4):
        single = key_parameters(images[place], FULL_SCALE, peak)
        assert single.shape == (5,)
        np.testing.assert_allclose(batch[place], single, atol=1e-15)
    np.testing.assert_array_equal(images, kept)


@numba
@pytest.mark.parametrize("side", [2, 4, 5])
@pytest.mark.parametrize("peak", PEAKS)
def test_compiled_parameters_are_those_of_numpy(side, peak):
    rng, shape = np.random.default_rng(side), (64, side, side)
    # With many ties, darkness and full light among them.
    images = np.concatenate([rng.uniform(0, 900, shape), rng.integers(0, 4, shape)])
    images[:2] = np.array([0, FULL_SCALE])[:, None, None]
    expected = np.empty((5, 128))
    readings = np.ascontiguousarray(images.reshape(128, -1).T)
    write_parameters(readings, side, FULL_SCALE, peak == "subdetector", expected)
    prepare(side)
    assert compilation.loaded(write_parameters).signatures
    found = key_parameters(images, FULL_SCALE, peak)
    np.testing.assert_allclose(found, expected.T, rtol=1e-12, atol=1e-13)


def test_the_matched_vector_weighs_each_parameter_and_ends_with_the_lift():
    settings_ = SignatureSettings(
        peak_weight=3.0, position_weight=5.0, skewness_weight=7.0, lift=11.0
    )
    # Half the width of a 5 x 5 array is two detectors.
    found = lifted([[1.0, 2.0, -1.0, 0.5, -0.25]], settings_, 5)
    np.testing.assert_allclose(found, [[3.0, 5.0, -2.5, 3.5, -1.75, 11.0]], rtol=1e-15)


def test_an_image_without_a_pattern_says_why_with_the_figure():
    assert no_pattern(np.zeros((5, 5)), 5.0) == "no light: the peak of 0 counts is below 5"
    assert "7 counts" in no_pattern(np.full((5, 5), 7.0), 5.0)
    assert "no pattern" in no_pattern(np.full((5, 5), FULL_SCALE), 5.0)
    lit = np.zeros((5, 5))
    lit[0, 4] = 5.0
    assert no_pattern(lit, 5.0) is None
    assert "4.5 counts" in no_pattern(lit * 0.9, 5.0)


def test_readings_that_differ_by_rounding_are_equally_bright():
    rng = np.random.default_rng(3)
    for _ in range(20):
        half = rng.uniform(50, 900, (5, 3))
        image = np.hstack([half, half[:, 1::-1]])  # it mirrors itself
        off = image * (1 + 4e-16 * rng.integers(-2, 3, image.shape))
        found, exact = (key_parameters(each, FULL_SCALE, "subdetector") for each in (off, image))
        np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-9)
