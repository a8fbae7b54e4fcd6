"""Seas that differ from the scene, through the nodes: they say what the library says."""

import numpy as np
from asker import assert_is
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.shared.messages import image_to_message
from uuv_optical_array.studies.mismatches import kinds_named

KINDS = (
    "k-0.04,beam+0.6,power_x0.8,ambient_10,gradient_30,second_lamp_0.3,gains_0.01,dead_detector,"
    "stuck_detector,shade_0.05,half_shadow,mirrored,near_2m,noise,blob"
)
FRAMES = 8  # of each kind


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
