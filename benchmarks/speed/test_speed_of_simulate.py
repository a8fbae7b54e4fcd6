"""The light at 100,000 random poses, beside the exponentials of as many readings."""

import numpy as np
import pytest

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

COUNT = 100_000
LOW, HIGH = [-8, -0.6, -0.6, -0.35, -0.35], [-4, 0.6, 0.6, 0.35, 0.35]
POSES = np.random.default_rng(1).uniform(LOW, HIGH, (COUNT, 5))


@pytest.mark.benchmark(group=f"{COUNT:,} poses")
def test_light_at_random_poses(benchmark):
    model = ForwardModel(load_scene("reference"))
    images = benchmark.pedantic(model.light, (POSES,), rounds=10, warmup_rounds=1)
    assert images.shape == (COUNT, 5, 5)
    assert 0 <= images.min() < 500 < images.max()


@pytest.mark.benchmark(group=f"{COUNT:,} poses")
def test_the_exponentials_alone(benchmark):
    exponents = np.random.default_rng(2).uniform(-20, 0, (COUNT, 5, 5))
    images = np.empty_like(exponents)
    benchmark.pedantic(np.exp, (exponents, images), rounds=10, warmup_rounds=1)
    assert 0 < images.min() < images.max() < 1
