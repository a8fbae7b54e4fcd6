"""The published estimators: moments in closed form and built twice, hand-computed paths, tables."""

import dataclasses

import numpy as np
import pytest
from designs import scene_with
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes import make_scene
from second_features import slow_key_parameters

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.settings import Span
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.shared.published import (
    ACROSS_M,
    DOWN_M,
    GRID,
    RANGES_M,
    LookUp,
    MomentCalibration,
    calibrate,
    dead_reckoned,
    image_moments,
    lookup_scene,
    measured,
)

SPACING_M = 0.06
images_5x5 = arrays(float, (5, 5), elements=st.floats(0, 1023, width=32)).filter(
    lambda image: image.max() > 1
)


def vertex(before, top, after):
    """The maximum of the parabola through three readings, from the middle one."""
    a, b, _ = np.polyfit([-1, 0, 1], [before, top, after], 2)
    return np.clip(-b / (2 * a), -0.5, 0.5)


def moments_twice(image, spacing_m):
    """M_pq as the paper writes it, sum by sum, for an image with one brightest detector."""
    side = len(image)
    row, column = np.unravel_index(np.argmax(image), image.shape)
    peak = [float(row), float(column)]
    if 0 < row < side - 1:
        peak[0] += vertex(*image[row - 1 : row + 2, column])
    if 0 < column < side - 1:
        peak[1] += vertex(*image[row, column - 1 : column + 2])
    up, port = (spacing_m * (at - np.arange(side)) for at in peak)
    sums = [[(port**p * up[:, None] ** q * image).sum() for q in range(3)] for p in range(3)]
    return np.array(sums) / image.sum()


@pytest.fixture(scope="module")
def clear():
    """The tank's model without noise and rounding."""
    attenuation = load_scene("eren2017_tank").effects["attenuation"]
    return ForwardModel(scene_with({"attenuation": attenuation}, "eren2017_tank"))


@pytest.fixture(scope="module")
def calibration(clear):
    return calibrate(clear, np.random.default_rng(0))


def pose(x=0.0, y=0.0, z=0.0, pitch_deg=0.0, yaw_deg=0.0):
    return np.array([x, y, z, *np.radians([pitch_deg, yaw_deg])])


@given(images_5x5, st.integers(0, 4), st.integers(0, 4))
def test_moments_are_those_of_a_second_implementation(image, row, column):
    image[row, column] = image.max() + 1
    twice = moments_twice(image, SPACING_M)
    np.testing.assert_allclose(image_moments(image, SPACING_M), twice, rtol=1e-9, atol=1e-14)
    if twice[2, 2] > 0:
        angles = [twice[2, 1] / twice[2, 2], twice[1, 2] / twice[2, 2]]
        expected = [np.log(image.max()), twice[1, 0], twice[0, 1], *angles]
        np.testing.assert_allclose(measured(image, SPACING_M), expected, rtol=1e-6, atol=1e-9)


def test_moments_of_a_split_gaussian_spot_are_the_closed_ones():
    side, spacing_m = 161, 0.01
    y = z = spacing_m * (80 - np.arange(side))
    port, starboard, tall = 0.2, 0.12, 0.15
    across = np.exp(-(y**2) / (2 * np.where(y > 0, port, starboard) ** 2))
    image = np.exp(-(z**2) / (2 * tall**2))[:, None] * across
    found = image_moments(image, spacing_m)
    # The split normal distribution about its mode (S. John, 1982); the parabola sees both sides.
    y0 = -spacing_m * vertex(*image[80, 79:82])
    first = np.sqrt(2 / np.pi) * (port - starboard) - y0
    second = (port - starboard) ** 2 + port * starboard - 2 * y0 * first - y0**2
    assert abs(y0) > 1e-3
    assert found[0, 0] == pytest.approx(1)
    assert found[1, 0] == pytest.approx(first, rel=1e-3)
    assert found[2, 0] == pytest.approx(second, rel=1e-3)
    assert found[0, 1] == pytest.approx(0, abs=1e-6)
    assert found[0, 2] == pytest.approx(tall**2, rel=1e-3)
    assert found[2, 2] == pytest.approx(second * tall**2, rel=1e-3)
    peak, along_y, _, pitch_ratio, yaw_ratio = measured(image, spacing_m)
    assert along_y == found[1, 0]
    assert yaw_ratio == pytest.approx(first / second, rel=1e-3)
    assert pitch_ratio == pytest.approx(0, abs=1e-4)
    assert peak == pytest.approx(0, abs=1e-12)


def test_calibration_is_the_line_through_its_own_poses(clear, calibration):
    places = np.array([pose(-x, y, z) for x in RANGES_M for y in ACROSS_M for z in DOWN_M])
    assert len(places) == 125
    light = clear.light(places)
    moments = image_moments(light, SPACING_M)
    for found, seen, wanted in (
        (calibration.lines[0], np.log(light.max(axis=(1, 2))), places[:, 0]),
        (calibration.lines[1], moments[:, 1, 0], places[:, 1]),
        (calibration.lines[2], moments[:, 0, 1], places[:, 2]),
    ):
        design = np.stack([np.ones_like(seen), seen], axis=1)
        expected = np.linalg.lstsq(design, wanted, rcond=None)[0]
        # Of two detectors as bright as each other rounding chooses one, and so a profile.
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)


def test_without_noise_the_method_recovers_the_turns_of_its_calibration(clear, calibration):
    for name, column in (("pitch_deg", 3), ("yaw_deg", 4)):
        turns = [pose(-x, **{name: angle}) for x in RANGES_M for angle in range(-15, 16)]
        images = clear.expected(turns)
        found = calibration.poses(images)
        np.testing.assert_array_equal(calibration.pose(images[3]), found[3])
        off = np.degrees(found - turns)
        assert np.sqrt(np.mean(off[:, column] ** 2)) < 0.6
        assert np.abs(off[:, 7 - column]).max() < 0.1


def test_range_is_the_papers_exponential():
    # -log(peak / a1) / b1 with a1 = 4000 and b1 = 0.4.
    line = (-np.log(4000) / 0.4, 1 / 0.4)
    calibration = MomentCalibration(SPACING_M, 5, np.array([line, *[(0.0, 1.0)] * 4]))
    image = np.outer([1, 2, 3, 2, 1], [1, 2, 3, 2, 1]) / 9 * 4000 * np.exp(-0.4 * 6)
    assert calibration.poses(image)[0] == pytest.approx(-6)


def test_dead_reckoning_follows_the_path_computed_by_hand():
    said = np.array(
        [
            pose(-8, 0.5, -0.5, 5, 5),
            pose(-7, 9, 9, 0, 45),  # 1 m ahead at 45 deg: 1 m to port
            pose(-6, 9, 9, 45, 0),  # 1 m ahead, bow down by 45 deg: 1 m down
            pose(-6, 9, 9, 30, 30),  # stands still
            pose(-4, 9, 9, -30, -60),  # 2 m ahead: R = 2 / (cos 30 cos 60), dy = -2 tan 60
        ]
    )
    found = dead_reckoned(said)
    np.testing.assert_allclose(found[:, [0, 3, 4]], said[:, [0, 3, 4]])
    port = [0.5, 1.5, 1.5, 1.5, 1.5 - 2 * np.sqrt(3)]
    up = [-0.5, -0.5, -1.5, -1.5, -1.5 + 2 / (np.sqrt(0.75) * 0.5) * 0.5]
    np.testing.assert_allclose(found[:, 1], port, atol=1e-12)
    np.testing.assert_allclose(found[:, 2], up, atol=1e-12)


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.zeros((5, 5)), "no light: the peak is 0"),
        (np.pad([[900.0]], 2), "no pattern: M33 is 0"),
        (np.full((5, 5), np.nan), "no image"),
        (np.full(25, 3.0), "no image"),
    ],
)
def test_an_image_that_says_nothing_has_no_pose(calibration, image, reason):
    with pytest.raises(NoPose, match=reason):
        calibration.pose(image)


def test_an_angle_that_no_heading_has_is_no_pose(calibration):
    lines = np.vstack([calibration.lines[:4], [2.0, 0.0]])
    wild = dataclasses.replace(calibration, lines=lines)
    with pytest.raises(NoPose, match=r"no heading: the moments say pitch .* yaw 115"):
        wild.pose(np.outer([1, 2, 3, 2, 1], [1, 2, 3, 2, 1]))


@given(images_5x5)
def test_moments_answer_or_refuse_whatever_the_image(calibration, image):
    try:
        found = calibration.pose(image)
    except NoPose:
        return
    assert found.shape == (5,)
    assert np.isfinite(found).all()


@pytest.fixture(scope="module")
def table():
    """A small table of a planar 7 x 7 array, without noise."""
    scene = lookup_scene(make_scene("planar", 7, {"attenuation": {"k_per_m": 0.1}}))
    grid = {
        "x_m": Span(-8.0, -4.0, 5),
        **dict.fromkeys(("y_m", "z_m"), Span(-0.3, 0.3, 5)),
        **dict.fromkeys(("pitch_deg", "yaw_deg"), Span(-20.0, 20.0, 5)),
    }
    return build_table(dataclasses.replace(scene, table=dataclasses.replace(GRID, **grid)))


def test_the_grid_is_the_dissertations():
    spans = [getattr(GRID, field.name) for field in dataclasses.fields(GRID)]
    steps = [(span.stop - span.start) / (span.number - 1) for span in spans]
    np.testing.assert_allclose(steps, [1, 0.03, 0.03, 3, 3])
    assert np.prod([span.number for span in spans]) == 972_405


def test_look_up_minimises_the_papers_cost_among_poses_with_that_peak(table):
    """Every row compared, no index, arccos for the angle."""
    model, rng = ForwardModel(table.scene), np.random.default_rng(3)
    weights = (0.7, 1.3, 5.0)
    lookup = LookUp(table, weights)

    angles = np.arccos(table.parameters[:, 0] / np.linalg.norm(table.parameters, axis=1))
    for truth in rng.uniform([-8, -0.3, -0.3, -0.3, -0.3], [-4, 0.3, 0.3, 0.3, 0.3], (30, 5)):
        image = model.expected(truth) * rng.uniform(0.98, 1.02, (7, 7))
        mine = slow_key_parameters(image, table.scene.full_scale_counts, "detector")
        angle = np.arccos(mine[0] / np.linalg.norm(mine))
        cost = (
            weights[0] * np.abs(table.parameters[:, 3] - mine[3])
            + weights[1] * np.abs(table.parameters[:, 4] - mine[4])
            + weights[2] * np.abs(angles - angle)
        )
        cost[(np.abs(table.parameters[:, 1:3] - mine[1:3]) > 1e-9).any(axis=1)] = np.inf
        np.testing.assert_array_equal(lookup.pose(image), table.poses[np.argmin(cost)])


def test_an_image_that_the_table_has_no_peak_for_has_no_pose(table):
    lookup = LookUp(table)
    kept = np.abs(table.parameters[:, 1:3]).max(axis=1) < 3
    inner = LookUp(
        dataclasses.replace(table, poses=table.poses[kept], parameters=table.parameters[kept])
    )
    corner = np.zeros((7, 7))
    corner[0, 6] = 500.0
    with pytest.raises(NoPose, match="no match: no pose of the table peaks in row 0, column 6"):
        inner.pose(corner)
    for image, reason in (
        (np.zeros((7, 7)), "no light"),
        (np.zeros((5, 5)), "7 x 7 finite readings"),
        (np.full((7, 7), np.inf), "no image"),
    ):
        with pytest.raises(NoPose, match=reason):
            lookup.pose(image)


def test_a_table_with_peaks_between_detectors_is_refused(table):
    signature = dataclasses.replace(table.scene.signature, peak="subdetector")
    scene = dataclasses.replace(table.scene, signature=signature)
    with pytest.raises(ValueError, match="needs 'detector'"):
        LookUp(dataclasses.replace(table, scene=scene))
