"""Station behind a lamp that holds its place over ground, by a follower that a current carries."""

import numpy as np
import pytest
from followers import SETTINGS, TrackedLaw, relative

from uuv_optical_array.control.bluerov2 import BlueRov2
from uuv_optical_array.control.sea import Sea
from uuv_optical_array.control.vehicles import Vehicle, start_behind

STD = np.array([0.1, 0.05, 0.05, np.radians(1.0), np.radians(1.0)])  # of the poses
TICK_S, STATION = 0.1, np.array(SETTINGS.station_m)


@pytest.mark.parametrize("kind", [Vehicle, BlueRov2])
def test_a_current_leaves_no_bias(kind):
    rng, leader, law = np.random.default_rng(1), Vehicle(np.zeros(3)), TrackedLaw(SETTINGS)
    flow = (-0.3, 0.2, -0.1)
    follower = start_behind(kind(np.zeros(3), sea=Sea(flow)), STATION, (0, 0, 0))
    off, commands = [], []
    for now in TICK_S * np.arange(450):
        pose = relative(leader, follower)
        law.update(now, pose + STD * rng.standard_normal(5), np.diag(STD**2))
        twist = law.command(now) or (np.zeros(3), np.zeros(3))
        follower.step(*twist, TICK_S)
        off.append(pose[:3] - STATION)
        commands.append(twist[0])
    assert np.linalg.norm(np.mean(off[-300:], axis=0)) < 0.05
    assert np.linalg.norm(off[-300:], axis=1).mean() < 0.05
    # What it swims through the water is what the water flows.
    assert np.mean(commands[-300:], axis=0) == pytest.approx(np.negative(flow), abs=0.02)
