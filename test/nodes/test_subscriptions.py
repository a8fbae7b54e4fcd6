"""A node listens to what its method needs and to nothing else."""

import numpy as np
import pytest
from asker import Asker, Shower

from uuv_optical_array.forward.model import ForwardModel


def topics(node):
    return {ear.topic_name for ear in node.subscriptions} - {"/parameter_events", "/clock"}


@pytest.mark.parametrize("use_image", [False, True])
@pytest.mark.parametrize("use_imu", [False, True])
@pytest.mark.parametrize("use_commands", [False, True])
def test_the_estimator_listens_to_what_it_was_told_to_use(
    lab, scene_file, table_folder, use_image, use_imu, use_commands
):
    uses = dict(use_image=use_image, use_imu=use_imu, use_commands=use_commands)
    asker = Asker(lab, scene_file, table=table_folder, **uses)
    wanted = {
        "/array/features": True,
        "/array/image": use_image,
        "/imu": use_imu,
        "/cmd_vel": use_commands,
    }
    assert topics(asker.node) == {topic for topic, needed in wanted.items() if needed}


def test_the_fit_is_refused_while_the_node_reads_no_image(lab, scene_file, table_folder):
    asker = Asker(lab, scene_file, table=table_folder)
    result = lab.set(asker.node, "method", "least_squares")
    assert not result.successful
    assert "use_image" in result.reason
    asker.ask(np.array([0.5, 0.1, 0.0, 0.0, 0.0]), 3)


def test_a_match_waits_for_the_image_that_it_is_held_to(lab, scene_file, scene, table_folder):
    shower = Shower(lab, scene_file, scene, table=table_folder)
    image = ForwardModel(scene).expose([-6.0, 0, 0, 0, 0], np.random.default_rng(1))
    shower.clouds.publish(shower.message(shower.signature(image), 1))
    lab.until(lambda: shower.node.waiting, "the signature")
    assert not shower.poses
    shower.images.publish(shower.picture(image, 1))
    lab.until(lambda: shower.poses, "a pose")
