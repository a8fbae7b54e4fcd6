"""Where the detectors sit and look, against equations 9 to 12 written out one by one."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uuv_optical_array.forward.array import ArraySettings, build_array

sides = st.one_of(st.sampled_from([2, 3, 4, 5, 21, 100, 101]), st.integers(2, 101))
widths = st.floats(0.05, 5)
bows = st.floats(-3, 3)
few = settings(max_examples=40)


def every_detector(side, width):
    """Yield y and z of each detector: rows from the top, columns from the port edge."""
    spacing = width / (side - 1)
    for row in range(side):
        for column in range(side):
            yield width / 2 - column * spacing, width / 2 - row * spacing


@given(side=sides, width=widths, bow=bows)
@few
def test_a_planar_array_lies_in_one_plane_and_looks_ahead(side, width, bow):
    array = build_array(ArraySettings("planar", side, width, bow))
    expected = [(bow, y, z) for y, z in every_detector(side, width)]
    np.testing.assert_allclose(array.positions, expected, atol=1e-12)
    np.testing.assert_array_equal(array.normals, [(1.0, 0.0, 0.0)] * side**2)
    assert array.side == side
    assert array.spacing_m == pytest.approx(width / (side - 1), rel=1e-15)


@given(side=sides, width=widths, bow=bows, slack=st.floats(0.001, 5))
@few
def test_a_curved_array_lies_on_its_sphere_and_looks_along_the_radius(side, width, bow, slack):
    radius = width / math.sqrt(2) * (1 + slack)
    array = build_array(ArraySettings("curved", side, width, bow, radius))
    depth = [math.sqrt(radius**2 - y**2 - z**2) for y, z in every_detector(side, width)]
    yz = np.array(list(every_detector(side, width)))
    np.testing.assert_allclose(array.positions[:, 0], bow + np.array(depth), atol=1e-12)
    np.testing.assert_allclose(array.positions[:, 1:], yz, atol=1e-12)
    outward = array.positions - [bow, 0, 0]
    np.testing.assert_allclose(np.linalg.norm(outward, axis=1), radius, rtol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(array.normals, axis=1), 1, rtol=1e-13)
    np.testing.assert_allclose(np.cross(array.normals, outward), 0, atol=1e-12)
    assert (array.normals[:, 0] > 0).all()


@pytest.mark.parametrize(
    ("given_settings", "words"),
    [
        (("curved", 5, 0.4, 0.4, 0.28), ["radius_m", "0.28 m", "0.2828 m", "larger"]),
        (("curved", 5, 0.4, 0.4, 0.4 / math.sqrt(2)), ["radius_m", "larger"]),
        (("curved", 5), ["radius_m", "missing", "curved"]),
    ],
    ids=["too small", "just too small", "missing"],
)
def test_a_radius_that_does_not_fit_is_refused_by_name(given_settings, words):
    with pytest.raises(ValueError, match="radius_m") as refusal:
        ArraySettings(*given_settings)
    for word in words:
        assert word in str(refusal.value)


def test_a_radius_just_large_enough_still_gives_finite_corners():
    width, radius = 5.085561325595337, 3.5960348994685103
    with np.errstate(all="raise"):
        array = build_array(ArraySettings("curved", 5, width, 0.4, radius))
    assert np.isfinite(array.positions).all()
