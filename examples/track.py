"""Track a follower that swings across, and plot it.

Run: python3 track.py [SCENE] [PICTURE]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

from uuv_optical_array import Estimator, ForwardModel, Pipeline, load_scene

scene, picture = load_scene([*sys.argv[1:], "follow"][0]), [*sys.argv[2:], "track.png"][0]
model, rng, pipeline = ForwardModel(scene), np.random.default_rng(1), Pipeline(Estimator(scene))
times = np.arange(0, 6, 0.1)  # s
truth = np.tile([-4.5, 0, 0, 0, 0], (len(times), 1))  # x, y, z in m, pitch and yaw in rad
truth[:, 1] = 0.5 * np.sin(2 * np.pi * times / 6)
images = [model.expose(pose, rng, time_s=time) for pose, time in zip(truth, times, strict=True)]
answers = [pipeline.answer(round(t * 1e9), image) for t, image in zip(times, images, strict=True)]
posed = np.array([answer.track is not None for answer in answers])  # the others give a `reason`
frames = np.array([answer.estimate.pose for answer in answers if answer.track])
track = np.array([answer.track.pose for answer in answers if answer.track])
truth = truth[posed]
for name, poses in (("frames", frames), ("track", track)):
    print(f"{name}: RMS error of y {np.sqrt(np.mean((poses - truth)[:, 1] ** 2)):.3f} m")
    plt.plot(times[posed], poses[:, 1], ".-", label=name)
plt.plot(times[posed], truth[:, 1], label="truth")
plt.gca().set(xlabel="time (s)", ylabel="y, to port (m)")
plt.legend()
plt.savefig(picture)
