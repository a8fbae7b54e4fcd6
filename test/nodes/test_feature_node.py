"""The feature node: an image is answered with its key parameters, or refused with the reason."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from scenes import ready
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from uuv_optical_array.estimation.signature.faint_light import FaintLight
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import power_offsets
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.shared.messages import image_to_message

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN


@pytest.fixture
def images(scene):
    """Four different images of the scene."""
    rng = np.random.default_rng(4)
    poses = rng.uniform([-8, -0.5, -0.5, -0.3, -0.3], [-4, 0.5, 0.5, 0.3, 0.3], (4, 5))
    return ForwardModel(scene).expose(poses, rng)


class Feeder:
    """Feeds a feature node over DDS and compares its answers with the core's."""

    def __init__(self, lab, scene, scene_file, **parameters):
        self.lab, self.scene = lab, scene
        lab.begin({"scene": scene_file, **parameters})
        self.node = lab.start(FeatureNode)
        self.images = lab.talk(Image, "array/image")
        self.clouds = lab.listen(PointCloud2, "array/features")
        lab.connect()

    def message(self, image, seconds):
        header = Header(stamp=Time(sec=seconds, nanosec=7), frame_id="rov/array")
        return image_to_message(image, header)

    def send(self, image, seconds):
        self.images.publish(self.message(image, seconds))

    def cloud(self, seconds):
        return self.lab.answer(self.clouds, Time(sec=seconds, nanosec=7))

    def check_answer(self, image, seconds):
        """Expect the core's key parameters of an image that was sent, bit by bit."""
        cloud = self.cloud(seconds)
        assert cloud.header.frame_id == "rov/array"
        expected = key_parameters(image, self.scene.full_scale_counts, self.scene.signature.peak)
        np.testing.assert_array_equal(np.frombuffer(cloud.data, "<f8"), expected)

    def seconds_answered(self):
        return [cloud.header.stamp.sec for cloud in self.clouds]


@pytest.fixture
def feeder(lab, scene, scene_file):
    return Feeder(lab, scene, scene_file)


def brighter_than_full_scale(message):
    message.data[0], message.data[1] = (1024).to_bytes(2, "little")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda message: setattr(message, "encoding", "mono8"), ("wrong encoding", "mono8")),
        (brighter_than_full_scale, ("above full scale", "1024", "1023")),
        (lambda message: setattr(message.header.stamp, "sec", 2), ("stamp not later", "2.0")),
    ],
    ids=["encoding", "bright", "earlier stamp"],
)
def test_a_bad_image_is_not_answered_but_told_and_the_next_good_one_is(
    feeder, images, spoil, words
):
    feeder.send(images[0], 10)
    feeder.check_answer(images[0], 10)
    bad = feeder.message(images[1], 11)
    spoil(bad)
    feeder.images.publish(bad)
    feeder.send(images[2], 12)
    feeder.check_answer(images[2], 12)
    assert feeder.seconds_answered() == [10, 12]
    status = feeder.lab.report(feeder.node, WARN, *words)
    values = {pair.key: pair.value for pair in status.values}
    assert (values["refused"], values["peak_counts"]) == ("1", f"{images[2].max():g}")
    feeder.send(images[3], 13)
    feeder.check_answer(images[3], 13)
    feeder.lab.report(feeder.node, OK)


@pytest.mark.parametrize(
    ("counts", "reason"), [(0, "no light"), (4, "no light"), (1023, "no pattern")]
)
def test_an_image_without_a_pattern_is_an_empty_cloud_with_the_images_header(
    feeder, images, counts, reason
):
    feeder.send(np.full((5, 5), counts), 1)
    cloud = feeder.cloud(1)
    assert (cloud.width * cloud.height, len(cloud.data)) == (0, 0)
    assert cloud.header.frame_id == "rov/array"
    feeder.lab.report(feeder.node, WARN, reason, f"{counts} counts")
    feeder.send(images[0], 2)
    feeder.check_answer(images[0], 2)
    feeder.lab.report(feeder.node, OK)


def test_daylight_as_bright_as_it_may_be_is_an_empty_cloud(lab):
    scene, rng = ready("follow"), np.random.default_rng(3)
    model, feeder = ForwardModel(scene), Feeder(lab, scene, "follow")
    daylight = model.read(np.full((5, 5), 8.0), rng)  # by a standard deviation of 5 counts
    assert daylight.max() > 8
    feeder.send(daylight, 1)
    assert feeder.cloud(1).width == 0
    feeder.lab.report(feeder.node, WARN, f"no light: daylight alone may read {daylight.max():g}")
    dim = daylight + model.light([-10.0, 0, 0, 0, 0]).round()
    feeder.send(dim, 2)
    feeder.check_answer(dim, 2)


def test_light_that_no_image_shows_has_a_topic_of_its_own(lab):
    scene, rng = ready("follow"), np.random.default_rng(5)
    model, feeder = ForwardModel(scene), Feeder(lab, scene, "follow")
    faint_clouds = lab.listen(PointCloud2, "array/faint_features")
    lab.connect()
    pose = [-8.5, 3.2, 0, 0, 0]  # from which the lamp is to starboard
    lights = [model.light(pose, 0.0, power_offsets([power], 1)) for power in (0.0, 1.0)]
    own = FaintLight(5)
    for seconds in range(1, 60):
        image = model.read(lights[seconds > 40], rng)
        feeder.send(image, seconds)
        assert feeder.cloud(seconds).width == 0
        came = own.look(seconds + 7e-9, image)
        if came is None:
            continue
        cloud = lab.answer(faint_clouds, Time(sec=seconds, nanosec=7))
        assert seconds > 40
        expected = key_parameters(came, scene.full_scale_counts, scene.signature.peak)
        found = np.frombuffer(cloud.data, "<f8")
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
        assert cloud.header.frame_id == "rov/array"
        if seconds > 45:
            assert found[1] > 0
    assert len(faint_clouds) > 5


def test_the_least_peak_can_be_given_at_the_start_and_set_while_the_node_runs(
    lab, scene, scene_file, images
):
    image, dim = images[0], images[0] // 100
    peak = float(dim.max())
    assert 2 <= peak < image.max()
    feeder = Feeder(lab, scene, scene_file, **{"feature_node:min_peak_counts": peak})
    feeder.send(dim, 1)
    feeder.check_answer(dim, 1)
    assert lab.set(feeder.node, "min_peak_counts", peak + 0.5).successful
    feeder.send(dim, 2)
    assert feeder.cloud(2).width == 0
    feeder.send(image, 3)
    feeder.check_answer(image, 3)
