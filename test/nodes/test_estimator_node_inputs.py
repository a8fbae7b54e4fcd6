"""The estimator node's inputs: what each method subscribes to and joins, and the roll."""

import numpy as np
import pytest
from asker import Asker, Shower, assert_is, figures, place_of
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def topics_of(node):
    topics = [ear.topic_name for ear in node.subscriptions]
    assert len(topics) == len(set(topics))
    return {*topics} - {"/parameter_events", "/clock"}


@pytest.mark.parametrize("used", [(), ("image",), ("imu",), ("commands",), ("range",)])
@pytest.mark.parametrize("method", ["sam", "sam_interpolated"])
def test_the_node_subscribes_to_what_it_is_to_use(lab, scene_file, used, method):
    names = {"image": "/array/image", "imu": "/imu", "commands": "/cmd_vel", "range": "/range"}
    uses = {f"use_{name}": name in used for name in names}
    asker = Asker(lab, scene_file, method=method, **uses)
    assert topics_of(asker.node) == {"/array/features", *(names[name] for name in used)}


def test_the_fit_is_refused_while_the_node_reads_no_image(asker, signatures):
    result = asker.lab.set(asker.node, "method", "least_squares")
    assert not result.successful
    assert "use_image" in result.reason
    asker.ask(signatures[0], 3)


@pytest.mark.parametrize("image_first", [True, False])
def test_sam_joins_image_and_signature_by_their_stamp(joiner, images, table, image_first):
    estimator = Estimator(table, "sam")
    for i, image in enumerate(images[:4], start=1):
        message = joiner.show(image, i, image_first)
        assert_is(message, estimator.estimate(image, joiner.signature(image)))
    values = dict(figures(joiner.lab.report(joiner.node, OK)))
    assert 1e-3 < float(values["misfit"]) <= 1


def test_least_squares_answers_the_image_alone(shower, images, table):
    assert topics_of(shower.node) == {"/array/image", "/cmd_vel"}
    estimator = Estimator(table, method="least_squares")
    for i, image in enumerate(images[:4], start=1):
        shower.images.publish(shower.picture(image, i))
        message = shower.lab.answer(shower.poses, Time(sec=i, nanosec=9))
        assert_is(message, estimator.estimate(image))
    values = dict(figures(shower.lab.report(shower.node, OK)))
    assert 1e-3 < float(values["misfit"]) <= 1


def test_without_light_it_is_told_too_how_the_fit_runs(shower):
    """Else whoever waits for what is compiled would wait until the lamp is seen."""
    values = dict(figures(shower.lab.report(shower.node, WARN, "no input", value="fit")))
    assert (values["method"], values["fit"]) == ("least_squares", "compiled")


def test_a_signature_whose_image_never_comes_is_given_up_with_the_reason(joiner, images):
    for seconds in range(1, 30):
        joiner.clouds.publish(joiner.message(joiner.signature(images[0]), seconds))
        stamp = seconds * 10**9 + 9
        joiner.lab.until(lambda stamp=stamp: stamp in joiner.node.inputs.waiting, "the signature")
    status = joiner.lab.report(joiner.node, WARN, "no image")
    assert not joiner.poses
    assert dict(figures(status))["answered"] == "0"
    joiner.show(images[1], 100)


@pytest.mark.parametrize("method", ["sam", "least_squares"])
def test_of_frames_that_wait_the_newest_is_answered_and_the_others_are_counted(
    lab, scene_file, scene, images, method, compiled_fit
):
    shower = Shower(lab, scene_file, scene, method=method)
    for seconds, image in enumerate(images, start=1):
        shower.send(image, seconds)
    shower.lab.answer(shower.poses, Time(sec=len(images), nanosec=9))
    left_out = len(images) - len(shower.poses)
    assert left_out > 0
    totals = shower.node.diagnostics.totals
    shower.lab.until(lambda: totals["answered"] == len(shower.poses), "the rest of the frame")
    values = dict(figures(shower.lab.report(shower.node, OK, "passed over for newer ones")))
    assert values["passed_over"] == str(left_out)


def test_the_method_and_what_it_reads_can_change_while_the_node_runs(shower, images, table):
    shower.show(images[0], 1)
    assert shower.lab.set(shower.node, "method", "sam").successful
    assert topics_of(shower.node) == {"/array/image", "/array/features", "/cmd_vel"}
    shower.lab.connect()
    message = shower.show(images[1], 2)
    matching = Estimator(table, "sam", compiled=False)
    assert_is(message, matching.estimate(images[1], shower.signature(images[1])))
    answer = shower.lab.set(shower.node, "method", "magic")
    assert not answer.successful
    assert "choose sam or sam_interpolated or least_squares" in answer.reason
    assert shower.lab.set(shower.node, "method", "least_squares").successful
    assert topics_of(shower.node) == {"/array/image", "/cmd_vel"}
    shower.lab.connect()
    assert_is(shower.show(images[2], 3), Estimator(table).estimate(images[2]))
    # Of what it does not read there may be several.
    shower.lab.talk(PointCloud2, "array/features")
    count = shower.node.count_publishers
    shower.lab.until(lambda: count("array/features") == 2, "the other publisher")
    shower.lab.statuses.clear()
    shower.show(images[3], 4)
    shower.lab.report(shower.node, OK, value="method")


def test_a_topic_that_cannot_be_subscribed_to_leaves_the_method_as_it_was(
    shower, images, monkeypatch
):
    def refused(*given, **named):
        raise RuntimeError("not allowed")  # as rclpy does where ROS is secured

    monkeypatch.setattr(shower.node, "create_subscription", refused)
    answer = shower.lab.set(shower.node, "method", "sam")
    assert not answer.successful
    assert answer.reason == "method: sam needs other topics, which cannot be read: not allowed"
    shower.show(images[0], 1)


def test_a_node_without_a_table_takes_another_method_too(lab, scene_file, scene, images, table):
    shower = Shower(lab, scene_file, scene, table="/nowhere")
    lab.report(shower.node, ERROR, "no table there")
    assert lab.set(shower.node, "method", "least_squares").successful
    assert topics_of(shower.node) == {"/array/image", "/cmd_vel"}
    lab.connect()
    shower.lab.deliver(shower.node, shower.images, shower.picture(images[0], 1))
    assert lab.set(shower.node, "table", "").successful
    assert_is(shower.show(images[1], 2), Estimator(table).estimate(images[1]))
    assert shower.seconds_answered() == [2]


def test_the_roll_of_the_imu_enters_the_pose(lab, scene_file, scene, table, compiled_fit):
    shower = Shower(lab, scene_file, scene, method="least_squares", use_imu=True)
    pose, roll = np.array([-6.0, 0.3, -0.2, 0.1, -0.1]), 0.2
    image = ForwardModel(scene).expose(pose, np.random.default_rng(3), roll)
    shower.tilt(roll, 1)
    message = shower.show(image, 1)
    estimate = Estimator(table).estimate(image, shower.signature(image), roll)
    position, quaternion = place_of(message)
    np.testing.assert_allclose(position, estimate.pose[:3], atol=1e-9)
    assert Rotation.from_quat(quaternion).as_euler("ZYX")[2] == pytest.approx(roll, abs=1e-9)
    std = np.sqrt(np.reshape(message.pose.covariance, (6, 6)).diagonal()[:3])
    assert (np.abs(np.array(position) - pose[:3]) < 5 * std).all()


@pytest.mark.parametrize(("tilted_at", "away_s"), [(3, 2), (15, 10)])
def test_a_roll_far_from_the_image_is_taken_to_hold_and_less_certain(
    lab, scene_file, scene, images, tilted_at, away_s
):
    rolling = Shower(lab, scene_file, scene, use_imu=True)
    rolling.send(images[0], 4)
    rolling.lab.report(rolling.node, WARN, "no roll: no imu message has come")
    rolling.tilt(0.1, tilted_at)
    pose = rolling.show(images[0], 5)
    q = pose.pose.pose.orientation
    assert Rotation.from_quat([q.x, q.y, q.z, q.w]).as_euler("ZYX")[2] == pytest.approx(0.1)
    # The variance of the turn about the axis along which the lamp shines.
    variance = np.reshape(pose.pose.covariance, (6, 6))[3, 3]
    assert variance == pytest.approx(0.02**2 + min(0.05 * away_s, 0.2) ** 2, rel=0.1)
    rolling.lab.report(rolling.node, WARN, "no roll", f"is {away_s} s from the image")
