"""By how much the aims of lamp and array move a pose, beside finite turns by SciPy."""

import numpy as np
import pytest
from calibrated_seas import STRAIGHT, seen
from scenes import changed

from uuv_optical_array.forward.aim import aim_slopes

POSE = np.array([-5.0, 0.6, -0.4, 0.2, -0.3])
ARRAY_STD_DEG, LAMP_STD_DEG, STEP_RAD = 0.4, 0.9, 1e-6


@pytest.mark.parametrize("roll", [0.0, 0.5, -0.3])
def test_slopes_are_those_of_finite_turns(roll):
    prior = {"known": "exactly", "aim_std_deg": ARRAY_STD_DEG, "lamp_aim_std_deg": LAMP_STD_DEG}
    scene = changed("follow", prior=prior)
    slopes = []
    for i, std_deg in (
        (2, ARRAY_STD_DEG),
        (3, ARRAY_STD_DEG),
        (0, LAMP_STD_DEG),
        (1, LAMP_STD_DEG),
    ):
        ends = []
        for sign in (-1, 1):
            aims = STRAIGHT.copy()
            aims[i] = sign * STEP_RAD
            ends.append(seen(POSE[None], np.array([roll]), aims, scene.array.bow_m)[0][0])
        slopes.append(np.radians(std_deg) * (ends[1] - ends[0]) / (2 * STEP_RAD))
    found = aim_slopes(scene, POSE, roll)
    for one, wanted in zip(found.T, slopes, strict=True):
        # Which way an aim is counted is not told by a standard deviation.
        np.testing.assert_allclose(np.outer(one, one), np.outer(wanted, wanted), atol=1e-8)
