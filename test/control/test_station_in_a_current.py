"""Station behind a lamp that holds its place over ground, by a follower that a current carries."""

import numpy as np
import pytest
from followers import SETTINGS, TrackedLaw

from uuv_optical_array.control.bluerov2 import BlueRov2
from uuv_optical_array.control.formation import FormationSettings
from uuv_optical_array.control.sea import Sea
from uuv_optical_array.control.vehicles import Vehicle, start_behind
from uuv_optical_array.core.geometry import relative_pose

STD = np.array([0.1, 0.05, 0.05, np.radians(1.0), np.radians(1.0)])  # of the poses
TICK_S = 0.1
KINDS = pytest.mark.parametrize("kind", [Vehicle, BlueRov2])


def formation(settings):
    """Return the formation law; its turns are sent along with its velocity."""
    law = TrackedLaw(settings)

    def command(now, pose):
        if pose is not None:
            law.update(now, pose, np.diag(STD**2))
        answer = law.command(now)
        return np.zeros(6) if answer is None else np.concatenate(answer)

    return command


def hold(kind, law, current, seconds, x_m=-6.0, dark_after_s=np.inf):
    """Return the true poses and the commands, a row a tick; the follower starts on station.

    A law takes the present and a pose, or None, and returns the twist that it wants.
    """
    rng, leader = np.random.default_rng(1), Vehicle(np.zeros(3))
    follower = start_behind(kind(np.zeros(3)), (x_m, 0, 0), (0, 0, 0))
    poses, commands = [], []
    for now in TICK_S * np.arange(round(seconds / TICK_S)):
        pose, _ = relative_pose(
            leader.position, leader.rotation, follower.position, follower.rotation
        )
        noisy = pose + STD * rng.standard_normal(5)
        twist = law(now, noisy if now < dark_after_s else None)
        follower.sea = Sea(current(now))
        follower.step(twist[:3], twist[3:], TICK_S)
        poses.append(pose)
        commands.append(twist)
    return np.array(poses), np.array(commands)


STATION = np.array([-6.0, 0.0, 0.0])


@KINDS
def test_a_current_leaves_no_bias(kind):
    flow = (-0.3, 0.2, -0.1)
    poses, commands = hold(kind, formation(SETTINGS), lambda _: np.array(flow), 45)
    last = poses[-300:, :3] - STATION
    assert np.linalg.norm(last.mean(axis=0)) < 0.05
    assert np.linalg.norm(last, axis=1).mean() < 0.05
    # What it swims through the water is what the water flows.
    assert commands[-300:, :3].mean(axis=0) == pytest.approx(np.negative(flow), abs=0.02)


@KINDS
def test_pressed_towards_the_lamp_it_keeps_the_minimum_distance(kind):
    settings = FormationSettings((-1.5, 0.0, 0.0), min_distance_m=2.0)  # a station out of reach
    poses, commands = hold(kind, formation(settings), lambda _: np.array([0.3, 0, 0]), 30, -4.0)
    assert np.linalg.norm(poses[:, :3], axis=1).min() > settings.min_distance_m
    assert np.linalg.norm(poses[-1, :3]) < 3.0
    assert np.isfinite(commands).all()


@KINDS
def test_without_light_it_stops_in_the_water_and_drifts(kind):
    settings, flow = SETTINGS, np.array([-0.3, 0.1, 0.0])
    stopped_s = 12 + settings.light_timeout_s + settings.stop_time_s + 2 * TICK_S
    poses, commands = hold(kind, formation(settings), lambda _: flow, 26, dark_after_s=12)
    times = TICK_S * np.arange(len(commands))
    assert np.abs(commands[times < 12, 0]).max() > 0.25
    assert (commands[times > stopped_s] == 0).all()
    assert (poses[-1, :3] - poses[-21, :3]) / 2.0 == pytest.approx(flow, abs=0.03)
