"""The estimator node: the core's pose, its track, or the reason why there is none."""

import itertools
import math
import re
import sys

import numpy as np
import pytest
import rclpy.logging
from asker import Asker, Shower, assert_is, figures, place_of
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.parameter import Parameter
from scenes import changed
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image, PointCloud2, Range
from std_msgs.msg import Header
from tables import write_table

from uuv_optical_array.estimation.estimator import Estimator, EstimatorSettings
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.signature.features import FeatureSettings, key_parameters
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.shared.messages import image_to_message
from uuv_optical_array.studies.mismatches.kinds import kinds_named

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
HERE = np.array([-6.0, 0.1, 0.1, 0.02, 0.03])


@pytest.fixture(scope="module")
def images(scene):
    """Ten noisy images of poses between those of the table."""
    rng = np.random.default_rng(8)
    poses = rng.uniform([-5.5, -0.2, -0.2, -0.1, -0.1], [-4.5, 0.2, 0.2, 0.1, 0.1], (10, 5))
    return ForwardModel(scene).expose(poses, rng)


@pytest.fixture(scope="module")
def signatures(scene, images):
    return key_parameters(images, scene.full_scale_counts, scene.signature.peak)


def matched(table, signature):
    return Estimator(table, "sam").estimate(parameters=signature)


@pytest.fixture
def asker(lab, scene_file):
    return Asker(lab, scene_file)


def test_each_signature_is_answered_with_the_cores_pose_and_covariance(asker, signatures, table):
    estimator = Estimator(table, "sam")
    for i, signature in enumerate(signatures, start=1):
        message = asker.ask(signature, i)
        assert message.header.frame_id == "leader/beacon"
        assert_is(message, estimator.estimate(parameters=signature))
    assert len({tuple(place_of(pose)[0]) for pose in asker.poses}) > 3
    status = asker.lab.report(asker.node, OK)
    values = dict(figures(status))
    assert (values["answered"], values["method"]) == ("10", "sam")
    assert 0 < float(values["angle_rad"]) <= float(values["runner_up_angle_rad"]) < 0.25


def beyond_the_array(message):
    values = np.frombuffer(message.data, "<f8").copy()
    values[1] = -2.4
    message.data = values.tobytes()


def without_a_point(message):
    message.width, message.data = 0, b""


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda message: setattr(message.fields[0], "name", "x"), ("wrong fields", "x, column")),
        (without_a_point, ("no light",)),
        (beyond_the_array, ("column is -2.4, but it must be from -2 to 2",)),
        (lambda message: setattr(message.header.stamp, "sec", 2), ("stamp not later",)),
    ],
    ids=["fields", "empty", "of no array", "earlier stamp"],
)
def test_a_bad_signature_gives_no_pose_but_is_told_and_the_next_good_one_is_answered(
    asker, signatures, table, spoil, words
):
    asker.ask(signatures[0], 10)
    bad = asker.message(signatures[1], 11)
    spoil(bad)
    asker.clouds.publish(bad)
    assert_is(asker.ask(signatures[2], 12), matched(table, signatures[2]))
    assert asker.seconds_answered() == [10, 12]
    asker.lab.report(asker.node, WARN, *words)
    asker.ask(signatures[3], 13)
    asker.lab.report(asker.node, OK)


def test_a_bad_table_is_an_error_at_the_start_and_refused_at_run_time(
    lab, scene_file, scene, table, tmp_path, signatures
):
    murky_scene = changed(scene, effects={"attenuation": {"k_per_m": 0.2}})
    good, murky = (
        write_table(tmp_path / name, each)
        for name, each in (("good", table), ("murky", build_table(murky_scene)))
    )
    words = murky, "another scene", "effects.attenuation", "k_per_m", "0.2"
    asker = Asker(lab, scene_file, table=murky)
    for neighbours in (32, 64):  # which mends nothing
        assert lab.set(asker.node, "neighbours", neighbours).successful
    lab.deliver(asker.node, asker.clouds, asker.message(signatures[0], 1))
    lab.report(asker.node, ERROR, *words)
    result = lab.set(asker.node, "table", good)
    assert result.successful, result.reason
    assert_is(asker.ask(signatures[1], 2), matched(table, signatures[1]))
    result = lab.set(asker.node, "table", murky)
    assert not result.successful
    assert all(word in result.reason for word in words)
    lab.statuses.clear()
    assert_is(asker.ask(signatures[2], 3), matched(table, signatures[2]))
    assert asker.seconds_answered() == [2, 3]
    lab.report(asker.node, OK)


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


def test_what_is_set_at_once_is_taken_whole_and_decides_what_is_answered(
    asker, table, signatures, tmp_path
):
    rows = np.arange(len(table.poses)) % 2 == 0
    some = type(table)(table.scene, table.poses[rows], table.parameters[rows])
    changes = {"table": write_table(tmp_path / "thinner", some), "method": "sam_interpolated"}
    changes |= {"neighbours": 9, "roll_std_rad": 0.3}
    result = asker.node.set_parameters_atomically(
        [Parameter(name, value=value) for name, value in changes.items()]
    )
    assert result.successful, result.reason
    expected = Estimator(some, "sam_interpolated", neighbours=9).estimate(parameters=signatures[0])
    assert_is(asker.ask(signatures[0], 1), expected, 0.3)
    angle = expected.angle_rad
    assert asker.lab.set(asker.node, "max_angle_rad", angle * 0.999).successful
    asker.clouds.publish(asker.message(signatures[0], 2))
    asker.lab.report(asker.node, WARN, "no match", f"{angle:.3f} rad")
    assert asker.lab.set(asker.node, "max_angle_rad", angle * 1.001).successful
    asker.ask(signatures[0], 3)
    assert asker.seconds_answered() == [1, 3]


def test_without_tf2_msgs_the_node_warns_and_works(lab, scene_file, signatures, monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", None)  # makes its import fail
    asker = Asker(lab, scene_file, publish_tf=True)
    (line,) = (line for line in lab.logged("tf2_msgs") if "tf2_msgs" in line.msg)
    assert line.level == rclpy.logging.LoggingSeverity.WARN
    asker.ask(signatures[0], 1)


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


@pytest.fixture
def joiner(lab, scene_file, scene, compiled_fit):
    """Sends both to a node that holds its match to the image."""
    return Shower(lab, scene_file, scene)


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


def test_a_faulty_detector_is_named_while_poses_go_on(shower, images):
    spoilt = images[0].copy()
    spoilt[1, 3] = 0
    shower.show(spoilt, 1)
    status = shower.lab.report(shower.node, WARN, "faulty detector: row 1 column 3")
    assert "cure: faulty detector" in {pair.key for pair in status.values}
    shower.show(images[1], 2)
    shower.lab.report(shower.node, OK)


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


@pytest.fixture
def tracked(lab, scene_file, scene, compiled_fit):
    return Shower(lab, scene_file, scene, method="least_squares", tracking=True)


def test_a_late_frame_enters_the_track_and_an_outlier_does_not(tracked, scene):
    rng = np.random.default_rng(7)
    model = ForwardModel(scene)
    assert tracked.lab.set(tracked.node, "buffer_s", 5.0).successful
    for seconds in (1, 2, 4):
        tracked.show(model.expose(HERE, rng), seconds)
    tracked.send(model.expose(HERE, rng), 3)
    tracked.lab.report(tracked.node, WARN, "late frame")
    tracked.send(model.expose(HERE + np.array([2.0, 0, 0, 0, 0]), rng), 5)
    tracked.lab.report(tracked.node, WARN, "outlier", "standard deviations off")
    tracked.show(model.expose(HERE, rng), 6)
    assert tracked.seconds_answered() == [1, 2, 4, 6]


class Sounder:
    """Sends ranges to a node that fits and tracks."""

    def __init__(self, lab, scene_file, scene):
        given = {"use_range": True, "range_std_m": 0.05, "buffer_s": 5.0}
        on_range, self.heard = EstimatorNode.on_range, []

        def heard(node, message):
            on_range(node, message)
            self.heard.append(message)

        lab.patch.setattr(EstimatorNode, "on_range", heard)
        self.shower = Shower(lab, scene_file, scene, method="least_squares", tracking=True, **given)
        self.lab, self.node = lab, self.shower.node
        self.talker = lab.talk(Range, "range")
        lab.connect()

    def sound(self, range_m, seconds, **fields):
        header = Header(stamp=Time(sec=seconds, nanosec=9))
        message = Range(header=header, range=range_m, max_range=50.0)
        for name, value in fields.items():
            setattr(message, name, value)
        before = len(self.heard)
        self.talker.publish(message)
        self.lab.until(lambda: len(self.heard) > before, "the range to arrive")


@pytest.fixture
def sounder(lab, scene_file, scene, compiled_fit):
    return Sounder(lab, scene_file, scene)


def test_ranges_enter_the_track_at_their_stamps_with_their_variance_or_the_parameters(
    sounder, scene, table
):
    rng, pipeline = np.random.default_rng(9), Pipeline(Estimator(table).wait())
    pipeline.track_with(TrackerSettings(buffer_s=5.0))
    measured = float(np.float32(np.linalg.norm(HERE[:3]) + 0.1))
    variance = {"variance": 0.04} if hasattr(Range(), "variance") else {}
    stds = {2: 0.05, 3: math.sqrt(np.float32(0.04)) if variance else 0.05}
    for seconds in range(1, 5):
        image = ForwardModel(scene).expose(HERE, rng)
        if seconds in stds:
            sounder.sound(measured, seconds, **(variance if seconds == 3 else {}))
            pipeline.range(seconds * 10**9 + 9, measured, stds[seconds])
        sounder.shower.show(image, seconds)
        answer = pipeline.answer(seconds * 10**9 + 9, image)
        assert_is(sounder.shower.track(seconds), answer.track)
    assert answer.track.range.stamp_ns == 3 * 10**9 + 9
    values = dict(figures(sounder.lab.report(sounder.node, OK)))
    assert re.fullmatch(r"[+-]0.\d\d m off the track, \d.\d standard .*; used", values["range"])


def test_false_ranges_and_those_of_another_time_change_no_track_and_are_told(sounder, scene, table):
    rng, pipeline = np.random.default_rng(9), Pipeline(Estimator(table).wait())
    right, now = float(np.linalg.norm(HERE[:3])), sounder.node.get_clock().now().seconds_nanoseconds
    cases = [
        (dict(range_m=right, seconds=94), "range, late range", "more than buffer_s 5"),
        (dict(range_m=right + 3.0, seconds=102), "false range", "standard deviations; refused"),
        (dict(range_m=math.nan, seconds=103), "range, not finite", "nan"),
        (dict(range_m=-2.0, seconds=104), "range, out of bounds", "-2 m, not within", "0 to 50"),
        (dict(range_m=51.0, seconds=105), "range, out of bounds", "51 m, not within", "0 to 50"),
        (dict(range_m=0.0, seconds=106), "range, range: 0 m; give from 0.001"),
        (dict(range_m=right, seconds=now()[0] + 9), "range, stamp ahead"),
    ]
    if hasattr(Range(), "variance"):
        cases.append((dict(range_m=right, seconds=109, variance=-1.0), "out of bounds", "-1 m^2"))
    sounder.shower.show(ForwardModel(scene).expose(HERE, rng), 100)
    for seconds, (sent, *words) in enumerate(cases, start=101):
        sounder.sound(**sent)
        sounder.shower.show(ForwardModel(scene).expose(HERE, rng), seconds)
        sounder.lab.report(sounder.node, WARN, *words)
    rng = np.random.default_rng(9)
    pipeline.track_with(TrackerSettings(buffer_s=5.0))
    for seconds in range(100, 101 + len(cases)):
        answer = pipeline.answer(seconds * 10**9 + 9, ForwardModel(scene).expose(HERE, rng))
    assert_is(sounder.shower.track(seconds), answer.track)


@pytest.mark.parametrize(
    ("refused", "reason"),
    [(("table", "/nowhere"), "no table there"), (("method", "magic"), "magic")],
)
def test_an_atomic_set_that_is_refused_leaves_track_estimator_and_parameters(
    tracked, scene, table, refused, reason
):
    images = ForwardModel(scene).expose(np.tile(HERE, (4, 1)), np.random.default_rng(8))
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


def test_tracked_poses_do_not_run_backwards_and_a_clock_that_was_set_back_starts_anew(
    lab, scene_file, signatures
):
    asker = Asker(lab, scene_file, tracking=True, buffer_s=5.0)
    for signature, seconds in zip(signatures, [100, 102, 101, 103, 50, 51, 52], strict=False):
        lab.deliver(asker.node, asker.clouds, asker.message(signature, seconds))
    lab.until(lambda: 52 in asker.seconds_answered(), "the last pose")
    assert asker.seconds_answered() == [100, 102, 103, 51, 52]
    lab.report(asker.node, WARN, "late frame", "stamp not later: 50.0")


@pytest.mark.parametrize("back_s", [3, 4, 40])
def test_a_clock_that_is_set_back_costs_a_track_one_frame_however_far(
    lab, scene_file, signatures, back_s
):
    """Also where it is no farther than a track waits for frames that are late or for light."""
    asker = Asker(lab, scene_file, tracking=True)
    seconds = [100, 101, 102, *(103 - back_s + i for i in range(3))]
    for signature, second in zip(signatures, seconds, strict=False):
        lab.deliver(asker.node, asker.clouds, asker.message(signature, second))
    lab.until(lambda: len(asker.seconds_answered()) > 4, "the last pose")
    assert asker.seconds_answered() == seconds[:3] + seconds[4:]


def test_a_frame_that_the_core_refuses_gets_no_pose_and_the_next_one_does(joiner, images):
    joiner.show(images[0], 1)
    seconds, answered = itertools.count(2), [1]
    for image, of_signature, times, words in (
        (images[0], images[0], 6, "frozen: the frame is the same as one of the 32 before"),
        (images[1], images[2], 1, "another image: peak is"),  # two exposures under one stamp
        (np.ones((4, 4)), images[0], 1, "wrong size: 4 x 4"),
    ):
        for stamp in itertools.islice(seconds, times):
            joiner.images.publish(joiner.picture(image, stamp))
            message = joiner.message(joiner.signature(of_signature), stamp)
            joiner.lab.deliver(joiner.node, joiner.clouds, message)
        joiner.lab.report(joiner.node, WARN, words)
        answered.append(next(seconds))
        joiner.show(images[len(answered)], answered[-1])
    assert joiner.seconds_answered() == answered


def test_an_image_that_is_refused_gets_no_pose_and_the_next_one_does(shower, images, scene):
    shower.show(images[0], 1)
    seconds, answered = itertools.count(2), [1]
    soon = shower.node.get_clock().now().nanoseconds // 10**9 + 9
    for image, stamps, words in (
        (images[0], itertools.islice(seconds, 6), "frozen: the frame is the same as one"),
        (np.ones((4, 4)), itertools.islice(seconds, 1), "wrong size: 4 x 4"),
        (images[0] + scene.full_scale_counts, itertools.islice(seconds, 1), "above full scale"),
        (np.full((5, 5), 4), itertools.islice(seconds, 1), "no light: the peak of 4 counts is"),
        (np.full((5, 5), 9), itertools.islice(seconds, 1), "no pattern: every detector reads 9"),
        (images[-1], [soon], "stamp ahead"),
        (images[-2], [None], "stamp not later"),  # the newest again
    ):
        for stamp in stamps:
            picture = shower.picture(image, stamp or answered[-1])
            shower.lab.deliver(shower.node, shower.images, picture)
        shower.lab.report(shower.node, WARN, words)
        answered.append(next(seconds))
        shower.show(images[len(answered) - 1], answered[-1])
    assert shower.seconds_answered() == answered


DIM = np.array([-24.0, 0.1, 0.1, 0.02, 0.03])


def test_what_is_too_dim_to_match_the_feature_node_alone_decides(joiner, scene):
    image = ForwardModel(scene).expose(DIM, np.random.default_rng(2))
    assert 0 < image.max() < FeatureSettings.min_peak_counts
    assert joiner.lab.set(joiner.node, "max_angle_rad", 1.0).successful
    joiner.show(image, 1)


def test_what_is_too_dim_to_fit_is_a_parameter(shower, scene):
    rng, model = np.random.default_rng(2), ForwardModel(scene)
    first, second = model.expose(np.tile(DIM, (2, 1)), rng)
    peak = float(min(first.max(), second.max()))
    assert 1 < peak < FeatureSettings.min_peak_counts
    shower.lab.deliver(shower.node, shower.images, shower.picture(first, 1))
    shower.lab.report(shower.node, WARN, "no light: the peak", "is below 5")
    assert shower.lab.set(shower.node, "min_peak_counts", peak).successful
    shower.show(second, 2)
    assert shower.seconds_answered() == [2]


def test_key_parameters_that_repeat_under_fresh_stamps_are_frozen_too(asker, lab, signatures):
    for seconds in range(1, 12):
        lab.deliver(asker.node, asker.clouds, asker.message(signatures[0], seconds))
    lab.report(asker.node, WARN, "frozen")
    asker.ask(signatures[1], 12)
    # Nine readings with noise of one count repeat with 1e-5, and so once but not twice.
    assert asker.seconds_answered() == [1, 2, 12]


# Seas that differ from the scene: the nodes say what the library says.
KINDS = (
    "k-0.04,beam+0.6,power_x0.8,ambient_10,gradient_30,second_lamp_0.3,gains_0.01,dead_detector,"
    "stuck_detector,shade_0.05,half_shadow,mirrored,near_2m,noise,blob"
)
FRAMES = 6  # of each kind


def frames_of(scene):
    """Return images of all kinds, one kind after the other."""
    model, images = ForwardModel(scene), []
    for kind in kinds_named(KINDS, scene):
        poses = lit_poses(model, FRAMES, np.random.default_rng(3), kind.draw)
        images.append(
            model.read(kind.light(model, poses, np.random.default_rng(4)), np.random.default_rng(5))
        )
    return np.concatenate(images)


def test_the_nodes_answer_and_refuse_what_the_library_does(lab):
    scene = load_scene("follow")
    pipeline = Pipeline(Estimator(scene, compiled=True), tracking=None)
    images = frames_of(scene)
    lab.begin({"scene": "follow", "estimator_node:tracking": False})  # the poses make no track
    feature, estimator = lab.start(FeatureNode), lab.start(EstimatorNode)
    estimator.pipeline.estimator.wait()
    talker = lab.talk(Image, "array/image")
    poses = lab.listen(PoseWithCovarianceStamped, "relative_pose")
    lab.connect()
    totals, answered = estimator.diagnostics.totals, 0
    for seconds, image in enumerate(images, start=1):
        stamp, known = Time(sec=seconds), dict(totals)
        talker.publish(image_to_message(image, Header(stamp=stamp)))
        answer = pipeline.answer(seconds * 10**9, image)
        if answer.estimate is not None:
            answered += 1
            assert_is(lab.answer(poses, stamp), answer.estimate)
        lab.until(lambda known=known: totals != known, "what is said of the image")
    assert len(poses) == answered
    assert feature.diagnostics.totals["refused"] == 0
    # Shadows and noise are most of what is refused.
    assert 10 * FRAMES <= answered <= 13 * FRAMES
