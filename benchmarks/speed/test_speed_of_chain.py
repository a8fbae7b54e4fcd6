"""One frame through the chain, stage by stage: compare the rows of the printed table."""

import numpy as np
import pytest

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

POSE = np.array([-6.0, 0.2, -0.1, 0.05, 0.1])


@pytest.fixture(scope="module")
def scene():
    return load_scene("reference")


@pytest.fixture(scope="module")
def model(scene):
    return ForwardModel(scene)


@pytest.fixture(scope="module")
def image(model):
    return model.expose(POSE, np.random.default_rng(1))


@pytest.mark.benchmark(group="one frame")
def test_pose_to_light(benchmark, model):
    light = benchmark(model.light, POSE)
    assert 50 < light.max() < 900


@pytest.mark.benchmark(group="one frame")
def test_pose_to_light_and_jacobian(benchmark, model):
    light, jacobian = benchmark(model.linearised, POSE)
    assert jacobian.shape == (*light.shape, 5)


@pytest.mark.benchmark(group="one frame")
def test_image_to_features(benchmark, scene, image):
    parameters = benchmark(key_parameters, image, scene.full_scale_counts, "subdetector")
    assert 0 < parameters[0] < 1


@pytest.mark.benchmark(group="one frame")
def test_features_to_estimate(benchmark, scene, image):
    estimator = Estimator(build_table(scene), "sam")
    parameters = key_parameters(image, scene.full_scale_counts, scene.signature.peak)
    estimate = benchmark(estimator.estimate, parameters=parameters)
    assert abs(estimate.pose[0] - POSE[0]) < 2.0


@pytest.mark.benchmark(group="4096 poses")
def test_a_block_of_poses_to_light(benchmark, model):
    light = benchmark(model.light, np.tile(POSE, (4096, 1)))
    assert light.shape == (4096, 5, 5)


@pytest.mark.benchmark(group="4096 poses")
def test_the_exponentials_of_a_block_alone(benchmark):
    exponents = np.full((4096, 25), -1.0)
    light = benchmark(np.exp, exponents)
    assert light.shape == (4096, 25)
