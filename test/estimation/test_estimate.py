"""From signature to pose: exact on the grid, honest off it, as good as five numbers allow."""

import math
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from needs import numba
from scenes import assert_same_estimate, changed, coarse, squared_error

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.estimator import METHODS, Estimator, NoPose
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.least_squares.frame import estimate_frame
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.signature.features import lifted, scene_parameters
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.estimation.signature_table import SignatureTable, build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.shared.errors import range_across_angle

pytestmark = pytest.mark.filterwarnings("error")


FLAT = {"z_m": [0.0, 0.0, 1], "pitch_deg": [0.0, 0.0, 1]}


@pytest.fixture(scope="module")
def small():
    return Estimator(build_table(coarse("reference")), "sam")


@pytest.fixture(scope="module")
def flat():
    return Estimator(build_table(changed(coarse("reference", 9), table=FLAT)), "sam")


def test_the_image_of_a_grid_pose_gives_that_pose_exactly(small):
    scene, table = small.table.scene, small.table
    model = ForwardModel(scene)
    rows = np.random.default_rng(17).choice(len(table.poses), 300, replace=False)
    for row in rows:
        pose = table.poses[row]
        answer = small.estimate(parameters=scene_parameters(model.expected(pose), scene))
        assert answer.angle_rad < 1e-9
        if not np.array_equal(answer.pose, pose):
            # Another pose may look alike, but only if it really does.
            twin = scene_parameters(model.expected(answer.pose), scene)
            np.testing.assert_allclose(twin, table.parameters[row], atol=1e-9)


def test_a_match_is_turned_about_the_beam_by_the_roll(small):
    # To port of the beam by a step of the grid, and then turned about the beam as a whole.
    across, roll = 0.3, 0.4
    pose = np.array([-6.0, across * np.cos(roll), across * np.sin(roll), 0.0, 0.0])
    image = ForwardModel(small.scene).expected(pose, roll)
    found = small.estimate(parameters=scene_parameters(image, small.scene), roll=roll)
    np.testing.assert_allclose(found.pose, pose, atol=1e-9)


def test_a_scene_alone_is_answered_from_its_table_and_whole_numbers_as_floats(
    small, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    scene = small.table.scene
    image = ForwardModel(scene).expose(small.table.poses[17], np.random.default_rng(4))
    for method in METHODS:
        answer = Estimator(scene, method, compiled=False).estimate(image.astype(int))
        known = Estimator(small.table, method, compiled=False)
        same = known.estimate(image, scene_parameters(image, scene))
        np.testing.assert_array_equal(answer.pose, same.pose)
        np.testing.assert_array_equal(answer.covariance, same.covariance)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda scene: Estimator("follow"), "source: 'follow'; give a scene, as load_scene"),
        (lambda scene: Estimator(scene, "nearest"), "method: 'nearest' is unknown; choose sam or"),
        (lambda scene: ForwardModel("follow"), "scene: 'follow'; give what load_scene returns"),
        (lambda scene: build_table(None), "scene: of type NoneType; give what load_scene"),
        (lambda scene: Pipeline(scene), r"estimator: of type Scene; give Estimator\(scene\)"),
        (
            lambda scene: cramer_rao_bound(scene, [-5, 0, 0, 0, 0]),
            r"model: of type Scene; give ForwardModel\(scene\)",
        ),
    ],
)
def test_what_is_given_in_place_of_another_is_named_with_the_cure(scene, call, words):
    with pytest.raises(ValueError, match=words):
        call(scene)


@pytest.mark.parametrize(
    ("grid", "lift", "cells"),
    [
        ("small", 0.0, [1.0, 0.3, 0.3, *np.radians([10.0, 10.0])]),
        ("small", 1.0, [1.0, 0.3, 0.3, *np.radians([10.0, 10.0])]),
        ("flat", 1.0, [0.5, 0.15, 0.0, 0.0, np.radians(5.0)]),
    ],
)
def test_a_match_is_the_least_angle_of_the_table_with_its_neighbours_spread_and_the_grids_cell(
    request, grid, lift, cells
):
    table = request.getfixturevalue(grid).table
    scene, poses = changed(table.scene, signature={"lift": lift}), table.poses
    estimator = Estimator(SignatureTable(scene, poses, table.parameters), "sam")
    vectors, rng = lifted(table.parameters, scene.signature, 5), np.random.default_rng(29)
    for row in rng.choice(len(vectors), 50, replace=False):
        parameters = table.parameters[row] * rng.uniform(0.9, 1.0, 5)
        angles = spectral_angle(vectors, lifted(parameters, scene.signature, 5))
        best, second, *others = np.argsort(angles, kind="stable")[:64]
        answer = estimator.estimate(parameters=parameters)
        assert answer.angle_rad == pytest.approx(angles[best], abs=1e-14)
        assert answer.runner_up_angle_rad == pytest.approx(angles[second], abs=1e-14)
        np.testing.assert_array_equal(answer.pose, poses[best])
        np.testing.assert_array_equal(answer.runner_up_pose, poses[second])
        expected = np.diag([max(step**2 / 12, 1e-8) for step in cells])
        for other in (best, second, *others):
            expected += np.outer(poses[other] - poses[best], poses[other] - poses[best]) / 64
        np.testing.assert_allclose(answer.covariance, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ([0.0] * 5, "no light: the peak is 0 of full scale"),
        ([-0.1, 0, 0, 0, 0], "no light"),
        *(
            (bad, "not five finite numbers")
            for bad in (
                *([0.5, np.nan, 0, 0, 0], [np.inf, 0, 0, 0, 0], [0.5, 0, 0, 0, -np.inf]),
                *([0.5, 0, 0, 0], [[0.5, 0, 0, 0, 0]], 0.5, [1.5e308, 0, 0, 0, 0]),
            )
        ),
        ([0.01, -2.0, 2.0, 1.5, -1.5], r"no match: .* rad away, more than 0\.25"),
        ([0.01, 0, 0, 50.0, -50.0], "not of this array: skewness_horizontal is 50"),
    ],
)
def test_parameters_of_no_pose_are_refused_with_the_reason(small, parameters, why):
    with pytest.raises(NoPose, match=why):
        small.estimate(parameters=parameters)


def test_the_angle_that_is_refused_is_the_callers(small):
    parameters = small.table.parameters[123] + np.array([0, 0.2, 0, 0, 0])
    angle = small.estimate(parameters=parameters).angle_rad
    assert 0 < angle < 0.25
    wider = Estimator(small.table, "sam", max_angle_rad=angle * 1.001)
    assert wider.estimate(parameters=parameters).angle_rad == angle
    with pytest.raises(NoPose, match="no match"):
        Estimator(small.table, "sam", max_angle_rad=angle * 0.999).estimate(parameters=parameters)


def test_a_table_of_one_row_is_refused_and_two_rows_are_enough(small):
    table = small.table
    with pytest.raises(ValueError, match="1 row"):
        Estimator(SignatureTable(table.scene, table.poses[:1], table.parameters[:1]))
    spans = {key: [0.0, 0.0, 1] for key in ("y_m", "z_m", "pitch_deg", "yaw_deg")}
    point = changed(table.scene, table={**spans, "x_m": [-5.0, -5.0, 1]})
    for method in ("sam", "sam_interpolated"):
        with pytest.raises(ValueError, match="table: 1 row; a match needs at least two"):
            Estimator(point, method)
    with pytest.raises(ValueError, match="neighbours: 1; the runner-up needs at least 2"):
        Estimator(table, "sam", neighbours=1)
    for rows in ([1, 0], [1, 1]):
        two = SignatureTable(table.scene, table.poses[rows], table.parameters[rows])
        answer = Estimator(two, "sam").estimate(parameters=table.parameters[1])
        np.testing.assert_array_equal(answer.pose, table.poses[1])
        np.testing.assert_array_equal(answer.runner_up_pose, table.poses[rows[1]])


@pytest.mark.parametrize("method", ["sam", "sam_interpolated"])
def test_poses_that_look_exactly_alike_are_all_in_the_covariance(small, method):
    """A table of one signature says nothing of the pose, however many rows there are."""
    table = small.table
    # In single precision, of which the answer is in double.
    same = np.broadcast_to(table.parameters[0].astype(np.float32), table.parameters.shape)
    alike = SignatureTable(table.scene, table.poses.astype(np.float32), same)
    found = Estimator(alike, method).estimate(parameters=same[0])
    assert (np.sqrt(found.covariance.diagonal()) > 0.8 * table.poses.std(axis=0)).all()
    assert found.pose.dtype == found.covariance.dtype == np.float64
    assert found.angle_rad < 1e-6


# An image of the reference scene from a pose, m and rad, whose match is too far off for a fit.
FAR_OFF = (
    np.array([-7.6907, 0.7803, 0.8131, -0.0097, -0.3118]),
    np.array(
        [
            [27, 38, 42, 35, 14],
            [48, 60, 65, 55, 38],
            [59, 72, 78, 69, 48],
            [62, 79, 82, 72, 51],
            [49, 69, 75, 64, 33],
        ]
    ),
)


def test_noisy_images_are_matched_within_the_reference_accuracy_and_far_from_the_bound():
    """2,000 random poses of the reference scene: the accuracy that five numbers can give."""
    scene = load_scene("reference")
    model, table, rng = ForwardModel(scene), build_table(scene), np.random.default_rng(2016)
    high = np.array([-4.0, 0.6, 0.6, *np.radians([20.0, 20.0])])
    poses = rng.uniform([-8.0, *-high[1:]], high, (2000, 5))
    parameters = scene_parameters(model.expose(poses, rng), scene)
    bound = np.mean(cramer_rao_bound(model, poses).std ** 2, axis=0)
    for method, some in (("sam", slice(None)), ("sam_interpolated", slice(200))):
        estimator = Estimator(table, method)
        answers = [estimator.estimate(parameters=each) for each in parameters[some]]
        square = np.mean((np.array([answer.pose for answer in answers]) - poses[some]) ** 2, axis=0)
        assert (square > 4 * bound).all()
        range_m, across, angle = range_across_angle(np.sqrt(square))
        assert range_m <= 0.4
        assert across <= 0.25
        assert np.degrees(angle) <= 7.0
        assert 3.0 <= np.mean(list(map(squared_error, answers, poses[some]))) <= 8.0
        pose, image = FAR_OFF
        assert squared_error(estimator.estimate(image), pose) < 25.7  # of one in ten thousand


def test_each_of_the_attitudes_that_a_planar_array_confuses_is_found():
    """An image of an attitude that looks like another one, 40 deg and half a metre away."""
    pose = np.array([-4.3415, 0.4336, -0.1092, -0.2997, -0.2702])
    image = [
        [379, 437, 488, 528, 549],
        [411, 473, 527, 569, 593],
        [433, 497, 555, 597, 620],
        [442, 508, 564, 605, 628],
        [436, 499, 556, 597, 616],
    ]
    found = Estimator(load_scene("reference").with_shape("planar")).estimate(np.array(image))
    assert squared_error(found, pose) < 25.7  # of one in ten thousand


def of_full_and_dark(fill=0.0):
    """Return an image from 2 m in a harbour; its posterior has walls unlike any about a fit."""
    image = np.full((5, 5), 1023.0)
    image[0, 4], image[4, 4] = fill, 0
    return image


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("image", "why"),
    [
        (np.full((5, 5), 7.0), "no pattern: every detector reads 7 counts"),
        (np.full((5, 5), 1023.0), "no pattern: every detector reads 1023 counts"),
        (of_full_and_dark(), "no pattern: no detector reads more than darkness"),
        (of_full_and_dark(4092.0), "above full scale: 4092 counts, but the scene reads at most"),
        *(
            (image, r"no image: of shape \(.*, not \(5, 5\)")
            for image in (np.ones(25), np.ones((2, 5, 5)), np.ones((0, 0)), "x", None)
        ),
    ],
)
def test_an_image_of_no_pose_is_refused_by_each_method_and_by_the_pipeline(
    small, method, image, why
):
    estimator = Estimator(small.table, method, compiled=False)
    with pytest.raises(NoPose, match=why) as refused:
        estimator.estimate(image)
    assert Pipeline(estimator).answer(0, image).reason == str(refused.value)


def test_an_image_that_is_not_finite_is_refused(small):
    image = np.full((5, 5), np.nan)
    with pytest.raises(NoPose, match="no image: nan"):
        small.estimate(image)
    with pytest.raises(NoPose, match="nan"):
        Pipeline(small).check(image)


def test_one_reading_between_full_and_dark_is_enough(small):
    model, rng = ForwardModel(small.scene), np.random.default_rng(1)
    poses = rng.uniform([-2.4, -0.3, -0.3, -0.3, -0.3], [-1.6, 0.3, 0.3, 0.3, 0.3], (4000, 5))
    images = model.expose(poses, rng)
    between = ((images > 0) & (images < 1023)).sum(axis=(1, 2)) == 1
    estimator = Estimator(small.scene).wait()
    for pose, image in list(zip(poses[between], images[between], strict=True))[:5]:
        assert squared_error(estimator.estimate(image), pose) < 36


@pytest.mark.usefixtures("compiled_fit")
def test_a_match_is_as_unsure_as_it_is_off_and_as_probable_as_the_fit(scene, table):
    rng, model = np.random.default_rng(4), ForwardModel(scene)
    poses = rng.uniform([-7.5, -0.4, -0.4, -0.2, -0.2], [-4.5, 0.4, 0.4, 0.2, 0.2], (8, 5))
    # Two neighbours know little of how far off they are.
    sam = Estimator(table, "sam", math.pi, neighbours=2)
    whole, excesses = Estimator(table), []
    for image in model.expose(poses, rng):
        parameters = scene_parameters(image, scene)
        held, alone = sam.estimate(image), sam.estimate(None, parameters)
        fit = whole.estimate(image)
        off = alone.pose - fit.pose
        excesses.append(off @ np.linalg.inv(alone.covariance + fit.covariance) @ off / 5)
        expected = max(1.0, excesses[-1]) * alone.covariance + fit.covariance
        # The whole fit integrates the posterior, which is not quite Gaussian.
        slack = 0.05 * np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
        assert (abs(held.covariance - expected) < slack).all()
        np.testing.assert_array_equal(held.pose, alone.pose)
        assert held.misfit == pytest.approx(fit.misfit, rel=1e-4)
    assert min(excesses) < 1
    assert max(excesses) > 5


@numba
@pytest.mark.parametrize("roll", [0.0, 0.3], ids=["level", "rolled"])
def test_compiled_a_frame_has_the_estimate_that_it_has_in_numpy(table, roll):
    plain, fast = (Estimator(table, "least_squares", compiled=way) for way in (False, True))
    rng = np.random.default_rng(3)
    half = np.array([2, 0.8, 0.8, 0.4, 0.4])
    poses = [-6.0, 0, 0, 0, 0] + half * rng.uniform(-1, 1, (12, 5))
    for image in ForwardModel(table.scene).expose(poses, rng, roll):
        found, expected = (each.estimate(image, roll=roll) for each in (fast, plain))
        assert_same_estimate(found, expected)
        assert found.misfit == pytest.approx(expected.misfit, rel=1e-7)
        assert found.angle_rad == pytest.approx(expected.angle_rad, abs=1e-9)


@numba
def test_no_python_runs_in_the_midst_of_compiled_code(compiled_fit):
    """Ctrl-C, raised in Python that Numba runs to return an array, would end the process."""
    scene = load_scene("follow")
    model, estimator, ran = ForwardModel(scene), Estimator(scene, compiled=True), set()
    pipeline = Pipeline(estimator)
    images = model.expose(np.tile([-5.0, 0.2, 0.1, 0.0, 0.1], (4, 1)), np.random.default_rng(3))

    def watch(frame, event, _):
        if event == "call" and "numba" in Path(frame.f_code.co_filename).parts:
            ran.add(frame.f_code.co_name)

    pipeline.answer(10**9, images[0])
    sys.setprofile(watch)
    try:
        answers = [pipeline.answer((2 + k) * 10**8 + 10**9, images[k]) for k in (1, 2, 3)]
    finally:
        sys.setprofile(None)
    assert all(answer.track is not None for answer in answers)
    assert ran == set()


@numba
def test_no_image_makes_the_fit_compile_once_more(compiled_fit):
    # In a node that would take half a minute in the midst of a drive.
    scene = load_scene("follow")
    model, rng = ForwardModel(scene), np.random.default_rng(4)
    estimator = Estimator(scene, compiled=True)
    fit = compilation.loaded(estimate_frame)
    before = len(fit.signatures)
    poses = [-6.0, 0, 0, 0, 0] + np.array([1.5, 0.5, 0.5, 0.3, 0.3]) * rng.uniform(-1, 1, (12, 5))
    light, slope = model.light(poses), np.linspace(0, 40, 5)
    spoilt = light.copy()
    spoilt[:, 2, 3] = 0.0
    ways = []
    for image in model.read(
        np.concatenate([light + slope, light * (1 - slope / 200), spoilt]), rng
    ):
        with suppress(NoPose):
            found = estimator.estimate(image)
            ways.append((found.clear < 1, bool(found.left_out)))
    assert np.any(ways, axis=0).all(), "of uneven light, and with a detector left out"
    assert len(fit.signatures) == before
