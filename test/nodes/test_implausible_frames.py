"""Over DDS: frozen frames, images of other stamps and features of no array get no pose."""

import numpy as np
import pytest
from asker import Asker, Shower
from diagnostic_msgs.msg import DiagnosticStatus

from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN


@pytest.fixture(scope="module")
def images(scene):
    rng = np.random.default_rng(9)
    poses = rng.uniform([-5.5, -0.2, -0.2, -0.1, -0.1], [-4.5, 0.2, 0.2, 0.1, 0.1], (6, 5))
    return ForwardModel(scene).expose(poses, rng)


def offer(shower, image, signature, seconds):
    """Send a frame and wait until it is answered or refused."""
    shower.images.publish(shower.picture(image, seconds))
    shower.lab.deliver(shower.node, shower.clouds, shower.message(signature, seconds))


def test_an_image_that_repeats_under_fresh_stamps_gets_no_pose_and_the_next_one_does(
    shower, images
):
    shower.show(images[0], 1)
    for seconds in range(2, 8):
        offer(shower, images[0], shower.signature(images[0]), seconds)
    shower.lab.report(shower.node, WARN, "frozen: the frame is the same as the one before")
    shower.show(images[1], 8)
    shower.show(images[0], 9)
    assert shower.seconds_answered() == [1, 8, 9]


def test_an_image_of_another_exposure_under_one_stamp_gets_no_pose(shower, images):
    for i in range(1, 6):
        offer(shower, images[i - 1], shower.signature(images[i]), i)
    shower.lab.report(shower.node, WARN, "another image: peak is")
    shower.show(images[5], 6)
    assert shower.seconds_answered() == [6]


def test_key_parameters_that_repeat_under_fresh_stamps_are_frozen_too(
    lab, scene_file, scene, table_folder, images
):
    asker = Asker(lab, scene_file, table=table_folder)
    signatures = key_parameters(images, scene.full_scale_counts, scene.signature.peak)
    for seconds in range(1, 12):
        lab.deliver(asker.node, asker.clouds, asker.message(signatures[0], seconds))
    lab.report(asker.node, WARN, "frozen")
    asker.ask(signatures[1], 12)
    # Nine readings with noise of one count repeat with 1e-5, and so once but not twice.
    assert asker.seconds_answered() == [1, 2, 12]


@pytest.mark.parametrize("method", ["sam", "sam_interpolated", "least_squares"])
@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (0, 1.7, "peak is 1.7, but it must be from 0 to 1"),
        (1, -2.4, "column is -2.4, but it must be from -2 to 2"),
        (4, 9.0, "skewness_vertical is 9, but it must be from -1.5 to 1.5"),
    ],
)
def test_features_that_no_array_can_have_get_no_pose(
    lab, scene_file, scene, table_folder, images, compiled_fit, method, place, value, words
):
    shower = Shower(lab, scene_file, scene, table=table_folder, method=method)
    signature = shower.signature(images[0])
    signature[place] = value
    offer(shower, images[0], signature, 1)
    lab.report(shower.node, WARN, words)
    shower.show(images[1], 2)
    assert shower.seconds_answered() == [2]
