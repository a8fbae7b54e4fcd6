"""List the detectors of an array, row by row: the place and the tilt of each, to build it.

Places are in m from the centre of the sphere (of a planar array its middle): x ahead, y to port,
z up. Yaw turns a detector to port, then pitch turns it down.

Run: python3 detectors.py [SCENE]
"""

import sys

import numpy as np

from uuv_optical_array import load_scene
from uuv_optical_array.forward.array import build_array

scene = load_scene(*sys.argv[1:] or ["follow"])
array = build_array(scene.array)
places = array.positions - [scene.array.bow_m, 0, 0]
yaws = np.degrees(np.arctan2(array.normals[:, 1], array.normals[:, 0]))
pitches = np.degrees(-np.arcsin(array.normals[:, 2]))
for place, yaw, pitch in zip(places, yaws, pitches, strict=True):
    print("{:8.4f} {:8.4f} {:8.4f} m".format(*place), f"yaw {yaw:.2f}, pitch {pitch:.2f} deg")
