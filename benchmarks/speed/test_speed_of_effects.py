"""Each effect alone and all together, beside the ideal light, on a million readings."""

import effect_costs
import numpy as np
import pytest
from effect_costs import MILLION, POSES, models

MODELS = models()


@pytest.mark.benchmark(group="a million readings")
@pytest.mark.parametrize("name", list(MODELS))
def test_a_million_readings(benchmark, name):
    rng = np.random.default_rng(3)
    images = benchmark.pedantic(MODELS[name].expose, (POSES, rng), rounds=5, warmup_rounds=1)
    assert images.shape == (MILLION, 5, 5)
    assert np.isfinite(images).all()


def test_every_effect_has_its_price_as_a_multiple_of_the_ideal_light(capsys):
    with capsys.disabled():
        print(f"\n{effect_costs.report(rounds=5)}")
