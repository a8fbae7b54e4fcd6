"""Nothing broken steers: no number that is none, no stray, no stream of strays, nothing stale."""

import contextlib

import numpy as np
import pytest
from followers import PUBLISHED, SETTINGS, STATION, STILL, command_at, off_station, under_way
from hypothesis import given, settings
from hypothesis import strategies as st

from uuv_optical_array.control.formation import FormationController
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.tracking.track import Outlier

FASTEST = np.array([1.0, 0.6, 0.6, 0.0, *np.radians([10, 10])])


number = st.one_of(
    st.floats(), st.sampled_from([1e308, -1e308, 1e6, 1e-308, 0.0, -6.0, np.inf, np.nan])
)


@given(
    st.lists(
        st.tuples(
            st.floats(-0.2, 0.5),
            st.lists(number, min_size=5, max_size=5),
            number,
            st.lists(number, min_size=5, max_size=5),
        ),
        min_size=1,
        max_size=15,
    )
)
@settings(max_examples=60)
@pytest.mark.filterwarnings("error")
def test_no_numbers_whatever_make_a_command_that_is_none(frames):
    controller, now = FormationController(SETTINGS), 0.0
    controller.update(now, STATION, PUBLISHED, STILL)
    for step, pose, scale, rate in frames:
        now += step
        with contextlib.suppress(ValueError, NoPose), np.errstate(all="ignore"):
            controller.update(now, pose, PUBLISHED * scale, rate)
        command = command_at(controller, now)
        assert np.isfinite(command).all()
        assert (np.abs(command) <= FASTEST + 1e-12).all()
    for tick in range(1, 60):
        with contextlib.suppress(ValueError, NoPose):
            pose = off_station([-1, 0, 0, 0, 0])
            controller.update(now + 0.1 * tick, pose, PUBLISHED, STILL)
        command = command_at(controller, now + 0.1 * tick)
    # Good poses steer again.
    assert command[0] > 0.05


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e7])
def test_what_is_not_finite_or_too_large_is_refused_by_name(value):
    (controller, now), (without, _) = under_way(), under_way()
    for entry, name in enumerate(("stamp", "x", "y", "z", "pitch", "yaw")):
        row = np.array([now + 0.1, *STATION])
        row[entry] = value * 1e3
        with pytest.raises(ValueError, match=f"pose: {name} is "):
            controller.update(row[0], row[1:], PUBLISHED, STILL)
    for entry in range(5):
        rate = np.zeros(5)
        rate[entry] = value
        with pytest.raises(ValueError, match=r"rate: .*; give three within \+-10 m/s and two"):
            controller.update(now + 0.1, STATION, PUBLISHED, rate)
    with pytest.raises(ValueError, match="now_s is "):
        controller.command(value * 1e3)
    assert command_at(controller, now + 1.0) == pytest.approx(command_at(without, now + 1.0))


@pytest.mark.parametrize("wrong", [[-6.0, 0, 0], [[-6.0, 0, 0, 0, 0]], 1.0])
def test_pose_and_rate_of_another_shape_are_refused(wrong):
    controller = FormationController(SETTINGS)
    with pytest.raises(ValueError, match=r"give \(x, y, z, pitch, yaw\)"):
        controller.update(0.0, wrong, PUBLISHED, STILL)
    with pytest.raises(ValueError, match="rate: "):
        controller.update(0.0, STATION, PUBLISHED, wrong)


@pytest.mark.parametrize("back", [0.0, 0.05, 0.9])
def test_stamps_that_do_not_advance_are_refused(back):
    (controller, now), (without, _) = under_way(), under_way()
    with pytest.raises(ValueError, match=rf"stamp {now - back:.3f} s is not after {now:.3f} s"):
        controller.update(now - back, STATION, PUBLISHED, STILL)
    assert command_at(controller, now + 1.0) == pytest.approx(command_at(without, now + 1.0))


def test_an_outlier_is_reported_and_steers_nothing():
    (controller, now), (without, _) = under_way(), under_way()
    far = off_station([4.0, 0, 0, 0, 0])
    for later in (0.5, 0.6):
        with pytest.raises(Outlier, match=r"^outlier: .* standard deviations off, more than 5\.07"):
            controller.update(now + later, far, PUBLISHED, STILL)
    # It has been taken all the same, so its stamp is not to come again.
    with pytest.raises(ValueError, match=rf"is not after {now + 0.6:.3f} s"):
        controller.update(now + 0.6, STATION, PUBLISHED, STILL)
    for later in (1.0, 1.2, 3.0):
        expected = command_at(without, now + later)
        assert command_at(controller, now + later) == pytest.approx(expected, abs=1e-12)


def test_outliers_that_agree_are_the_leader():
    controller, refused = FormationController(SETTINGS), []
    for tick in range(70):
        now, error = tick * 0.1, -1.0 if tick < 30 else 4.0
        try:
            controller.update(now, off_station([error, 0, 0, 0, 0]), PUBLISHED, STILL)
        except Outlier:
            refused.append(tick)
        surge = command_at(controller, now)[0]
        assert surge >= 0 or tick >= 34
    assert refused == [30, 31, 32, 33]
    assert surge < 0


@pytest.mark.parametrize("gap", [1.001, 60.0])
def test_a_pose_after_a_gap_begins_anew_though_no_command_came_between(gap):
    controller, now = under_way()
    controller.update(now + gap, off_station([9.0, 0, 0, 0, 0]), PUBLISHED, STILL)
    with pytest.raises(Outlier):
        controller.update(now + gap + 0.1, STATION, PUBLISHED, STILL)


def test_what_happens_between_two_poses_of_a_gap_is_no_outlier():
    # Within 0.9 s a leader at 0.5 m/s stops; both poses are known to a centimetre.
    controller, exact = FormationController(SETTINGS), np.eye(5) * 1e-4
    controller.update(0.0, STATION, exact, [-0.5, 0, 0, 0, 0])
    controller.update(0.9, off_station([-0.2, 0, 0, 0, 0]), exact, STILL)
    # What the pose before may err by counts, too.
    unsure = FormationController(SETTINGS)
    unsure.update(0.0, STATION, PUBLISHED, STILL)
    unsure.update(0.1, off_station([-0.5, 0, 0, 0, 0]), exact, STILL)


def strays(count):
    """Return poses of which no two agree."""
    rng = np.random.default_rng(4)
    return np.array([-40.0, 0, 0, 0, 0]) + rng.uniform(-30, 30, (count, 5)) * [1, 1, 1, 0, 0]


def test_after_refusals_it_stands_until_five_poses_agree():
    controller, now = under_way()
    refused = 0
    for stray in strays(60):
        now += 0.1
        try:
            controller.update(now, stray, PUBLISHED / 100, STILL)
        except Outlier:
            refused += 1
        command = command_at(controller, now)
    assert refused > 50
    # Timeout and stop time are over: it stands, and the next stray does not change that.
    assert (command == 0).all()
    now += 2.0  # the last stray is long ago
    moved = []
    for _ in range(10):
        now += 0.1
        with contextlib.suppress(Outlier):
            controller.update(now, off_station([-1.0, 0, 0, 0, 0]), PUBLISHED, STILL)
        command_at(controller, now)
        moved.append(bool(command_at(controller, now + 0.05).any()))
    assert moved == [False] * 4 + [True] * 6


def test_a_near_pose_in_the_dark_stops_the_follower_at_once():
    controller, now = under_way()
    for tick in range(1, 12):  # two directions in turns agree with nothing
        stray = off_station([-20.0, 15.0 * (-1) ** tick, 0, 0, 0])
        with contextlib.suppress(Outlier):
            controller.update(now + 0.1 * tick, stray, PUBLISHED / 100, STILL)
        before = command_at(controller, now + 0.1 * tick)
    assert before[0] > 0.1  # on its way to a stop
    with contextlib.suppress(Outlier):
        controller.update(now + 1.2, [-1.0, 0, 0, 0, 0], PUBLISHED / 100, STILL)
    assert (command_at(controller, now + 1.2)[:3] == 0).all()


def test_a_pose_of_which_next_to_nothing_is_known_steers_nothing():
    controller, now = under_way()
    s = SETTINGS
    range_m = float(np.linalg.norm(STATION[:3]))
    almost, whole = (np.diag([*[(std * range_m / 3) ** 2] * 3, 0.1, 0.1]) for std in (0.99, 1.01))
    controller.update(now + 0.1, STATION, almost, STILL)
    moving = np.linalg.norm(command_at(controller, now + 0.1))
    for tick in range(2, 12 + round(10 * (s.light_timeout_s + s.stop_time_s))):
        with pytest.raises(NoPose, match="too uncertain: the range of"):
            controller.update(now + 0.1 * tick, STATION, whole, STILL)
        command = command_at(controller, now + 0.1 * tick)
    assert moving > 0
    np.testing.assert_array_equal(command, 0.0)
