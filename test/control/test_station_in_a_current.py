"""Station behind a lamp that holds its place over ground, by a follower that a current carries."""

import numpy as np
import pytest
from followers import SETTINGS, TrackedLaw, relative

from uuv_optical_array.control.bluerov2 import BlueRov2
from uuv_optical_array.control.sea import Sea
from uuv_optical_array.control.vehicles import Vehicle, start_behind

STD = np.array([0.1, 0.05, 0.05, np.radians(1.0), np.radians(1.0)])  # of the poses
TICK_S, STATION = 0.1, np.array(SETTINGS.station_m)
KINDS = pytest.mark.parametrize("kind", [Vehicle, BlueRov2])


def hold(kind, flow, seconds, dark_after_s=np.inf):
    """Return the true poses and the commands, a row a tick; the follower starts on station."""
    rng, leader, law = np.random.default_rng(1), Vehicle(np.zeros(3)), TrackedLaw(SETTINGS)
    follower = start_behind(kind(np.zeros(3), sea=Sea(flow)), STATION, (0, 0, 0))
    poses, commands = [], []
    for now in TICK_S * np.arange(round(seconds / TICK_S)):
        pose = relative(leader, follower)
        noisy = pose + STD * rng.standard_normal(5)
        if now < dark_after_s:
            law.update(now, noisy, np.diag(STD**2))
        twist = law.command(now) or (np.zeros(3), np.zeros(3))
        follower.step(*twist, TICK_S)
        poses.append(pose)
        commands.append(np.concatenate(twist))
    return np.array(poses), np.array(commands)


@KINDS
def test_a_current_leaves_no_bias(kind):
    flow = (-0.3, 0.2, -0.1)
    poses, commands = hold(kind, flow, 45)
    last = poses[-300:, :3] - STATION
    assert np.linalg.norm(last.mean(axis=0)) < 0.05
    assert np.linalg.norm(last, axis=1).mean() < 0.05
    # What it swims through the water is what the water flows.
    assert commands[-300:, :3].mean(axis=0) == pytest.approx(np.negative(flow), abs=0.02)


@KINDS
def test_without_light_it_stops_in_the_water_and_drifts(kind):
    flow = np.array([-0.3, 0.1, 0.0])
    stopped_s = 12 + SETTINGS.light_timeout_s + SETTINGS.stop_time_s + 2 * TICK_S
    poses, commands = hold(kind, flow, 26, dark_after_s=12)
    times = TICK_S * np.arange(len(commands))
    assert np.abs(commands[times < 12, 0]).max() > 0.25
    assert (commands[times > stopped_s] == 0).all()
    assert (poses[-1, :3] - poses[-21, :3]) / 2.0 == pytest.approx(flow, abs=0.03)
