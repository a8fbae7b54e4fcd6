"""One estimate by each method, beside one forward model with Jacobian: compare the rows."""

import numpy as np
import pytest

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

POSE = np.array([-6.0, 0.2, -0.1, 0.05, 0.1])
# What is far off in m and rad, for a method that ends at an entry of the table and for one that
# does not: some ten times what each leaves on average.
FAR = {"sam": 2.0, "sam_interpolated": 2.0, "least_squares": 0.5}
WAYS = [
    pytest.param("sam", False, id="sam"),
    pytest.param("sam_interpolated", False, id="sam_interpolated"),
    pytest.param("least_squares", True, id="least_squares by Numba"),
    pytest.param("least_squares", False, id="least_squares by NumPy"),
]


@pytest.fixture(scope="module")
def scene():
    return load_scene("reference")


@pytest.fixture(scope="module")
def table(scene):
    return build_table(scene)


@pytest.mark.benchmark(group="one estimate")
@pytest.mark.parametrize(("method", "compiled"), WAYS)
def test_image_to_estimate(benchmark, scene, table, method, compiled):
    image = ForwardModel(scene).expose(POSE, np.random.default_rng(1))
    estimator = Estimator(table, method, compiled=compiled)

    def estimate():
        parameters = key_parameters(image, scene.full_scale_counts, scene.signature.peak)
        return estimator.estimate(image, parameters)

    assert np.abs(benchmark(estimate).pose - POSE).max() < FAR[method]


@pytest.mark.benchmark(group="one planar image")
@pytest.mark.parametrize("compiled", [True, False], ids=["by Numba", "by NumPy"])
def test_planar_image_to_estimate(benchmark, scene, compiled):
    planar = scene.with_shape("planar")
    image = ForwardModel(planar).expose(POSE, np.random.default_rng(1))
    estimator = Estimator(build_table(planar), "least_squares", compiled=compiled)
    parameters = key_parameters(image, planar.full_scale_counts, planar.signature.peak)
    found = benchmark.pedantic(estimator.estimate, (image, parameters), rounds=10, warmup_rounds=1)
    assert np.abs(found.pose - POSE).max() < 2 * FAR["least_squares"]


@pytest.mark.benchmark(group="one estimate")
def test_a_forward_model_with_jacobian_for_4_poses(benchmark, scene):
    light, jacobian = benchmark(ForwardModel(scene).linearised, np.tile(POSE, (4, 1)))
    assert 50 < light.max() < 900
    assert jacobian.shape == (4, 25, 5)
