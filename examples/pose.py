"""Estimate a pose with its covariance from one image.

Run: python3 pose.py [SCENE]
"""

import sys

import numpy as np

from uuv_optical_array import Estimator, ForwardModel, NoPose, load_scene

scene = load_scene(*sys.argv[1:] or ["follow"])
truth = np.array([-4.5, 0.3, -0.2, 0.1, -0.15])  # x, y, z in m, pitch and yaw in rad
image = ForwardModel(scene).expose(truth, np.random.default_rng(seed=1))
try:
    estimate = Estimator(scene).estimate(image)
except NoPose as reason:
    sys.exit(f"no pose: {reason}")
std = np.sqrt(estimate.covariance.diagonal())
for name, *numbers in zip(("x", "y", "z", "pitch", "yaw"), truth, estimate.pose, std, strict=True):
    print("{:<6} truth {:6.3f}, estimate {:6.3f} +- {:.3f}".format(name, *numbers))
