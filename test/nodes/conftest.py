"""What the tests of the estimator node send: images and key parameters, and who sends them."""

import numpy as np
import pytest
from asker import Asker, Shower

from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel


@pytest.fixture(scope="module")
def images(scene):
    """Ten noisy images of poses between those of the table."""
    rng = np.random.default_rng(8)
    poses = rng.uniform([-5.5, -0.2, -0.2, -0.1, -0.1], [-4.5, 0.2, 0.2, 0.1, 0.1], (10, 5))
    return ForwardModel(scene).expose(poses, rng)


@pytest.fixture(scope="module")
def signatures(scene, images):
    return key_parameters(images, scene.full_scale_counts, scene.signature.peak)


@pytest.fixture
def asker(lab, scene_file):
    return Asker(lab, scene_file)


@pytest.fixture
def joiner(lab, scene_file, scene, compiled_fit):
    """Sends both to a node that holds its match to the image."""
    return Shower(lab, scene_file, scene)
