"""The follower keeps its minimum distance to the lamp whatever it is told within its bounds."""

import numpy as np
import pytest
from followers import PUBLISHED, SLEW, TICK_S, command_at, follow, steady, under_way
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.formation import FormationController
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.steering import Aim, KeepOff
from uuv_optical_array.control.vehicles.leader_path import leader_twist
from uuv_optical_array.core.errors import NoPose

MARGIN_M = 3 * np.sqrt(PUBLISHED[0, 0])  # dead astern, three standard deviations of the range


def biased(metres):
    """Return a measurement of a lamp that seems farther than it is."""
    return lambda pose: pose - [metres, 0, 0, 0, 0]


def nearest(errors, s):
    return float(np.linalg.norm(errors[:, :3] + s.station_m, axis=1).min())


def stops(now):
    return np.array([0.5 if now < 20 else 0.0, 0, 0]), np.zeros(3)


STILL = steady([0, 0, 0], [0, 0, 0])


@pytest.mark.parametrize(
    ("least_m", "twist"), [(2.5, stops), (2.5, leader_twist), (2.5, STILL), (0.0, stops)]
)
def test_a_range_biased_by_what_it_says_does_not_bring_the_follower_too_near(least_m, twist):
    s = FormationSettings(station_m=(-3.2, 0.0, 0.0), min_distance_m=least_m)
    # The station as it is measured lies within the minimum, and is reached without one.
    errors, _ = follow(30, biased(1.0), twist, settings=s)
    assert (nearest(errors, s) > 2.5) == (least_m > 0) == (nearest(errors, s) > 2.0)


EXACT = PUBLISHED * 1e-4  # as exact as it may be, and so as near as it may go


def surge(controller, now):
    return float(command_at(controller, now)[0])


def along(x):
    return np.array([x, 0, 0, 0, 0])


@pytest.mark.parametrize("lit_s", [4.0, 7.0, 10.0, 13.0])
def test_light_that_goes_out_on_the_way_to_a_leader_at_rest_leaves_the_distance(lit_s):
    s = FormationSettings(station_m=(-3.5, 0.0, 0.0), min_distance_m=3.0, stop_time_s=6.0)
    controller = FormationController(s)
    x, speed = -12.0, 0.0
    for tick in range(round(30 / TICK_S)):
        now = tick * TICK_S
        if now < lit_s:
            controller.update(now, along(x), EXACT, along(speed))
        speed = surge(controller, now)
        x += speed * TICK_S
    assert -x > 3.0
    assert speed == 0


def test_a_vehicle_that_brakes_no_harder_than_it_may_stops_in_time():
    s = FormationSettings(
        station_m=(-1.0, 0.0, 0.0),
        min_distance_m=3.0,
        light_timeout_s=0.3,
        stop_time_s=0.3,
        smoothing_s=0.1,
        max_acceleration_m_per_s2=0.2,
    )
    controller, x, speed, fastest = FormationController(s), -12.0, 0.0, 0.0
    step = s.max_acceleration_m_per_s2 * TICK_S
    for tick in range(round(30 / TICK_S)):
        controller.update(tick * TICK_S, along(x), EXACT, along(speed))
        speed += float(np.clip(surge(controller, tick * TICK_S) - speed, -step, step))
        x += speed * TICK_S
        fastest = max(fastest, speed)
    assert fastest > 0.9
    assert 2.95 < -x < 3.1


@pytest.mark.parametrize("leader_comes", [0.0, 0.1, 0.3])
def test_the_speed_of_a_leader_that_comes_nearer_is_part_of_the_approach(leader_comes):
    # At 4 m, 2 m outside of the minimum, where light that is lost leaves 1 s + 3 s / 2 of way.
    settings = FormationSettings(station_m=(-0.5, 0.0, 0.0), min_distance_m=2.0)
    controller, own = FormationController(settings), 0.0
    for now in np.arange(20) * 1.1:  # farther apart than the timeout: each begins anew
        controller.update(now, along(-4.0), PUBLISHED * 1e-8, along(own + leader_comes))
        own = surge(controller, now)
    assert own + leader_comes == pytest.approx(2.0 / 2.5, abs=0.01)


@given(st.lists(st.tuples(st.floats(-8, -0.3), st.floats(0.01, 2.0)), min_size=1, max_size=20))
@settings(max_examples=30)
def test_below_the_minimum_no_command_closes_in(frames):
    controller, now = under_way()
    for x, std in frames:
        now += 0.1
        nearest_m = -x - 3 * std
        try:
            controller.update(now, along(x), np.eye(5) * std**2, np.zeros(5))
        except NoPose:
            assert -x > FormationSettings().min_distance_m
            continue
        if nearest_m < FormationSettings().min_distance_m:
            assert surge(controller, now) <= 1e-12


def test_after_a_near_pose_no_prediction_lets_it_close_in():
    controller, now = under_way()
    controller.update(now + 0.1, along(-1.9), EXACT, along(-5.0))  # a leader that runs away
    assert surge(controller, now + 0.9) <= 1e-12


@given(st.floats(0, 2 * np.pi), st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4)))
@settings(max_examples=30)
def test_nor_does_a_sideways_one_but_it_backs_off(round_beam, turned):
    # The station is nearer to the lamp than this place beside the beam, whose range is 4 m.
    place = np.array([-3.0, *np.sqrt(7) * np.array([np.cos(round_beam), np.sin(round_beam)])])
    to_beacon = Rotation.from_euler("ZYX", [turned[1], turned[0], 0.0])
    for min_distance_m, sign in ((3.5, 1), (0.0, -1)):
        s = FormationSettings(station_m=(-3.0, 0.0, 0.0), min_distance_m=min_distance_m)
        controller = FormationController(s)
        for tick in range(10):
            controller.update(tick * 0.1, [*place, *turned], np.eye(5) * 0.4**2, np.zeros(5))
            command = command_at(controller, tick * 0.1)
        assert sign * to_beacon.apply(command[:3]) @ place / 4.0 > 0.02


@pytest.mark.parametrize("nearest_m", [2.5, -8.0])
@given(
    st.tuples(st.floats(0.2, 1.4), st.floats(-1, 1), st.floats(-1, 1)),
    st.floats(0, 2 * np.pi),
    st.floats(-0.5, 0.5),
)
@example((1.0, -1.0, 0.0), 2e-10, 0.0)
def test_of_all_that_keep_the_distance_the_velocity_is_the_nearest_to_that_wanted(
    nearest_m, wanted, way, up
):
    """As near as what a solver of quadratic problems finds; what leads past the lamp is kept whole.

    The nearest velocity within a box and a plane is unique: one that keeps to both and is as near
    is the same. Much too near, where the gain asks for more than the vehicle has, it is as fast as
    it gets straight away from the lamp, and no faster.
    """
    away = np.array([np.cos(way) * np.cos(up), np.sin(way) * np.cos(up), np.sin(up)])
    most = np.array([1.4, 1.0, 1.0])
    s = FormationSettings(min_distance_m=2.0, max_acceleration_m_per_s2=5.0)  # no limit here
    controller = FormationController(s)
    lamp = KeepOff(s.room_m(nearest_m), away)
    aim = Aim(np.zeros(5), np.array([*wanted, 0.0, 0.0]), np.eye(3), [lamp])
    controller.drive(0.0, aim)
    kept, _ = controller.drive(1.0, aim)
    allowed = 0.5 / (s.light_timeout_s + s.stop_time_s / 2)
    if nearest_m < s.min_distance_m:
        allowed = -np.min(most / np.maximum(np.abs(away), 1e-9))
    best = minimize(
        lambda velocity: np.square(velocity - wanted).sum(),
        np.clip(max(0.5, -allowed) * away, -most, most),
        jac=lambda velocity: 2 * (velocity - wanted),
        bounds=list(zip(-most, most, strict=True)),
        constraints={
            "type": "ineq",
            "fun": lambda velocity: allowed + away @ velocity,
            "jac": lambda _: away,
        },
        method="SLSQP",
        options={"ftol": 1e-12},
    )
    assert best.success
    assert (np.abs(kept) <= most).all()
    assert away @ kept >= -allowed - 1e-9
    assert np.square(kept - wanted).sum() <= best.fun + 1e-10


def test_too_near_it_backs_off_until_it_is_not():
    s = FormationSettings(station_m=(-4.0, 0.0, 0.0), min_distance_m=3.0)
    errors, commands = follow(
        20,
        twist=STILL,
        offset=(2.5, 0, 0),
        published=PUBLISHED / 100,
        settings=s,
    )
    assert nearest(errors[:1], s) == pytest.approx(1.5)
    assert commands[10:40, 0].max() < -0.05
    assert nearest(errors[-1:], s) > 3.0
    # Backing off gains speed as any motion does.
    assert np.abs(np.diff(commands[:, 0])).max() <= SLEW + 1e-9


def test_a_station_within_the_minimum_is_not_reached():
    s = FormationSettings(station_m=(-1.5, 0.0, 0.0), min_distance_m=3.0)
    errors, _ = follow(20, twist=STILL, offset=(-4, 0, 0), published=PUBLISHED, settings=s)
    assert 0 < nearest(errors, s) - MARGIN_M - 3.0 < 0.1
