"""Light without the lamp, beside what the scene's file says of it."""

import numpy as np
from scenes import changed

from uuv_optical_array.forward.daylight import without_lamps
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import DAYLIGHT


def test_it_is_the_ambient_level_that_rises_from_the_middle_to_the_edges():
    scene = changed("reference", effects={"ambient": {"level_counts": 30.0}})
    light, slopes = without_lamps(ForwardModel(scene), DAYLIGHT)
    u, v = np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5))
    np.testing.assert_allclose(light, 30.0, rtol=1e-9)
    np.testing.assert_allclose(slopes, [np.ones(25), u.ravel(), v.ravel()], atol=1e-9)


def test_a_scene_without_daylight_is_dark_but_for_the_pedestal():
    scene = changed("reference", effects={"pedestal": {"level_counts": 12.0}})
    light, slopes = without_lamps(ForwardModel(scene), [])
    np.testing.assert_allclose(light, 12.0, rtol=1e-9)
    assert slopes.shape == (0, 25)
