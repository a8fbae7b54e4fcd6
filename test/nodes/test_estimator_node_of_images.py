"""The estimator node with images: joined to their signatures, rolled by the IMU, and tracked."""

import numpy as np
import pytest
from asker import Shower, assert_is, figures, place_of
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from scipy.spatial.transform import Rotation

from uuv_optical_array.estimation.estimator import Estimator, EstimatorSettings
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.forward.model import ForwardModel

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN


@pytest.fixture(scope="module")
def images(scene):
    rng = np.random.default_rng(9)
    poses = rng.uniform([-7.5, -0.4, -0.4, -0.2, -0.2], [-4.5, 0.4, 0.4, 0.2, 0.2], (4, 5))
    return ForwardModel(scene).expose(poses, rng)


@pytest.mark.parametrize("image_first", [True, False])
def test_least_squares_joins_image_and_signature_by_their_stamp(shower, images, table, image_first):
    estimator = Estimator(table, method="least_squares")
    for i, image in enumerate(images, start=1):
        message = shower.show(image, i, image_first)
        assert_is(message, estimator.estimate(image, shower.signature(image)))
    values = dict(figures(shower.lab.report(shower.node, OK)))
    assert 1e-3 < float(values["misfit"]) <= 1


def test_a_signature_whose_image_never_comes_is_given_up_with_the_reason(shower, images):
    for seconds in range(1, 30):
        shower.clouds.publish(shower.message(shower.signature(images[0]), seconds))
        stamp = seconds * 10**9 + 9
        shower.lab.until(lambda stamp=stamp: stamp in shower.node.waiting, "the signature")
    status = shower.lab.report(shower.node, WARN, "no image")
    assert not shower.poses
    assert dict(figures(status))["answered"] == "0"
    shower.show(images[1], 100)


def test_an_image_of_another_size_is_refused_by_the_estimator_too(shower, images):
    shower.images.publish(shower.picture(np.ones((4, 4)), 1))
    shower.clouds.publish(shower.message(shower.signature(images[0]), 1))
    shower.lab.report(shower.node, WARN, "wrong size: 4 x 4")
    shower.show(images[1], 2)
    assert shower.seconds_answered() == [2]


def test_the_method_can_change_while_the_node_runs(shower, images, table):
    shower.show(images[0], 1)
    assert shower.lab.set(shower.node, "method", "sam").successful
    message = shower.show(images[1], 2)
    matching = Estimator(table, "sam", compiled=False)
    assert_is(message, matching.estimate(images[1], shower.signature(images[1])))
    answer = shower.lab.set(shower.node, "method", "magic")
    assert not answer.successful
    assert "choose sam or sam_interpolated or least_squares" in answer.reason


def test_the_roll_of_the_imu_enters_the_pose(
    lab, scene_file, scene, table, table_folder, compiled_fit
):
    shower = Shower(
        lab, scene_file, scene, table=table_folder, method="least_squares", use_imu=True
    )
    pose, roll = np.array([-6.0, 0.3, -0.2, 0.1, -0.1]), 0.2
    image = ForwardModel(scene).expose(pose, np.random.default_rng(3), roll)
    shower.tilt(roll, 1)
    message = shower.show(image, 1)
    estimate = Estimator(table, method="least_squares").estimate(
        image, shower.signature(image), roll
    )
    position, quaternion = place_of(message)
    np.testing.assert_allclose(position, estimate.pose[:3], atol=1e-9)
    assert Rotation.from_quat(quaternion).as_euler("ZYX")[2] == pytest.approx(roll, abs=1e-9)
    std = np.sqrt(np.reshape(message.pose.covariance, (6, 6)).diagonal()[:3])
    assert (np.abs(np.array(position) - pose[:3]) < 5 * std).all()


@pytest.mark.parametrize("tilted_at", [3, 7])
def test_a_roll_long_before_or_after_the_image_gives_no_pose(
    lab, scene_file, scene, table_folder, images, tilted_at
):
    shower = Shower(lab, scene_file, scene, table=table_folder, use_imu=True)
    shower.tilt(0.0, tilted_at)
    shower.images.publish(shower.picture(images[0], 5))
    shower.clouds.publish(shower.message(shower.signature(images[0]), 5))
    shower.lab.report(shower.node, WARN, "no roll", "is 2 s from the image", "max_imu_age_s")
    shower.tilt(0.0, 6)
    shower.show(images[1], 6)
    assert shower.seconds_answered() == [6]


def test_sam_answers_a_rolled_follower_with_where_it_is(lab, scene_file, scene, table_folder):
    shower = Shower(lab, scene_file, scene, table=table_folder, use_imu=True)
    # To port of the beam by a step of the grid, and then turned about the beam as a whole.
    across, roll = 0.3, 0.4
    pose = np.array([-6.0, across * np.cos(roll), across * np.sin(roll), 0.0, 0.0])
    image = np.rint(ForwardModel(scene).expected(pose, roll))
    shower.tilt(roll, 1)
    position, quaternion = place_of(shower.show(image, 1))
    np.testing.assert_allclose(position, pose[:3], atol=1e-9)
    expected = Rotation.from_euler("x", roll)
    assert (Rotation.from_quat(quaternion).inv() * expected).magnitude() < 1e-9


@pytest.fixture
def tracked(lab, scene_file, scene, table_folder, compiled_fit):
    return Shower(lab, scene_file, scene, table=table_folder, method="least_squares", tracking=True)


def test_a_track_is_closer_to_a_still_follower_than_its_frames(tracked, scene, table):
    pose, rng = np.array([-6.0, 0.1, 0.1, 0.02, 0.03]), np.random.default_rng(6)
    images = ForwardModel(scene).expose(np.tile(pose, (15, 1)), rng)
    single = Estimator(table, method="least_squares")
    for name in ("velocity_walk_m_per_s", "turn_walk_deg_per_s"):
        assert tracked.lab.set(tracked.node, name, 0.001).successful
    first = tracked.show(images[0], 1)
    assert_is(first, single.estimate(images[0], tracked.signature(images[0])))
    for seconds, image in enumerate(images[1:], start=2):
        tracked.show(image, seconds)
    last = tracked.track(15)
    spread = [np.trace(np.reshape(each.pose.covariance, (6, 6))[:3, :3]) for each in (first, last)]
    assert spread[1] < 0.6 * spread[0]
    position, _ = place_of(last)
    assert np.abs(np.array(position) - pose[:3]).max() < 0.1


def test_a_late_frame_enters_the_track_and_an_outlier_does_not(tracked, scene):
    pose, rng = np.array([-6.0, 0.1, 0.1, 0.02, 0.03]), np.random.default_rng(7)
    model = ForwardModel(scene)
    assert tracked.lab.set(tracked.node, "buffer_s", 5.0).successful
    for seconds in (1, 2, 4):
        tracked.show(model.expose(pose, rng), seconds)
    image = model.expose(pose, rng)
    tracked.images.publish(tracked.picture(image, 3))
    tracked.clouds.publish(tracked.message(tracked.signature(image), 3))
    tracked.lab.report(tracked.node, WARN, "late frame")
    aside = model.expose(pose + np.array([2.0, 0, 0, 0, 0]), rng)
    tracked.images.publish(tracked.picture(aside, 5))
    tracked.clouds.publish(tracked.message(tracked.signature(aside), 5))
    tracked.lab.report(tracked.node, WARN, "outlier", "standard deviations off")
    tracked.show(model.expose(pose, rng), 6)
    assert tracked.seconds_answered() == [1, 2, 4, 6]


@pytest.mark.parametrize(
    ("refused", "reason"),
    [(("table", "/nowhere"), "no table there"), (("method", "magic"), "magic")],
)
def test_an_atomic_set_that_is_refused_leaves_track_estimator_and_parameters(
    tracked, scene, table, refused, reason
):
    pose, rng = np.array([-6.0, 0.1, 0.1, 0.02, 0.03]), np.random.default_rng(8)
    images = ForwardModel(scene).expose(np.tile(pose, (4, 1)), rng)
    for seconds, image in enumerate(images[:3], start=1):
        tracked.show(image, seconds)
    changes = {"velocity_walk_m_per_s": 5.0, "max_misfit": 0.01, "candidates": 1}
    before = {name: tracked.node.get_parameter(name).value for name in changes}
    result = tracked.node.set_parameters_atomically(
        [Parameter(name, value=value) for name, value in [*changes.items(), refused]]
    )
    assert not result.successful
    assert reason in result.reason
    for name, value in before.items():
        assert tracked.node.get_parameter(name).value == value
    assert tracked.node.pipeline.estimator.settings == EstimatorSettings()
    # The next frame joins the track of the first three, as one that was never disturbed.
    pipeline = Pipeline(Estimator(table).wait())
    for seconds, image in enumerate(images, start=1):
        answer = pipeline.answer(seconds * 10**9 + 9, image)
    tracked.show(images[3], 4)
    assert_is(tracked.track(4), answer.track)
