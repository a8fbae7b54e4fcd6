"""List the detectors of an array, row by row: where each sits, where it looks, and its wires.

Places are in mm from the centre of the sphere (of a planar array its middle): x ahead, y to port,
z up. Yaw turns a detector to port, then pitch turns it down; tilt is both together. A row has one
cable, whose cores are named for five detectors; U1 to U4 are the converters of the guide.

Run: python3 detectors.py [SCENE]
"""

import sys

import numpy as np

from uuv_optical_array import load_scene
from uuv_optical_array.forward.array import build_array

CORES = "white/orange", "orange", "white/green", "green", "white/blue"
scene = load_scene(*sys.argv[1:] or ["follow"])
array, side = build_array(scene.array), scene.array.detectors_per_side
places = 1e3 * (array.positions - [scene.array.bow_m, 0, 0])
x, y, z = array.normals.T
angles = np.degrees([np.arctan2(y, x), -np.arcsin(z), np.arccos(x)]).T
print("  no row col      x      y      z    yaw  pitch   tilt  core          input")
for i, numbers in enumerate(np.hstack([places, angles]).round(1) + 0.0):
    core = CORES[i % side] if side <= len(CORES) else ""
    print(f"{i:4d}{i // side:4d}{i % side:4d}", end="")
    print("".join(f"{each:7.1f}" for each in numbers), f" {core:<12}  U{i // 8 + 1} AIN{i % 8}")
