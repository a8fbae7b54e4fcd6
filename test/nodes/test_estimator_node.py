"""The estimator node: the core's pose and its covariance for a signature, or the reason why not."""

import shutil
import sys

import numpy as np
import pytest
import rclpy.logging
from asker import Asker, assert_is, figures, place_of
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.msg import Log
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from tables import write_table

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.shared.messages import image_to_message

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@pytest.fixture(scope="module")
def signatures(scene):
    """Ten noisy signatures of poses between those of the table."""
    rng = np.random.default_rng(8)
    poses = rng.uniform([-7.5, -0.4, -0.4, -0.2, -0.2], [-4.5, 0.4, 0.4, 0.2, 0.2], (10, 5))
    images = ForwardModel(scene).expose(poses, rng)
    return key_parameters(images, scene.full_scale_counts, scene.signature.peak)


def matched(table, signature, method="sam", **settings):
    return Estimator(table, method, **settings).estimate(parameters=signature)


@pytest.fixture
def asker(lab, scene_file, table_folder):
    return Asker(lab, scene_file, table=table_folder)


def test_each_signature_is_answered_with_the_cores_pose_and_covariance(asker, signatures, table):
    estimator = Estimator(table, "sam")
    for i, signature in enumerate(signatures, start=1):
        message = asker.ask(signature, i)
        assert message.header.frame_id == "leader/beacon"
        assert_is(message, estimator.estimate(parameters=signature))
    assert len({tuple(place_of(pose)[0]) for pose in asker.poses}) > 3
    asker.lab.statuses.clear()  # of earlier frames
    status = asker.lab.report(asker.node, OK)
    values = dict(figures(status))
    assert (values["answered"], values["method"]) == ("10", "sam")
    assert 0 < float(values["angle_rad"]) <= float(values["runner_up_angle_rad"]) < 0.25


def test_without_a_table_parameter_the_table_is_built_in_memory(lab, scene_file, signatures, table):
    asker = Asker(lab, scene_file)
    assert_is(asker.ask(signatures[0], 1), matched(table, signatures[0]))


def with_nan(message):
    message.data = np.array([0.5, 0.0, np.nan, 0.0, 0.0]).tobytes()


def far_away(message):
    message.data = np.array([0.01, 2.0, -2.0, 1.5, -1.5]).tobytes()


def without_a_point(message):
    message.width, message.data = 0, b""


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (with_nan, ("not finite", "nan")),
        (lambda message: setattr(message.fields[0], "name", "x"), ("wrong fields", "x, column")),
        (lambda message: setattr(message, "data", message.data[:-8]), ("truncated", "32 bytes")),
        (without_a_point, ("no light",)),
        (far_away, ("no match", "0.25")),
        (lambda message: setattr(message.header.stamp, "sec", 10), ("stamp not later",)),
        (lambda message: setattr(message.header.stamp, "sec", 2), ("stamp not later",)),
    ],
    ids=["nan", "fields", "truncated", "empty", "far", "repeated stamp", "earlier stamp"],
)
def test_a_bad_signature_gives_no_pose_but_is_told_and_the_next_good_one_is_answered(
    asker, signatures, table, spoil, words
):
    asker.ask(signatures[0], 10)
    bad = asker.message(signatures[1], 11)
    spoil(bad)
    asker.clouds.publish(bad)
    assert_is(
        asker.ask(signatures[2], 12), Estimator(table, "sam").estimate(parameters=signatures[2])
    )
    assert asker.seconds_answered() == [10, 12]
    asker.lab.report(asker.node, WARN, *words)
    asker.ask(signatures[3], 13)
    asker.lab.report(asker.node, OK)


@pytest.fixture(params=["another scene", "missing", "damaged"])
def bad_table(request, tmp_path, table_folder, murky_table_folder):
    """A folder that is no table for the scene, and what must be said of it."""
    folder = tmp_path / "bad"
    if request.param == "another scene":
        shutil.copytree(murky_table_folder, folder)
        return str(folder), ("another scene", "effects.attenuation", "k_per_m", "0.2")
    if request.param == "missing":
        return str(folder), ("no table there",)
    shutil.copytree(table_folder, folder)
    with (folder / "0.0").open("r+b") as file:
        file.truncate(200)
    return str(folder), ("block 0.0 is damaged",)


def test_a_bad_table_at_the_start_is_an_error_that_a_good_one_mends_at_run_time(
    lab, scene_file, bad_table, table_folder, table, signatures
):
    path, words = bad_table
    asker = Asker(lab, scene_file, table=path)
    asker.clouds.publish(asker.message(signatures[0], 1))
    lab.report(asker.node, ERROR, path, *words)
    lab.until(
        lambda: ("refused", "1") in figures(lab.report(asker.node, ERROR, path)),
        "the signature to be refused",
    )
    result = lab.set(asker.node, "table", table_folder)
    assert result.successful, result.reason
    assert_is(
        asker.ask(signatures[1], 2), Estimator(table, "sam").estimate(parameters=signatures[1])
    )
    assert asker.seconds_answered() == [2]
    lab.statuses.clear()
    asker.ask(signatures[2], 3)
    lab.report(asker.node, OK)


def test_a_bad_table_is_refused_at_run_time_with_the_reason_and_the_old_one_works_on(
    asker, bad_table, table_folder, table, signatures
):
    path, words = bad_table
    result = asker.lab.set(asker.node, "table", path)
    assert not result.successful
    for word in (path, *words):
        assert word in result.reason
    assert asker.node.get_parameter("table").value == table_folder
    assert_is(asker.ask(signatures[0], 1), matched(table, signatures[0]))
    asker.lab.report(asker.node, OK)


def test_a_table_that_the_system_cannot_read_is_refused_too(asker, tmp_path, signatures):
    (tmp_path / "table.yaml").mkdir()
    result = asker.lab.set(asker.node, "table", str(tmp_path))
    assert not result.successful
    assert str(tmp_path) in result.reason
    asker.ask(signatures[0], 1)


def test_another_table_of_the_scene_can_take_over_at_run_time(asker, table, signatures, tmp_path):
    estimate = matched(table, signatures[0])
    assert_is(asker.ask(signatures[0], 1), estimate)
    keep = (table.poses != estimate.pose).any(axis=1)
    thinner = type(table)(table.scene, table.poses[keep], table.parameters[keep])
    write_table(tmp_path / "thinner", thinner)
    assert asker.lab.set(asker.node, "table", str(tmp_path / "thinner")).successful
    message = asker.ask(signatures[0], 2)
    assert_is(message, matched(thinner, signatures[0]))
    np.testing.assert_array_equal(place_of(message)[0], estimate.runner_up_pose[:3])


def test_the_largest_angle_decides_whether_a_signature_is_answered(asker, table, signatures):
    angle = matched(table, signatures[0]).angle_rad
    assert asker.lab.set(asker.node, "max_angle_rad", angle * 0.999).successful
    asker.clouds.publish(asker.message(signatures[0], 1))
    asker.lab.report(asker.node, WARN, "no match", f"{angle:.3f} rad")
    assert asker.lab.set(asker.node, "max_angle_rad", angle * 1.001).successful
    asker.ask(signatures[0], 2)
    assert asker.seconds_answered() == [2]


def test_neighbours_and_roll_change_the_covariance_and_not_the_pose(asker, table, signatures):
    covariances, places = [], set()
    for i, (neighbours, roll_std_rad) in enumerate([(64, 0.02), (8, 0.02), (8, 0.3)], start=1):
        asker.ask(signatures[1], 2 * i - 1)  # the same thrice would be frozen
        assert asker.lab.set(asker.node, "neighbours", neighbours).successful
        assert asker.lab.set(asker.node, "roll_std_rad", roll_std_rad).successful
        message = asker.ask(signatures[0], 2 * i)
        places.add(tuple(place_of(message)[0]))
        estimate = matched(table, signatures[0], neighbours=neighbours)
        assert_is(message, estimate, roll_std_rad)
        covariances.append(np.reshape(message.pose.covariance, (6, 6)))
    assert len(places) == 1
    assert np.trace(covariances[0]) > np.trace(covariances[1])
    assert covariances[2][3, 3] - covariances[1][3, 3] == pytest.approx(0.3**2 - 0.02**2)


def test_the_pose_goes_to_tf_too_where_it_is_wanted(lab, scene_file, table_folder, signatures):
    tf2_msgs = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not installed")
    asker = Asker(
        lab,
        scene_file,
        table=table_folder,
        publish_tf=True,
        beacon_frame="dock/beacon",
        tf_child_frame="rov/base_link_by_light",
    )
    heard = lab.listen(tf2_msgs.TFMessage, "/tf")
    lab.connect()
    pose = asker.ask(signatures[0], 5)
    assert pose.header.frame_id == "dock/beacon"
    lab.until(lambda: heard, "a transform")
    (transform,) = heard[0].transforms
    assert transform.header == pose.header
    assert transform.child_frame_id == "rov/base_link_by_light"
    t, q = transform.transform.translation, transform.transform.rotation
    assert ([t.x, t.y, t.z], [q.x, q.y, q.z, q.w]) == place_of(pose)


def test_without_tf2_msgs_the_node_warns_and_works(
    lab, scene_file, table_folder, signatures, monkeypatch
):
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", None)  # makes its import fail
    asker = Asker(lab, scene_file, table=table_folder, publish_tf=True)
    logs = []
    lasting = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    lab.probe.create_subscription(Log, "/rosout", logs.append, lasting)
    lab.until(
        lambda: any(
            log.level == rclpy.logging.LoggingSeverity.WARN and "tf2_msgs" in log.msg
            for log in logs
        ),
        "a warning in the log",
    )
    asker.ask(signatures[0], 1)


def test_two_followers_in_namespaces_of_one_process_do_not_mix(lab, scene_file, scene, table):
    lab.begin({"scene": scene_file, "method": "sam"})
    model, sides = ForwardModel(scene), {}
    for name, y in (("/a", 0.5), ("/b", -0.5)):
        for node_type in (FeatureNode, EstimatorNode):
            assert lab.start(node_type, name).get_namespace() == name
        images = lab.talk(Image, f"{name}/array/image")
        poses = lab.listen(PoseWithCovarianceStamped, f"{name}/relative_pose")
        sides[name] = (
            images,
            poses,
            model.expose(np.tile([-5.0, y, 0.0, 0.0, 0.0], (3, 1)), np.random.default_rng(1)),
        )
    lab.connect()
    for images, poses, frames in sides.values():
        for seconds, image in enumerate(frames, start=1):  # the same stamps on both sides
            stamp = Time(sec=seconds)
            images.publish(image_to_message(image, Header(stamp=stamp)))
            message = lab.answer(poses, stamp, "a pose")
            signature = key_parameters(image, scene.full_scale_counts, scene.signature.peak)
            assert_is(message, Estimator(table, "sam", compiled=False).estimate(image, signature))
    ys = [[pose.pose.pose.position.y for pose in poses] for _, poses, _ in sides.values()]
    assert [len(y) for y in ys] == [3, 3]
    assert min(ys[0]) > 0 > max(ys[1])
    names = {f"{name[1:]}/{kind}_node" for name in sides for kind in ("feature", "estimator")}
    lab.until(lambda: {status.name for status in lab.statuses} == names, "four diagnostics")


def test_an_atomic_set_that_is_good_is_taken_whole(asker, table, signatures, tmp_path):
    keep = np.arange(len(table.poses)) % 2 == 0
    thinner = type(table)(table.scene, table.poses[keep], table.parameters[keep])
    write_table(tmp_path / "thinner", thinner)
    changes = {"table": str(tmp_path / "thinner"), "method": "sam_interpolated", "neighbours": 9}
    result = asker.node.set_parameters_atomically(
        [Parameter(name, value=value) for name, value in changes.items()]
    )
    assert result.successful, result.reason
    expected = Estimator(thinner, "sam_interpolated", neighbours=9).estimate(
        parameters=signatures[0]
    )
    assert_is(asker.ask(signatures[0], 1), expected)
