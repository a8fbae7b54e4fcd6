"""Feature, estimator and formation node of one process: the answers of three, the newest first."""

import numpy as np
import pytest
from asker import assert_is
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.nodes.follower_node import follower
from uuv_optical_array.nodes.shared.messages import image_to_message

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
POSE = np.array([-6.0, 0.1, -0.1, 0.02, 0.03])


class Follower:
    """Sends images to the three nodes and hears what they publish."""

    def __init__(self, lab, scene_file, method):
        self.lab = lab
        # Images of a test come faster than their stamps say, and poses settle by a steady clock.
        given = {"estimator_node:method": method, "formation_node:settle_s": 0.0}
        lab.begin({"scene": scene_file} | given)
        self.feature, self.estimator, self.formation = (
            lab.start(lambda node=node: node) for node in follower()
        )
        self.images = lab.talk(Image, "array/image")
        self.clouds = lab.listen(PointCloud2, "array/features")
        self.poses = lab.listen(PoseWithCovarianceStamped, "relative_pose")
        self.tracks = lab.listen(Odometry, "relative_odometry")
        self.commands = lab.listen(TwistStamped, "cmd_vel")
        lab.connect()

    def show(self, image, seconds):
        header = Header(stamp=Time(sec=seconds), frame_id="rov/array")
        self.images.publish(image_to_message(image, header))


@pytest.fixture
def method():
    return "sam"


@pytest.fixture
def rov(lab, scene_file, compiled_fit, method):
    return Follower(lab, scene_file, method)


BOTH = pytest.mark.parametrize("method", ["sam", "least_squares"])


@BOTH
def test_an_image_gets_the_answers_of_three_processes_without_a_topic_between(
    rov, scene, table, method
):
    pipeline = Pipeline(Estimator(table, method))
    rng = np.random.default_rng(5)
    for seconds, image in enumerate(ForwardModel(scene).expose(np.tile(POSE, (2, 1)), rng), 1):
        rov.show(image, seconds)
        signature = key_parameters(image, scene.full_scale_counts, scene.signature.peak)
        cloud = rov.lab.answer(rov.clouds, Time(sec=seconds))
        np.testing.assert_array_equal(np.frombuffer(cloud.data, "<f8"), signature)
        answer = pipeline.answer(seconds * 10**9, image)
        assert_is(rov.lab.answer(rov.poses, Time(sec=seconds)), answer.estimate)
        assert_is(rov.lab.answer(rov.tracks, Time(sec=seconds)), answer.track)
    rov.lab.until(lambda: rov.commands, "a command")
    heard = {ear.topic_name for ear in (*rov.estimator.subscriptions, *rov.formation.subscriptions)}
    assert not heard & {"/array/image", "/array/features", "/relative_odometry"}
    for node in (rov.feature, rov.estimator):
        rov.lab.report(node, OK, "answered")
    # It warns that the light is gone by the time that a busy machine asks it for a report.
    assert rov.formation.diagnostics.totals["taken"] == 2


@BOTH
def test_an_image_without_light_is_an_empty_cloud_and_no_pose(rov):
    rov.show(np.zeros((5, 5)), 1)
    assert rov.lab.answer(rov.clouds, Time(sec=1)).width == 0
    rov.lab.report(rov.estimator, WARN, "no light")
    assert not rov.poses


@BOTH
def test_light_that_no_image_shows_comes_to_the_law_without_a_topic(rov, scene):
    came, heard = np.arange(25.0).reshape(5, 5), []
    rov.lab.patch.setattr(rov.feature.faint_light, "look", lambda stamp_s, image: came)
    rov.lab.patch.setattr(rov.formation.following, "glimmered", lambda *given: heard.append(given))
    rov.show(np.zeros((5, 5)), 1)
    assert rov.lab.answer(rov.clouds, Time(sec=1)).width == 0
    _, glow = rov.lab.until(lambda: heard, "the faint light")[0]
    assert glow == (-1.0, -1.0, 24.0 / scene.full_scale_counts)  # at the starboard edge, below


@BOTH
def test_an_image_above_full_scale_is_refused_once_and_the_next_one_answered(rov, scene, method):
    image = ForwardModel(scene).expose(POSE, np.random.default_rng(9))
    rov.show(image + 1023, 1)
    rov.lab.report(rov.feature, WARN, "above full scale")
    rov.show(image, 2)
    rov.lab.answer(rov.poses, Time(sec=2))
    rov.lab.answer(rov.clouds, Time(sec=2))
    assert len(rov.poses) == len(rov.clouds) == 1
    refused = rov.feature.diagnostics.totals["refused"], rov.estimator.diagnostics.totals["refused"]
    assert refused == (1, method == "least_squares")


@BOTH
def test_a_pose_waits_for_nothing_that_can_come_later_and_the_next_frame_for_all_of_it(
    rov, scene, method
):
    done = []
    node = rov.estimator

    def noted(owner, name, word):
        call = getattr(owner, name)
        rov.lab.patch.setattr(owner, name, lambda *given: (done.append(word), call(*given))[1])

    noted(node.poses, "publish", "pose")
    noted(node.pipeline.tracker, "track", "track")
    noted(node.tracks, "publish", "odometry")
    noted(node, "hand_over", "command")
    noted(rov.formation, "on_look", "look")
    noted(rov.feature.features, "publish", "features")
    if method == "least_squares":
        noted(rov.feature, "key_parameters", "parameters")
    images = ForwardModel(scene).expose(np.tile(POSE, (2, 1)), np.random.default_rng(7))
    for seconds, image in enumerate(images, 1):  # both before the executor has a turn
        header = Header(stamp=Time(sec=seconds), frame_id="rov/array")
        rov.feature.on_image(image_to_message(image, header))
    whole = ["pose", "look", "track", "odometry", "command", "features"]
    if method == "least_squares":
        whole.insert(1, "parameters")
    assert done == [*whole, "pose"]
    rov.lab.until(lambda: done == 2 * whole, "the rest")


def test_of_images_that_wait_the_newest_is_served_and_the_others_are_counted(rov, scene):
    rng = np.random.default_rng(6)
    for seconds, image in enumerate(ForwardModel(scene).expose(np.tile(POSE, (9, 1)), rng), 1):
        rov.show(image, seconds)
    rov.lab.answer(rov.clouds, Time(sec=9))
    served = [cloud.header.stamp.sec for cloud in rov.clouds]
    assert served == sorted(set(served))
    passed_over = 9 - len(served)
    assert passed_over > 0
    status = rov.lab.report(rov.feature, OK, "passed over for newer ones")
    assert {pair.key: pair.value for pair in status.values}["passed_over"] == str(passed_over)
