import contextlib

import numpy as np
import pytest
from followers import PUBLISHED, STATION, TICK_S, covariance, follow, off_station, sam_noise, steady
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tracks import Textbook

from uuv_optical_array.control.formation import (
    LEADER_STD,
    LEADER_WALK,
    OWN_WALK,
    FormationController,
    FormationSettings,
)
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import check_all
from uuv_optical_array.estimation.tracking.track import Outlier


def after_half_a_second(pose: Array) -> tuple[Array, Array]:
    """Return the first sizeable command at a pose."""
    controller = FormationController(FormationSettings())
    controller.update(0.0, pose, PUBLISHED)
    for tick in range(11):
        command = controller.command(tick * TICK_S)
    assert command is not None
    return command


@pytest.mark.parametrize(
    ("error", "entry", "sign"),
    [
        pytest.param([-1, 0, 0, 0, 0], 0, +1, id="too far behind: surge ahead"),
        pytest.param([1, 0, 0, 0, 0], 0, -1, id="too near: surge astern"),
        pytest.param([0, 0.3, 0, 0, 0], 1, -1, id="to port: sway to starboard"),
        pytest.param([0, -0.3, 0, 0, 0], 1, +1, id="to starboard: sway to port"),
        pytest.param([0, 0, 0.3, 0, 0], 2, -1, id="above: heave down"),
        pytest.param([0, 0, -0.3, 0, 0], 2, +1, id="below: heave up"),
        pytest.param([0, 0, 0, 0.2, 0], 4, -1, id="bow low: raise it"),
        pytest.param([0, 0, 0, -0.2, 0], 4, +1, id="bow high: lower it"),
        pytest.param([0, 0, 0, 0, 0.2], 5, -1, id="bow to port: turn to starboard"),
        pytest.param([0, 0, 0, 0, -0.2], 5, +1, id="bow to starboard: turn to port"),
    ],
)
def test_each_error_is_answered_on_its_own_axis(error: list[float], entry: int, sign: int) -> None:
    twist = np.concatenate(after_half_a_second(off_station(error)))
    assert sign * twist[entry] > 0.01
    assert np.delete(twist, entry) == pytest.approx(np.zeros(5), abs=1e-12)


def test_on_station_behind_a_leader_at_rest_nothing_is_commanded() -> None:
    assert np.concatenate(after_half_a_second(STATION)) == pytest.approx(np.zeros(6), abs=1e-12)


def test_velocity_is_commanded_in_the_frame_of_the_follower() -> None:
    pose = off_station([-0.3, 0, 0, 0.25, -0.3])
    linear, _ = after_half_a_second(pose)
    in_beacon = Rotation.from_euler("ZYX", [-0.3, 0.25, 0]).apply(linear)
    # It has turned a little by then, whence the tolerance.
    assert in_beacon / np.linalg.norm(linear) == pytest.approx([1, 0, 0], abs=0.05)


@pytest.mark.parametrize("speed", [0.5, -0.2])
def test_steady_speed_of_the_leader_leaves_no_lag(speed: float) -> None:
    errors, commands = follow(40, twist=steady([speed, 0, 0], [0, 0, 0]))
    assert np.abs(errors[-200:]).max() < 1e-3
    assert commands[-1] == pytest.approx([speed, 0, 0, 0, 0, 0], abs=1e-3)


def test_drift_of_the_leader_leaves_no_lag() -> None:
    errors, _ = follow(50, twist=steady([0.4, 0.1, -0.1], [0, 0, 0]))
    assert np.abs(errors[-200:]).max() < 1e-3


def test_steady_turn_of_the_leader_leaves_no_lag() -> None:
    rate = 0.05
    errors, commands = follow(70, twist=steady([0.5, 0, 0], [0, 0, rate]))
    assert np.abs(errors[-200:]).max() < 1e-3
    # Six metres astern of the leader, the station is swung outward.
    assert commands[-1] == pytest.approx([0.5, -6 * rate, 0, 0, 0, rate], abs=1e-3)


def test_pitching_of_the_leader_carries_the_station_up() -> None:
    def bow_down(now: float) -> tuple[Array, Array]:
        return np.zeros(3), np.array([0, 0.03 if now > 1 else 0.0, 0])

    _, commands = follow(15, twist=bow_down, offset=(0, 0, 0))
    assert commands[-1] == pytest.approx([0, 0, 0.18, 0, 0.03, 0], abs=0.02)


@pytest.mark.parametrize("seed", range(2))
def test_follow_of_the_path_with_noisy_poses(seed: int) -> None:
    errors, commands = follow(120, sam_noise(seed))
    errors[:, 3:] = np.degrees(errors[:, 3:])
    # The start, half a metre off behind a leader that speeds up, stays in the light.
    assert (np.abs(errors).max(axis=0) < [1.4, 0.5, 0.5, 9, 9]).all()
    settled = errors[400:]
    assert (np.sqrt((settled**2).mean(axis=0)) < [0.15, 0.2, 0.2, 3, 3]).all()
    assert (np.abs(settled).max(axis=0) < [0.45, 0.5, 0.5, 9, 9]).all()
    acceleration = np.diff(commands[400:], axis=0) / TICK_S
    assert (acceleration[:, :3].std(axis=0) < 0.12).all()
    assert (np.degrees(acceleration[:, 4:]).std(axis=0) < 1.5).all()


def test_known_correlation_of_the_errors_steadies_the_follow() -> None:
    def lateral_rms(correlation: float) -> float:
        published = covariance(correlation)
        runs = [follow(30, sam_noise(seed), published=published)[0] for seed in range(2)]
        return float(np.sqrt(np.mean([run[:, 1:3] ** 2 for run in runs])))

    assert lateral_rms(0.97) < 0.9 * lateral_rms(0.0)


@pytest.mark.parametrize("latency_ticks", [0, 6])
def test_late_poses_are_brought_up_to_date(latency_ticks: int) -> None:
    errors, _ = follow(80, sam_noise(0), latency_ticks=latency_ticks)
    assert (np.abs(errors[400:, :3]).max(axis=0) < 0.6).all()


def test_late_poses_cause_little_overshoot() -> None:
    at_rest = steady([0, 0, 0], [0, 0, 0])
    errors, _ = follow(20, twist=at_rest, offset=(-1.0, 0, 0), latency_ticks=6)
    # It would be 0.09 m, were the command not for the pose expected by now.
    assert errors[:, 0].max() < 0.05
    assert errors[-1] == pytest.approx(np.zeros(5), abs=3e-3)


def test_a_leader_too_fast_to_follow_winds_nothing_up() -> None:
    def dash(now: float) -> tuple[Array, Array]:
        return np.array([1.4 if now < 15 else 0.5, 0, 0]), np.zeros(3)

    errors, commands = follow(60, twist=dash)
    assert errors[:, 0].min() < -5
    assert commands[:, 0].max() == pytest.approx(1.0)
    # It comes back without running past the station.
    assert errors[:, 0].max() < 0.2
    assert np.abs(errors[-1]).max() < 0.01


def test_nothing_is_commanded_before_the_first_pose() -> None:
    controller = FormationController(FormationSettings())
    assert controller.command(0.0) is None
    assert controller.command(100.0) is None
    controller.update(100.0, STATION, PUBLISHED)
    assert controller.command(100.05) is not None


def under_way() -> tuple[FormationController, float, Array]:
    """Return a controller that surges, the stamp of its last pose, and its last command."""
    controller = FormationController(FormationSettings(light_timeout_s=1.0, stop_time_s=4.0))
    for tick in range(40):
        stamp = tick * 0.1
        controller.update(stamp, off_station([-1.0, 0.1, -0.1, 0.05, 0.05]), PUBLISHED)
        controller.command(stamp)
    command = controller.command(stamp + 1.0)
    assert command is not None
    assert command[0][0] > 0.4
    return controller, stamp, np.concatenate(command)


def command_at(controller: FormationController, now: float) -> Array:
    command = controller.command(now)
    assert command is not None
    return np.concatenate(command)


def test_lost_light_is_a_straight_ramp_to_a_stop() -> None:
    controller, stamp, cruise = under_way()
    for dark in (0.4, 1.0, 2.0, 3.0, 3.9):
        command = command_at(controller, stamp + 1.0 + dark)
        assert command == pytest.approx(cruise * (1 - dark / 4.0), abs=1e-9)
    for dark in (4.0 + 1e-9, 4.05, 60.0):
        assert (command_at(controller, stamp + 1.0 + dark) == 0).all()


def test_light_shorter_than_the_timeout_is_not_lost() -> None:
    controller, stamp, cruise = under_way()
    controller.update(stamp + 0.95, STATION, PUBLISHED)
    assert command_at(controller, stamp + 1.05)[0] > 0.8 * cruise[0]


@pytest.mark.parametrize("dark", [1.0, 3.0, 10.0])
def test_follow_resumes_from_the_present_command_and_remembers_nothing(dark: float) -> None:
    controller, stamp, cruise = under_way()
    now = stamp + 1.0 + dark
    slowed = command_at(controller, now)
    for tick in range(1, 200):
        if tick % 2:
            controller.update(now + tick * TICK_S, STATION, PUBLISHED)
        command = command_at(controller, now + tick * TICK_S)
        assert np.abs(command - slowed)[:3].max() <= 0.2 * TICK_S + 1e-9
        slowed = command
    # Poses that stay on station while it moves mean a leader that moves along.
    assert np.abs(command).max() <= np.abs(cruise).max()
    if dark >= 4.0:
        assert command == pytest.approx(np.zeros(6), abs=1e-9)


@pytest.mark.parametrize(("dark", "stamp_later"), [(2.0, 0.9), (19.0, 18.0)])
def test_a_stale_pose_does_not_bring_the_old_speed_back(dark: float, stamp_later: float) -> None:
    controller, stamp, cruise = under_way()
    slowed = command_at(controller, stamp + 1.0 + dark)
    assert slowed == pytest.approx(cruise * max(0.0, 1 - dark / 4))
    controller.update(stamp + stamp_later, off_station([-1.0, 0, 0, 0, 0]), PUBLISHED)
    assert (np.abs(command_at(controller, stamp + 1.05 + dark)) <= np.abs(slowed)).all()


def test_poses_of_a_clock_that_is_set_back_are_taken_at_once() -> None:
    controller, _, cruise = under_way()
    controller.update(-100.0, STATION, PUBLISHED)
    assert command_at(controller, -100.0) == pytest.approx(cruise)
    assert command_at(controller, -99.0)[0] < cruise[0]


def test_clock_that_is_set_back_in_the_dark_does_not_bring_the_old_speed_back() -> None:
    controller, stamp, cruise = under_way()
    slowed = command_at(controller, stamp + 1.0 + 2.0)
    assert slowed == pytest.approx(0.5 * cruise, abs=1e-9)
    for back in (0.5, 0.95):
        assert command_at(controller, stamp + back) == pytest.approx(slowed, abs=1e-12)
    for dark in (0.5, 2.0, 4.0):
        command = command_at(controller, stamp + 1.0 + dark)
        assert command == pytest.approx(slowed * (1 - dark / 4.0), abs=1e-9)


@pytest.mark.parametrize("gap", [1.001, 60.0])
def test_a_pose_after_a_gap_begins_anew_though_no_command_came_between(gap: float) -> None:
    controller, stamp, _ = under_way()
    controller.update(stamp + gap, off_station([9.0, 0, 0, 0, 0]), PUBLISHED)
    with pytest.raises(Outlier):
        controller.update(stamp + gap + 0.1, STATION, PUBLISHED)


def test_clock_that_is_set_back_stops_the_follower_and_then_starts_anew() -> None:
    controller, _, _ = under_way()
    assert (command_at(controller, -100.0) == 0).all()
    controller.update(-99.9, off_station([-1.0, 0, 0, 0, 0]), PUBLISHED)
    for tick in range(10):
        command = command_at(controller, -99.9 + tick * TICK_S)
    assert 0 < command[0] < 0.2


def test_a_command_is_the_callers_to_change() -> None:
    controller, stamp, cruise = under_way()
    for part in controller.command(stamp + 1.0) or ():
        part[:] = 99.0
    assert command_at(controller, stamp + 1.0) == pytest.approx(cruise)


def test_an_outlier_is_told_and_steers_nothing() -> None:
    controller, stamp, _ = under_way()
    without, _, _ = under_way()
    for later in (0.5, 0.6):
        with pytest.raises(Outlier, match=r"^outlier: .* standard deviations off, more than 5\.07"):
            controller.update(stamp + later, off_station([4.0, 0, 0, 0, 0]), PUBLISHED)
    # It has been taken all the same, so its stamp is not to come again.
    with pytest.raises(ValueError, match=rf"is not after {stamp + 0.6:.3f} s"):
        controller.update(stamp + 0.6, STATION, PUBLISHED)
    for now in (stamp + 1.0, stamp + 1.2, stamp + 3.0):
        assert command_at(controller, now) == pytest.approx(command_at(without, now), abs=1e-12)


def test_outliers_that_agree_are_the_leader() -> None:
    controller, refused = FormationController(FormationSettings()), []
    for tick in range(70):
        now, error = tick * 0.1, -1.0 if tick < 30 else 4.0
        try:
            controller.update(now, off_station([error, 0, 0, 0, 0]), PUBLISHED)
        except Outlier:
            refused.append(tick)
        surge = command_at(controller, now)[0]
        assert surge >= 0 or tick >= 34
    assert refused == [30, 31, 32, 33]
    assert surge < 0


def test_a_gate_of_one_takes_every_pose() -> None:
    controller = FormationController(FormationSettings(gate_probability=1.0))
    for tick in range(10):
        controller.update(0.1 * tick, off_station([4.0 * (tick % 2), 0, 0, 0, 0]), PUBLISHED)


@pytest.mark.parametrize("back", [0.0, 0.05, 0.9])
def test_stamps_that_do_not_advance_are_refused(back: float) -> None:
    controller, stamp, cruise = under_way()
    with pytest.raises(ValueError, match=rf"stamp {stamp - back:.3f} s is not after {stamp:.3f} s"):
        controller.update(stamp - back, STATION, PUBLISHED)
    assert command_at(controller, stamp + 1.0) == pytest.approx(cruise)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_by_name_and_changes_nothing(value: float) -> None:
    controller, stamp, cruise = under_way()
    for entry, name in enumerate(("stamp", "x", "y", "z", "pitch", "yaw")):
        row = np.array([stamp + 0.1, *STATION])
        row[entry] = value
        with pytest.raises(ValueError, match=f"pose: {name} is {value:g}"):
            controller.update(row[0], row[1:], PUBLISHED)
    assert command_at(controller, stamp + 1.0) == pytest.approx(cruise)


@pytest.mark.parametrize("pose", [[-6.0, 0, 0], [[-6.0, 0, 0, 0, 0]], 1.0])
def test_pose_of_another_shape_is_refused(pose: object) -> None:
    with pytest.raises(ValueError, match=r"give \(x, y, z, pitch, yaw\)"):
        FormationController(FormationSettings()).update(0.0, pose, PUBLISHED)  # type: ignore[arg-type]


def test_a_pause_between_commands_allows_no_leap() -> None:
    controller = FormationController(FormationSettings())
    controller.update(0.0, off_station([-3.0, 0, 0, 0, 0]), PUBLISHED)
    command_at(controller, 0.0)
    for tick in range(1, 101):
        controller.update(0.1 * tick, off_station([-3.0, 0, 0, 0, 0]), PUBLISHED)
    # For the light's timeout of 1 s, not for the 10 s of the pause.
    assert command_at(controller, 10.0)[0] == pytest.approx(0.2 * 1.0)


@given(
    poses=st.lists(
        st.tuples(
            st.floats(-20, 20),
            *[st.floats(-10, 10)] * 2,
            *[st.floats(-1.5, 1.5)] * 2,
            st.floats(0.01, 2.0),
        ),
        min_size=1,
        max_size=40,
    )
)
def test_speed_and_acceleration_stay_within_their_limits(poses: list[tuple[float, ...]]) -> None:
    # A minimum distance is kept however hard that brakes.
    controller = FormationController(FormationSettings(min_distance_m=0.0))
    now, before = 0.0, np.zeros(6)
    fastest = np.array([1.0, 0.6, 0.6, 0, *np.radians([10, 10])])
    hardest = np.array([0.2, 0.2, 0.2, 0, *np.radians([3, 3])])
    hardest = np.maximum(hardest, fastest / 3.0)  # the stop when all poses are refused
    for *pose, step in poses:
        now += step
        with contextlib.suppress(Outlier):
            controller.update(now, pose, PUBLISHED)
        command = command_at(controller, now)
        assert (np.abs(command) <= fastest + 1e-12).all()
        assert (np.abs(command - before) <= hardest * step + 1e-9).all()
        before = command


@pytest.mark.parametrize("station_m", [(-6.0, 0.0, 0.0), (-3.0, 1.5, -0.7)])
def test_each_command_is_that_of_a_textbook_filter_and_the_law(
    station_m: tuple[float, float, float],
) -> None:
    # No two alike that could stand for each other.
    s = FormationSettings(
        station_m=station_m,
        min_distance_m=0.0,
        position_gain_per_s=0.5,
        attitude_gain_per_s=0.3,
        smoothing_s=0.6,
        gate_probability=1.0,
    )
    rng, spread = np.random.default_rng(6), np.linalg.cholesky(PUBLISHED)
    # The station is carried by the leader's turns: v + w x r, a column for each turn.
    station = np.array([*station_m, 0, 0])
    carry = np.eye(5)
    carry[:3, 3] = np.cross([0, 1, 0], station[:3])
    carry[:3, 4] = np.cross([0, 0, 1], station[:3])
    start, walk = (carry @ np.diag(std**2) @ carry.T for std in (LEADER_STD, LEADER_WALK))
    controller, commands, rate, filtered = FormationController(s), [], np.zeros(5), None
    turns = np.radians([s.max_turn_deg_per_s] * 2 + [s.max_acceleration_deg_per_s2] * 2)
    fastest = np.array([s.max_surge_m_per_s, *[s.max_sway_m_per_s] * 2, *turns[:2]])
    hardest = np.array([*[s.max_acceleration_m_per_s2] * 3, *turns[2:]])
    gains = np.array([s.position_gain_per_s] * 3 + [s.attitude_gain_per_s] * 2)
    now = before = 0
    while now < 10e9:
        now += int(rng.uniform(20e6, 150e6))
        stamp = now - 40_000_000
        pose = station + [0.8, -0.4, 0.3, 0.15, -0.2] + spread @ rng.standard_normal(5)
        if rng.random() < 0.7 and (filtered is None or stamp > filtered.stamp):
            controller.update(stamp * 1e-9, pose, PUBLISHED)
            if filtered is None:
                frame = (stamp, pose, PUBLISHED)
                filtered = Textbook(frame, start, walk, np.diag(OWN_WALK**2), commands)
            else:
                filtered.take(stamp, pose, PUBLISHED)
        if filtered is None:
            continue
        mean, _ = filtered.ahead(now)
        wanted = -mean[5:] + gains * (station - mean[:5])
        wanted[:3] = Rotation.from_euler("ZYX", [mean[4], mean[3], 0]).inv().apply(wanted[:3])
        wanted = np.clip(wanted, -fastest, fastest)
        elapsed = (now - before) * 1e-9 if before else 0.0
        change = (wanted - rate) * min(elapsed / s.smoothing_s, 1.0)
        rate = rate + np.clip(change, -hardest * elapsed, hardest * elapsed)
        command = command_at(controller, now * 1e-9)
        assert command == pytest.approx([*rate[:3], 0, *rate[3:]], rel=1e-7, abs=1e-9)
        commands.append((now, rate))
        before = now
    assert (np.abs([rate for _, rate in commands]).max(axis=0) > 0.03).all()


def test_a_new_station_keeps_what_was_learnt_of_the_leader() -> None:
    controller = FormationController(FormationSettings())
    # A pose that stays while the follower moves means a leader that moves along.
    for tick in range(300):
        controller.update(tick * 0.1, off_station([-0.5, 0, 0, 0, 0]), PUBLISHED)
        before = command_at(controller, tick * 0.1)
    assert before[0] == pytest.approx(1.0)
    controller.configure(
        FormationSettings(station_m=(-6.5, 0.0, 0.0), max_acceleration_m_per_s2=5.0)
    )
    controller.update(30.0, off_station([-0.5, 0, 0, 0, 0]), PUBLISHED)
    # On station now, it goes on with the leader.
    for tick in range(20):
        command = command_at(controller, 30.0 + 0.01 * tick)
        assert command[0] == pytest.approx(1.0, abs=0.05)


def test_a_pose_of_the_near_future_is_taken_for_the_present() -> None:
    ahead, present = (
        FormationController(FormationSettings()),
        FormationController(FormationSettings()),
    )
    ahead.update(0.3, off_station([-1.0, 0.2, 0, 0, 0]), PUBLISHED)
    present.update(0.0, off_station([-1.0, 0.2, 0, 0, 0]), PUBLISHED)
    for now in (0.0, 0.05):
        # Nothing has moved up to the first command.
        assert command_at(ahead, now) == pytest.approx(command_at(present, now), abs=1e-12)


@pytest.mark.parametrize("now", [np.nan, np.inf])
def test_a_present_that_is_not_finite_is_refused(now: float) -> None:
    controller, stamp, cruise = under_way()
    with pytest.raises(ValueError, match=rf"now_s is {now:g}, not finite"):
        controller.command(now)
    assert command_at(controller, stamp + 1.0) == pytest.approx(cruise)


def test_declared_defaults_pass_their_own_checks() -> None:
    checked = check_all(FormationSettings, vars(FormationSettings()), "formation")
    assert FormationSettings(**checked) == FormationSettings()


@pytest.mark.parametrize("x", [6.0, 0.0, -0.4, np.nan])
def test_a_station_that_is_not_behind_the_lamp_is_refused(x: float) -> None:
    with pytest.raises(ValueError, match=r"station_m: .* is not behind the lamp; .* -0\.5 m"):
        FormationSettings(station_m=(x, 0.0, 0.0))


@pytest.mark.parametrize("place", [[-6.0, 0.0], [-6.0, 0.0, 51.0], -6.0])
def test_a_station_that_is_no_place_in_bounds_is_refused(place: object) -> None:
    with pytest.raises(ValueError, match=r"formation\.station_m"):
        check_all(FormationSettings, {"station_m": place}, "formation")
