"""Designs and studies that several tests use."""

import numpy as np

from uuv_optical_array.forward.scene import load_scene, scene_from_settings
from uuv_optical_array.studies.designs.sweep import Design, sweep_of

PLANAR = Design("planar", 5, 0.3, None, 6.0, 1, 0.0, 0.0)
CURVED = Design("curved", 4, 0.3, 0.25, 11.0, 1, 0.0, 0.0)
LISTS = ["detectors_per_side=3,5", "width_m=0.2,0.4", "radius_m=0.2,0.32", "beam_sigma_deg=6,8"]
SMALL = sweep_of(load_scene("follow"), LISTS)


def scene_with(effects, name="follow", prior=None):
    settings = load_scene(name).settings()
    return scene_from_settings({**settings, "effects": effects, "prior": prior}, "test")


def rng(seed=1):
    return np.random.default_rng(seed)
