"""Designs and studies that several tests use."""

import numpy as np

from uuv_optical_array.forward.scene import load_scene, scene_from_settings
from uuv_optical_array.studies.design_sweep import Design, DesignStudy, Sweep

PLANAR = Design("planar", 5, 0.3, None, 6.0, 1, 0.0, 0.0)
CURVED = Design("curved", 4, 0.3, 0.25, 11.0, 1, 0.0, 0.0)
SMALL = Sweep(("planar", "curved"), (3, 5), (0.2, 0.4), (0.2, 0.32), (6.0, 8.0))


def scene_with(effects, name="follow", prior=None):
    settings = load_scene(name).settings()
    return scene_from_settings({**settings, "effects": effects, "prior": prior}, "test")


def rng(seed=1):
    return np.random.default_rng(seed)


def study_of(**changes):
    return DesignStudy(**{"scene": load_scene("follow"), "sweep": SMALL, "poses": 40, **changes})
