"""Track a follower that swings across, and plot it.

Run: python3 track.py [SCENE] [PICTURE]
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

from uuv_optical_array import Estimator, ForwardModel, Tracker, load_scene
from uuv_optical_array.estimation.tracking.settings import TrackerSettings

scene, picture = load_scene([*sys.argv[1:], "follow"][0]), [*sys.argv[2:], "track.png"][0]
model, rng, estimator = ForwardModel(scene), np.random.default_rng(seed=1), Estimator(scene)
tracker, times = Tracker(TrackerSettings()), np.arange(0, 6, 0.1)  # s
truth = np.tile([-6.0, 0, 0, 0, 0], (len(times), 1))  # x, y, z in m, pitch and yaw in rad
truth[:, 1] = 0.5 * np.sin(2 * np.pi * times / 6)
frames, track = np.empty_like(truth), np.empty_like(truth)
for i, time in enumerate(times):
    estimate = estimator.estimate(model.expose(truth[i], rng, time_s=time))
    frames[i] = estimate.pose
    track[i] = tracker.update(round(time * 1e9), estimate.pose, estimate.covariance).pose
for name, found in (("frames", frames), ("track", track)):
    print(f"{name}: RMS error of y {np.sqrt(np.mean((found - truth)[:, 1] ** 2)):.3f} m")
    plt.plot(times, found[:, 1], ".-", label=name)
plt.plot(times, truth[:, 1], "k", label="truth")
plt.gca().set(xlabel="time (s)", ylabel="y, to port (m)")
plt.legend()
plt.savefig(picture)
