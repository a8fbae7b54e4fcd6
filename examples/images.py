"""Make images: what the array reads, aligned behind the lamp.

Run: python3 images.py [SCENE]
"""

import sys

import numpy as np

from uuv_optical_array import ForwardModel, load_scene

scene = load_scene(*sys.argv[1:] or ["follow"])
model, rng = ForwardModel(scene), np.random.default_rng(seed=1)
poses = np.zeros((5, 5))  # x, y, z in m, pitch and yaw in rad
poses[:, 0] = [-4, -5, -6, -7, -8]  # behind the lamp
images = model.expose(poses, rng)
for pose, image in zip(poses, images, strict=True):
    print(f"{-pose[0]:g} m behind the lamp, counts, from the top and from port:")
    print(image.round().astype(int))
