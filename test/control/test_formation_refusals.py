"""Nothing broken steers: no number that is none, no stray, nothing stale; without else it stops."""

import contextlib

import numpy as np
import pytest
from followers import (
    FASTEST,
    PUBLISHED,
    SETTINGS,
    STATION,
    STILL,
    command_at,
    off_station,
    under_way,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from uuv_optical_array.control.formation import (
    MOST_UNCERTAIN,
    RANGE_STDS,
    STRAY_M,
    STRAY_M_PER_S,
    FormationController,
)
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.tracking.track import Outlier

number = st.one_of(
    st.floats(), st.sampled_from([1e308, -1e308, 1e6, 1e-308, 0.0, -6.0, np.inf, np.nan])
)
five = st.lists(number, min_size=5, max_size=5)


@given(st.lists(st.tuples(st.floats(-0.2, 0.5), five, number, five), min_size=1, max_size=15))
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
            controller.update(now + 0.1 * tick, off_station([-1, 0, 0, 0, 0]), PUBLISHED, STILL)
        command = command_at(controller, now + 0.1 * tick)
    # Good poses steer again.
    assert command[0] > 0.05


def with_entry(row, entry, value):
    return np.where(np.arange(5) == entry, value, row)


def unsure(stds):
    """Return a covariance whose range has the station's distance in so many deviations."""
    return np.diag([*[(np.linalg.norm(STATION) / stds) ** 2] * 3, 0.1, 0.1])


KNOWN = RANGE_STDS / MOST_UNCERTAIN  # deviations in a range that is just known
WRONG_SHAPES = ([-6.0, 0, 0], [[-6.0, 0, 0, 0, 0]], 1.0)
REFUSED = [
    *(({"stamp_s": bad}, "pose: stamp is ") for bad in (np.nan, np.inf, -np.inf, 1e10)),
    *(
        ({"pose": with_entry(STATION, i, bad)}, f"pose: {name} is ")
        for i, name in enumerate(("x", "y", "z", "pitch", "yaw"))
        for bad in (np.nan, np.inf, -np.inf, 1e10)
    ),
    *(
        ({"rate": with_entry(STILL, i, bad)}, r"rate: .*; give three within \+-10 m/s and two")
        for i in range(5)
        for bad in (np.nan, np.inf, -np.inf, 1e7)
    ),
    *(({"pose": wrong}, r"give \(x, y, z, pitch, yaw\)") for wrong in WRONG_SHAPES),
    *(({"rate": wrong}, "rate: ") for wrong in WRONG_SHAPES),
    *(({"stamp_s": 3.9 - back}, f"stamp {3.9 - back:.3f} s is not after") for back in (0, 0.9)),
    ({"covariance": -PUBLISHED}, "covariance: its eigenvalues are "),
    (
        {"covariance": unsure(0.99 * KNOWN)},
        f"too uncertain: the range of 6 m has a standard deviation of {6 / 0.99 / KNOWN:.3g} m",
    ),
]


@pytest.mark.parametrize(("wrong", "words"), REFUSED)
def test_what_is_refused_is_named_and_steers_nothing_and_alone_it_stops_the_follower(wrong, words):
    (controller, now), (without, _) = under_way(), under_way()
    good = {"pose": STATION, "covariance": PUBLISHED, "rate": STILL}
    for tick in range(1, 60):
        at = now + 0.1 * tick
        with pytest.raises((ValueError, NoPose), match=words):
            controller.update(**{"stamp_s": at, **good, **wrong})
        command = command_at(controller, at)
        np.testing.assert_array_equal(command, command_at(without, at))
        assert command.any() or tick >= 40  # the light's timeout of 1 s, and 3 s to stop
    assert not command.any()


@pytest.mark.parametrize("now_s", [np.nan, np.inf, -np.inf, 1e10])
def test_a_present_that_is_none_is_refused(now_s):
    with pytest.raises(ValueError, match="now_s is "):
        under_way()[0].command(now_s)


def test_a_range_that_is_just_known_steers():
    controller, now = under_way()
    controller.update(now + 0.1, STATION, unsure(1.01 * KNOWN), STILL)


def test_strays_steer_nothing_and_while_there_is_light_none_of_them_is_taken():
    (controller, now), (without, _), rng = under_way(), under_way(), np.random.default_rng(4)
    for tick in range(1, 11):  # the light's timeout of 1 s
        stray = off_station([-20.0, (-1) ** tick * rng.uniform(7.5, 15), 0, 0, 0])
        with pytest.raises(Outlier, match=r"outlier: .* m beyond the reach of the pose before"):
            controller.update(now + 0.1 * tick, stray, PUBLISHED / 100, STILL)
        at = now + 0.1 * tick
        np.testing.assert_array_equal(command_at(controller, at), command_at(without, at))


@pytest.mark.parametrize("gap", [1.001, 60.0])
def test_a_pose_after_a_gap_begins_anew_though_no_command_came_between(gap):
    controller, now = under_way()
    controller.update(now + gap, off_station([9.0, 0, 0, 0, 0]), PUBLISHED, STILL)


@pytest.mark.parametrize(
    ("rate", "swept_m"),
    [
        (STILL, 0.0),
        ([-0.6, 0.2, 0, 0, 0], 0.0),
        # A leader that turns may end its turn: 12 m astern that is 12 m times the angle.
        ([0, 0, 0, 0.03, 0.04], 0.05 * 12 * 0.5),
    ],
)
@pytest.mark.parametrize("beyond", [-0.01, 0.01])
def test_what_a_leader_can_reach_within_the_errors_is_no_outlier(rate, swept_m, beyond):
    """From where its motion leads in 0.5 s: what it strays, and three deviations of the errors."""
    # 0.3 and 0.4 m along x, less across.
    before, after = np.diag([0.09, 0.01, 0.01, 0.01, 0.01]), np.diag([0.16, 0.01, 0.01, 0.01, 0.01])
    reach = RANGE_STDS * 0.5 + STRAY_M + 0.5 * STRAY_M_PER_S + swept_m
    controller = FormationController(SETTINGS)
    controller.update(0.0, [-12.0, 0, 0, 0, 0], before, rate)
    pose = np.add([-12.0, 0, 0, 0, 0], 0.5 * np.array(rate)) - along(reach + beyond)
    with pytest.raises(Outlier) if beyond > 0 else contextlib.nullcontext():
        controller.update(0.5, pose, after, STILL)


def along(x):
    return np.array([x, 0, 0, 0, 0])
