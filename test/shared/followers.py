"""A leader and a follower in closed loop, and the errors of the poses between them."""

import contextlib
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from tracks import correlated

from uuv_optical_array.control.formation import FormationController
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.vehicles.leader_path import leader_twist
from uuv_optical_array.control.vehicles.vehicle import Vehicle, start_behind
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier
from uuv_optical_array.estimation.tracking.tracker import Tracker

SETTINGS = FormationSettings(station_m=(-6.0, 0.0, 0.0))
STATION = np.array([*SETTINGS.station_m, 0.0, 0.0])
TICK_S = 0.05
SLEW = SETTINGS.max_acceleration_m_per_s2 * TICK_S  # from a command to the next, m/s
# Limits of a command, linear and angular, and of its change in 1 s.
FASTEST = np.array(
    [
        SETTINGS.max_surge_m_per_s,
        *[SETTINGS.max_sway_m_per_s] * 2,
        0.0,
        *np.radians([SETTINGS.max_turn_deg_per_s] * 2),
    ]
)
HARDEST = np.array(
    [
        *[SETTINGS.max_acceleration_m_per_s2] * 3,
        0.0,
        *np.radians([SETTINGS.max_acceleration_deg_per_s2] * 2),
    ]
)
GRID = np.array([0.33, 0.1, 0.1, np.radians(3.3), np.radians(3.3)])


# What an estimator by SAM would publish on the scene `follow`.
PUBLISHED = correlated([0.35, 0.25, 0.25, *np.radians([7, 7])])
STILL = np.zeros(5)


def command_at(controller, now):
    """Return the command, linear and angular."""
    command = controller.command(now)
    assert command is not None
    return np.concatenate(command)


def under_way(**changes):
    """Return a controller that surges, and the stamp of its last pose."""
    controller = FormationController(replace(SETTINGS, **changes))
    for tick in range(40):
        pose = off_station([-1.0, 0.1, -0.1, 0.05, 0.05])
        controller.update(tick * 0.1, pose, PUBLISHED, STILL)
        command = command_at(controller, tick * 0.1)
    assert command[0] > 0.3
    return controller, tick * 0.1


def exact(pose):
    return pose


def sam_noise(seed):
    """Return the errors of a match on the follow scene: y against yaw, z with pitch, on a grid."""
    rng = np.random.default_rng(seed)
    spread = np.linalg.cholesky(correlated([0.30, 0.21, 0.21, *np.radians([5.4, 5.4])]))

    def measure(pose):
        noisy = pose + spread @ rng.standard_normal(5)
        return np.rint(noisy / GRID) * GRID

    return measure


def off_station(error):
    return np.add(STATION, error)


def relative(leader, follower):
    """Return the pose of the follower in the leader's frame, by SciPy's rotations."""
    to_world = Rotation.from_euler("ZYX", [leader.yaw, leader.pitch, 0])
    own = Rotation.from_euler("ZYX", [follower.yaw, follower.pitch, 0])
    yaw, pitch, _ = (to_world.inv() * own).as_euler("ZYX")
    return np.array([*to_world.inv().apply(follower.position - leader.position), pitch, yaw])


class TrackedLaw:
    """The formation law behind the tracker that is told its commands, as nodes have them."""

    def __init__(self, settings):
        self._tracker, self._law = Tracker(TrackerSettings()), FormationController(settings)

    def update(self, now, pose, covariance, _=None):
        """Take a pose without its rate."""
        with contextlib.suppress(Outlier):
            track = self._tracker.update(round(now * 1e9), pose, covariance)
            self._law.update(now, track.pose, track.covariance, track.rate)

    def command(self, now):
        command = self._law.command(now)
        if command is not None:
            linear, angular = command
            self._tracker.command(round(now * 1e9), [*linear, *angular[1:]])
        return command


def follow(
    seconds,
    measure=exact,
    twist=leader_twist,
    offset=(-0.5, -0.2, 0.0),
    published=PUBLISHED,
    latency_ticks=1,
    settings=None,
    tracked=False,
    start=None,
):
    """Run both vehicles; poses come at 10 Hz, late, and commands at 20 Hz.

    Rates are true, or a tracker's. The follower is of the leader's kind in its sea, or of that of a
    vehicle at the leader's start. Returns the true errors of the pose and the commands (linear,
    angular), a row a tick.
    """
    leader = Vehicle(np.zeros(3))
    settings = settings or SETTINGS
    follower = start_behind(start or leader, settings.station_m, offset)
    controller = TrackedLaw(settings) if tracked else FormationController(settings)
    errors, commands, images = [], [], []
    before = relative(leader, follower)
    for tick in range(round(seconds / TICK_S)):
        now = tick * TICK_S
        pose = relative(leader, follower)
        images.append((now, measure(pose) if tick % 2 == 0 else None, (pose - before) / TICK_S))
        before = pose
        if tick >= latency_ticks:
            stamp, seen, rate = images[tick - latency_ticks]
            if seen is not None:
                controller.update(stamp, seen, published, rate)
        linear, angular = controller.command(now) or (np.zeros(3), np.zeros(3))
        errors.append(pose - [*settings.station_m, 0, 0])
        commands.append([*linear, *angular])
        leader.step(*twist(now), TICK_S)
        follower.step(linear, angular, TICK_S)
    return np.array(errors), np.array(commands)


def steady(linear, angular):
    return lambda _: (np.array(linear), np.array(angular))
