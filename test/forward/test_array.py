"""Where the detectors sit and look, against equations 9 to 12 written out a second time."""

import math

import numpy as np
import pytest
import second_forward
from hypothesis import example, given, settings
from hypothesis import strategies as st

from uuv_optical_array.forward.array import ArraySettings, build_array

sides = st.sampled_from([2, 3, 4, 5, 21]) | st.integers(2, 30)
widths = st.floats(0.05, 5)
bows = st.floats(-3, 3)


@given(side=sides, width=widths, bow=bows, slack=st.none() | st.floats(0.001, 5))
@example(side=100, width=0.4, bow=0.4, slack=0.1)
@example(side=101, width=0.4, bow=0.4, slack=None)
@settings(max_examples=80)
def test_detectors_sit_and_look_where_the_second_forward_model_has_them(side, width, bow, slack):
    shape = "planar" if slack is None else "curved"
    radius = None if slack is None else width / math.sqrt(2) * (1 + slack)
    chosen = ArraySettings(shape, side, width, bow, radius)
    array = build_array(chosen)
    places, normals = zip(*second_forward.detectors(vars(chosen)), strict=True)
    np.testing.assert_allclose(array.positions, places, atol=1e-12)
    np.testing.assert_allclose(array.normals, normals, atol=1e-12)
    assert array.side == side
    assert array.spacing_m == pytest.approx(width / (side - 1), rel=1e-15)


@pytest.mark.parametrize(
    ("given_settings", "words"),
    [
        (("curved", 5, 0.4, 0.4, 0.28), ["radius_m", "0.28 m", "0.2828 m", "larger"]),
        (("curved", 5, 0.4, 0.4, 0.4 / math.sqrt(2)), ["radius_m", "larger"]),
        (("curved", 5), ["radius_m", "missing", "curved"]),
    ],
)
def test_a_radius_that_does_not_fit_is_refused_by_name(given_settings, words):
    with pytest.raises(ValueError, match="radius_m") as refusal:
        ArraySettings(*given_settings)
    for word in words:
        assert word in str(refusal.value)


@pytest.mark.parametrize("width", [0.4, 0.2, 1.0])
def test_a_plane_that_becomes_a_sphere_is_as_curved_as_the_papers(width):
    """Eren et al. (2016) have a radius of 0.32 m for a width of 0.4 m."""
    flat = ArraySettings("planar", 5, width)
    sphere = flat.with_shape("curved")
    assert sphere.radius_m == pytest.approx(0.8 * width)
    assert sphere.with_shape("curved") == sphere
    assert sphere.with_shape("planar") == flat


def test_a_radius_just_large_enough_still_gives_finite_corners():
    width, radius = 5.085561325595337, 3.5960348994685103
    with np.errstate(all="raise"):
        array = build_array(ArraySettings("curved", 5, width, 0.4, radius))
    assert np.isfinite(array.positions).all()
