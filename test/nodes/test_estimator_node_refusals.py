"""Frames that the estimator node refuses, with the reason, and those after them."""

import itertools

import numpy as np
import pytest
from asker import assert_is
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.signature.features import FeatureSettings
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.shared.messages import image_to_message
from uuv_optical_array.studies.mismatches.kinds import kinds_named

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN


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
FRAMES = 3  # of each kind


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
    assert_is(
        asker.ask(signatures[2], 12), Estimator(table, "sam").estimate(parameters=signatures[2])
    )
    assert asker.seconds_answered() == [10, 12]
    asker.lab.report(asker.node, WARN, *words)
    asker.ask(signatures[3], 13)
    asker.lab.report(asker.node, OK)


def test_a_faulty_detector_is_named_while_poses_go_on(shower, images):
    spoilt = images[0].copy()
    spoilt[1, 3] = 0
    shower.show(spoilt, 1)
    status = shower.lab.report(shower.node, WARN, "faulty detector: row 1 column 3")
    assert "cure: faulty detector" in {pair.key for pair in status.values}
    shower.show(images[1], 2)
    shower.lab.report(shower.node, OK)
