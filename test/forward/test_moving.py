"""What changes with time: flicker, drift and clouds, and that estimators do not see them."""

import math

import numpy as np
import pytest
from scenes import make_scene

from uuv_optical_array.forward.model import ForwardModel

AHEAD = [-5.0, 0.1, -0.1, 0.05, 0.1]
FLICKER = {"lamp_flicker": {"depth": 0.2, "frequency_hz": 100.0}}
DRIFT = {"lamp_drift": {"std": 0.1, "time_scale_s": 20.0, "seed": 1}}
CLOUDS = {"depth": 1.5, "size_m": 0.15, "speed_m_per_s": 0.2, "distance_m": 2.5, "seed": 3}
PLUME = {"plume": CLOUDS}


def model_with(**chosen):
    return ForwardModel(make_scene(effects=chosen))


@pytest.mark.parametrize("chosen", [FLICKER, DRIFT, PLUME], ids=["flicker", "drift", "plume"])
def test_without_a_moment_there_is_the_mean_sea_which_estimators_believe(chosen):
    still, moving = model_with(), model_with(**chosen)
    np.testing.assert_array_equal(moving.expose(AHEAD), still.light(AHEAD))
    for found, expected in zip(moving.linearised(AHEAD), still.linearised(AHEAD), strict=True):
        np.testing.assert_array_equal(found, expected)
    moments = np.linspace(3.003, 50.0, 40)
    seen = moving.expose(np.broadcast_to(AHEAD, (40, 5)), time_s=moments)
    assert not np.allclose(seen, still.light(AHEAD), rtol=1e-2)


LAMPS = 200


def test_the_drift_has_the_stated_spread_and_correlation():
    # Over many lamps, as one record of 16 waves is not long enough.
    now, later = [], []
    still = model_with().light(AHEAD).max()
    for seed in range(LAMPS):
        model = model_with(lamp_drift={"std": 0.1, "time_scale_s": 20.0, "seed": seed})
        both = np.log(model.expose([AHEAD, AHEAD], time_s=[100.0, 120.0]).max(axis=(1, 2)) / still)
        now.append(both[0])
        later.append(both[1])
    assert np.std(now) == pytest.approx(0.1, rel=4 / math.sqrt(2 * LAMPS))
    assert abs(np.mean(now)) < 5 * 0.1 / math.sqrt(LAMPS)
    assert np.corrcoef(now, later)[0, 1] == pytest.approx(
        math.exp(-0.5), abs=4 * (1 - math.exp(-1)) / math.sqrt(LAMPS)
    )
