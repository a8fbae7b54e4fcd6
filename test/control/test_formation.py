"""The formation law: its signs, its closed loops, lost light, and the law written a second time."""

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from followers import (
    FASTEST,
    HARDEST,
    PUBLISHED,
    SETTINGS,
    SLEW,
    STATION,
    STILL,
    TICK_S,
    command_at,
    follow,
    off_station,
    sam_noise,
    steady,
    under_way,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from tracks import turned

from uuv_optical_array.control.formation import FormationController
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.steering import CRAB_GAIN, CRAB_RAD
from uuv_optical_array.control.vehicles.bluerov2 import BlueRov2
from uuv_optical_array.control.vehicles.sea import Sea
from uuv_optical_array.control.vehicles.vehicle import Vehicle
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.settings import check_all


@pytest.mark.parametrize(
    ("linear", "turn", "command"),
    [
        ([0.5, 0, 0], 0.0, [0.5, 0, 0, 0, 0, 0]),
        ([-0.2, 0, 0], 0.0, [-0.2, 0, 0, 0, 0, 0]),
        ([0.4, 0.1, -0.1], 0.0, [0.4, 0.1, -0.1, 0, 0, 0]),
        # Six metres astern of a leader that turns, the station is swung outward.
        ([0.5, 0, 0], 0.05, [0.5, -0.3, 0, 0, 0, 0.05]),
    ],
)
def test_steady_motion_of_the_leader_leaves_no_lag(linear, turn, command):
    errors, commands = follow(25, twist=steady(linear, [0, 0, turn]), tracked=True)
    assert np.abs(errors[-100:]).max() < 1e-3
    assert commands[-1] == pytest.approx(command, abs=1e-3)


def test_follow_of_the_path_with_late_noisy_poses():
    errors, commands = follow(120, sam_noise(0), latency_ticks=6, tracked=True)
    errors[:, 3:] = np.degrees(errors[:, 3:])
    # The start, half a metre off behind a leader that speeds up, stays in the light. Each bound is
    # five standard deviations, of other noise, above the mean.
    assert (np.abs(errors).max(axis=0) < [1.4, 0.5, 0.5, 12.5, 11]).all()
    settled = errors[400:]
    assert (np.sqrt((settled**2).mean(axis=0)) < [0.16, 0.14, 0.14, 3.8, 3.8]).all()
    assert (np.abs(settled).max(axis=0) < [0.55, 0.43, 0.43, 12.5, 11]).all()
    acceleration = np.diff(commands[400:], axis=0) / TICK_S
    # A leader's turns swing the station, so that noise of pitch and yaw is in sway and heave.
    assert (acceleration[:, :3].std(axis=0) < [0.19, 0.28, 0.28]).all()
    assert (np.degrees(acceleration[:, 4:]).std(axis=0) < 4.0).all()


@pytest.mark.parametrize("kind", [Vehicle, BlueRov2])
def test_a_current_leaves_no_bias(kind):
    """The lamp holds its place over ground, and the follower is carried along."""
    rng, flow = np.random.default_rng(1), (-0.3, 0.2, -0.1)
    std = np.array([0.1, 0.05, 0.05, *np.radians([1.0, 1.0])])
    errors, commands = follow(
        25,
        lambda pose: pose + std * rng.standard_normal(5),
        steady([0, 0, 0], [0, 0, 0]),
        (0, 0, 0),
        np.diag(std**2),
        tracked=True,
        start=kind(np.zeros(3), sea=Sea(flow)),
    )
    errors, commands = errors[-300:, :3], commands[-300:, :3]
    assert np.linalg.norm(errors.mean(axis=0)) < 0.05
    assert np.linalg.norm(errors, axis=1).mean() < 0.05
    # What it swims through the water is what the water flows.
    assert commands.mean(axis=0) == pytest.approx(np.negative(flow), abs=0.02)


def test_a_leader_too_fast_to_follow_winds_nothing_up():
    def dash(now):
        return np.array([1.4 if now < 12 else 0.5, 0, 0]), np.zeros(3)

    slow = replace(SETTINGS, max_surge_m_per_s=1.0)
    errors, commands = follow(40, twist=dash, settings=slow, tracked=True)
    assert errors[:, 0].min() < -5
    assert commands[:, 0].max() == pytest.approx(1.0)
    # It comes back without running past the station.
    assert errors[:, 0].max() < 0.2
    assert np.abs(errors[-1]).max() < 0.01


def test_the_bow_points_at_the_lamp_where_it_is_told_to():
    s = replace(SETTINGS, station_m=(-4.0, 2.0, -0.5), bow_to_lamp=True)
    errors, _ = follow(20, twist=steady([0.3, 0, 0], [0, 0, 0]), settings=s)
    # Ahead of the follower are 4 m, -2 m and 0.5 m; up is a negative pitch.
    bow = [-np.arctan2(0.5, np.hypot(4, 2)), np.arctan2(-2, 4)]
    assert errors[-1] == pytest.approx([0, 0, 0, *bow], abs=1e-3)


def test_lost_light_is_a_straight_ramp_to_a_stop():
    controller, stamp = under_way(light_timeout_s=1.0, stop_time_s=4.0)
    cruise = command_at(controller, stamp + 1.0)
    for dark in (0.4, 1.0, 2.0, 3.0, 3.9):
        command = command_at(controller, stamp + 1.0 + dark)
        assert command == pytest.approx(cruise * (1 - dark / 4.0), abs=1e-9)
    for part in controller.command(stamp + 3.0) or ():
        part[:] = 99.0  # the caller's own
    for dark in (4.0 + 1e-9, 4.05, 60.0):
        assert (command_at(controller, stamp + 1.0 + dark) == 0).all()


@pytest.mark.parametrize("dark", [1.0, 3.0, 10.0])
def test_follow_resumes_from_the_present_command_and_remembers_nothing(dark):
    controller, stamp = under_way(light_timeout_s=1.0, stop_time_s=4.0)
    command_at(controller, stamp + 1.0)
    now = stamp + 1.0 + dark
    slowed = command_at(controller, now)
    for tick in range(1, 200):
        # A leader at rest, of which the follower holds its place as it is commanded to.
        rate = np.delete(slowed, 3)
        if tick % 2:
            controller.update(now + tick * TICK_S, STATION, PUBLISHED, rate)
        command = command_at(controller, now + tick * TICK_S)
        assert np.abs(command - slowed)[:3].max() <= SLEW + 1e-9
        slowed = command
    assert command == pytest.approx(np.zeros(6), abs=1e-3)


@pytest.mark.parametrize(("dark", "stamp_later"), [(2.0, 0.9), (19.0, 18.0)])
def test_a_stale_pose_does_not_bring_the_old_speed_back(dark, stamp_later):
    controller, stamp = under_way(light_timeout_s=1.0, stop_time_s=4.0)
    cruise = command_at(controller, stamp + 1.0)
    slowed = command_at(controller, stamp + 1.0 + dark)
    assert slowed == pytest.approx(cruise * max(0.0, 1 - dark / 4))
    stale = off_station([-1.0, 0, 0, 0, 0])
    controller.update(stamp + stamp_later, stale, PUBLISHED, STILL)
    assert (np.abs(command_at(controller, stamp + 1.05 + dark)) <= np.abs(slowed)).all()


def test_clock_that_is_set_back_in_the_dark_does_not_bring_the_old_speed_back():
    controller, stamp = under_way(light_timeout_s=1.0, stop_time_s=4.0)
    cruise = command_at(controller, stamp + 1.0)
    slowed = command_at(controller, stamp + 1.0 + 2.0)
    assert slowed == pytest.approx(0.5 * cruise, abs=1e-9)
    for back in (0.5, 0.95):
        assert command_at(controller, stamp + back) == pytest.approx(slowed, abs=1e-12)
    for dark in (0.5, 2.0, 4.0):
        command = command_at(controller, stamp + 1.0 + dark)
        assert command == pytest.approx(slowed * (1 - dark / 4.0), abs=1e-9)


def test_clock_that_is_set_back_stops_the_follower_and_then_starts_anew():
    controller, stamp = under_way()
    command_at(controller, stamp + 1.0)
    assert (command_at(controller, -100.0) == 0).all()
    controller.update(-99.9, off_station([-1.0, 0, 0, 0, 0]), PUBLISHED, STILL)
    for tick in range(10):
        command = command_at(controller, -99.9 + tick * TICK_S)
    # From rest, by the first 0.1 s and nine ticks of smoothing to what 1 m off is worth at most.
    left = (1 - 0.1 / SETTINGS.smoothing_s) * (1 - TICK_S / SETTINGS.smoothing_s) ** 9
    assert 0 < command[0] <= SETTINGS.position_gain_per_s * (1 - left)


def test_a_pause_between_commands_allows_no_leap():
    controller = FormationController(SETTINGS)
    for tick in range(101):
        controller.update(0.1 * tick, off_station([-3.0, 0, 0, 0, 0]), PUBLISHED, STILL)
        if tick == 0:
            command_at(controller, 0.0)
    # For the light's timeout of 1 s, not for the 10 s of the pause.
    assert command_at(controller, 10.0)[0] == pytest.approx(HARDEST[0] * 1.0)


number = st.floats(-10, 10)
angle = st.floats(-1.5, 1.5)


@given(
    st.lists(
        st.tuples(
            st.tuples(st.floats(-20, 20), number, number, angle, angle),
            st.tuples(number, number, number, angle, angle),
            st.floats(0.01, 2.0),
        ),
        min_size=1,
        max_size=40,
    )
)
@settings(max_examples=40)
def test_speed_and_acceleration_stay_within_their_limits(frames):
    # A minimum distance is kept however hard that brakes, and so is the time to a stop in the dark,
    # where poses are refused: it is what the limit takes from the fastest.
    limited = replace(SETTINGS, min_distance_m=0.0, stop_time_s=float(FASTEST[0] / HARDEST[0]))
    controller, now, before = FormationController(limited), 0.0, np.zeros(6)
    controller.update(now, STATION, PUBLISHED, STILL)
    for pose, rate, step in frames:
        now += step
        with suppress(NoPose):  # at the lamp, or out of reach
            controller.update(now, pose, PUBLISHED, rate)
        command = command_at(controller, now)
        assert (np.abs(command) <= FASTEST + 1e-12).all()
        assert (np.abs(command - before) <= HARDEST * step + 1e-9).all()
        before = command


def crab(velocity, most, lamp):
    """Return the least turn of a vehicle after which a velocity takes no more sway than it has.

    The bow stays within `CRAB_RAD` of the lamp, or of where it is to point, if that is farther off.
    """
    way, speed = math.atan2(velocity[1], velocity[0]), math.hypot(*velocity)

    def beyond(turn):
        return speed * abs(math.sin(way - turn)) - most

    bound = max(lamp + CRAB_RAD, 0.0) if way > 0 else min(lamp - CRAB_RAD, 0.0)
    if beyond(0.0) <= 0:
        return 0.0
    across = way - math.copysign(math.pi / 2, way)  # at which all of it is sway
    turn = brentq(beyond, across, way, xtol=1e-14)
    turn = min(turn, bound, key=abs)
    return turn if beyond(turn) < beyond(0.0) else 0.0


@pytest.mark.parametrize(
    ("station_m", "ahead", "drift"),
    [
        ((-6.0, 0.0, 0.0), 0.0, 0.0),
        ((-3.0, 1.5, -0.7), 0.0, 0.0),
        ((-6.0, 0.0, 0.0), 0.65, 1.3),
        ((-3.0, 1.5, -0.7), 0.3, 1.6),
    ],
)
def test_each_command_is_that_of_the_law_written_a_second_time(station_m, ahead, drift):
    # No two alike that could stand for each other.
    s = FormationSettings(
        station_m=station_m,
        min_distance_m=0.0,
        position_gain_per_s=0.5,
        attitude_gain_per_s=0.3,
        smoothing_s=0.6,
    )
    rng, spread = np.random.default_rng(6), np.linalg.cholesky(PUBLISHED)
    station = np.array([*station_m, 0, 0])
    turns = np.radians([s.max_turn_deg_per_s] * 2 + [s.max_acceleration_deg_per_s2] * 2)
    fastest = np.array([s.max_surge_m_per_s, *[s.max_sway_m_per_s] * 2, *turns[:2]])
    hardest = np.array([*[s.max_acceleration_m_per_s2] * 3, *turns[2:]])
    gains = np.array([s.position_gain_per_s] * 3 + [s.attitude_gain_per_s] * 2)
    controller, commands, command = FormationController(s), [(0, np.zeros(5))], np.zeros(5)
    now, newest, crabs = 0, None, []

    def commanded(stamp):
        return next(twist for since, twist in reversed(commands) if since <= stamp)

    while now < 10e9:
        before, now = now, now + 1_000_000 * int(rng.integers(20, 150))
        if rng.random() < 0.7 and now > 40_000_000:
            stamp = now - 40_000_000
            pose = station + [0.8, -0.4, 0.3, 0.15, -0.2] + 0.5 * spread @ rng.standard_normal(5)
            rate = rng.standard_normal(5) * [0.3, 0.2, 0.2, 0.1, 0.1]
            rate[:2] += -ahead, drift * rng.choice([-1, 1])
            if newest is None or stamp > newest[0]:
                controller.update(stamp * 1e-9, pose, PUBLISHED, rate)
                newest = stamp, pose, rate - turned(pose, commanded(stamp))
        if newest is None:
            continue
        stamp, pose, leader = newest
        # By milliseconds, of which all stamps are whole numbers.
        own = sum(commanded(ms * 1_000_000) for ms in range(stamp // 1_000_000, now // 1_000_000))
        present = pose + (now - stamp) * 1e-9 * leader + turned(pose, 1e-3 * own)
        wanted = gains * (station - present) - leader
        to_body = Rotation.from_euler("ZYX", [present[4], present[3], 0]).inv()
        wanted[:3] = to_body.apply(wanted[:3])
        level = Rotation.from_euler("z", present[4])
        to_lamp = to_body.apply(-present[:3])
        lamp_x, lamp_y, _ = level.apply([*to_lamp[:2], 0.0])
        crabs.append(
            crab(
                level.apply([*wanted[:2], 0.0])[:2],
                s.max_sway_m_per_s,
                math.atan2(lamp_y, lamp_x),
            )
        )
        if crabs[-1]:
            wanted[4] += (CRAB_GAIN - 1) * s.attitude_gain_per_s * (station[4] - present[4])
            wanted[4] += CRAB_GAIN * s.attitude_gain_per_s * crabs[-1]
        wanted = np.clip(wanted, -fastest, fastest)
        elapsed = (now - before) * 1e-9 if len(commands) > 1 else 0.0
        change = (wanted - command) * min(elapsed / s.smoothing_s, 1.0)
        command = command + np.clip(change, -hardest * elapsed, hardest * elapsed)
        answer = command_at(controller, now * 1e-9)
        assert answer == pytest.approx([*command[:3], 0, *command[3:]], rel=1e-7, abs=1e-9)
        commands.append((now, command))
    assert (np.abs([twist for _, twist in commands]).max(axis=0) > 0.03).all()
    assert (np.count_nonzero(crabs) > 20) == (drift > 0)


def test_a_new_station_keeps_what_is_known_of_the_leader():
    controller, leader = FormationController(SETTINGS), np.array([-0.6, 0, 0, 0, 0])
    command = np.zeros(6)
    for tick in range(200):
        if tick == 100:
            controller.configure(FormationSettings(station_m=(-6.5, 0.0, 0.0)))
        rate = leader + np.delete(command, 3)
        off = -0.5 * (tick >= 100)
        controller.update(tick * 0.1, off_station([off, 0, 0, 0, 0]), PUBLISHED, rate)
        command = command_at(controller, tick * 0.1)
        if tick > 60:
            assert command[0] == pytest.approx(0.6, abs=1e-3)


def test_a_pose_of_the_near_future_is_taken_for_the_present():
    ahead, present = FormationController(SETTINGS), FormationController(SETTINGS)
    ahead.update(0.3, off_station([-1.0, 0.2, 0, 0, 0]), PUBLISHED, STILL)
    present.update(0.0, off_station([-1.0, 0.2, 0, 0, 0]), PUBLISHED, STILL)
    for now in (0.0, 0.05):
        # Nothing has moved up to the first command.
        assert command_at(ahead, now) == pytest.approx(command_at(present, now), abs=1e-12)


@pytest.mark.parametrize("x", [6.0, 0.0, -0.4, np.nan])
def test_a_station_that_is_not_behind_the_lamp_is_refused(x):
    with pytest.raises(ValueError, match=r"station_m: .* is not behind the lamp; .* -0\.5 m"):
        FormationSettings(station_m=(x, 0.0, 0.0))


@pytest.mark.parametrize("place", [[-6.0, 0.0], [-6.0, 0.0, 51.0], -6.0])
def test_a_station_that_is_no_place_in_bounds_is_refused(place):
    with pytest.raises(ValueError, match=r"formation\.station_m"):
        check_all(FormationSettings, {"station_m": place}, "formation")
