"""No broken, stray or stale pose steers; without a good one the follower stops."""

import contextlib
import functools

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

from uuv_optical_array.control.formation import MOST_UNCERTAIN, RANGE_STDS, FormationController
from uuv_optical_array.core.errors import NoPose

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
    for tick in range(1, 21):
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


@functools.cache
def commands_in_the_dark():
    controller, now = under_way()
    return [command_at(controller, now + 0.1 * tick) for tick in range(1, 60)]


@pytest.mark.parametrize(("wrong", "words"), REFUSED)
def test_what_is_refused_is_named_and_steers_nothing_and_alone_it_stops_the_follower(wrong, words):
    controller, now = under_way()
    good = {"pose": STATION, "covariance": PUBLISHED, "rate": STILL}
    for tick, expected in enumerate(commands_in_the_dark(), start=1):
        at = now + 0.1 * tick
        with pytest.raises((ValueError, NoPose), match=words):
            controller.update(**{"stamp_s": at, **good, **wrong})
        command = command_at(controller, at)
        np.testing.assert_array_equal(command, expected)
        assert command.any() or tick >= 40  # the light's timeout of 1 s, and 3 s to stop
    assert not command.any()


@pytest.mark.parametrize("now_s", [np.nan, np.inf, -np.inf, 1e10])
def test_a_present_that_is_none_is_refused(now_s):
    with pytest.raises(ValueError, match="now_s is "):
        under_way()[0].command(now_s)


def test_a_range_that_is_just_known_steers():
    controller, now = under_way()
    controller.update(now + 0.1, STATION, unsure(1.01 * KNOWN), STILL)


@pytest.mark.parametrize("gap", [1.001, 60.0])
def test_a_pose_after_a_gap_begins_anew_though_no_command_came_between(gap):
    controller, now = under_way()
    controller.update(now + gap, off_station([9.0, 0, 0, 0, 0]), PUBLISHED, STILL)
