"""The motion between frames: against Van Loan's exponential, SciPy's rotations and plain sums."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tracks import START_NS, turned, van_loan

from uuv_optical_array.core.messages import MAX_TWIST
from uuv_optical_array.estimation.tracking.motion import (
    OwnMotion,
    in_beacon,
    swing,
    walk_noise,
)

pytestmark = pytest.mark.filterwarnings("error")

ALONG = np.array([0.5, 0.1, -0.2, 0.03, -0.05])


@given(st.floats(0, 3), st.lists(st.floats(0, 10), min_size=5, max_size=5))
def test_the_noise_of_a_step_is_van_loans(step_s, walk):
    covariance = np.diag(np.square(walk))
    _, expected = van_loan(step_s, covariance)
    np.testing.assert_allclose(walk_noise(covariance, step_s), expected, rtol=1e-9, atol=1e-12)


@given(st.lists(st.floats(-3, 3), min_size=10, max_size=10))
def test_a_twist_is_turned_as_by_scipy(numbers):
    pose, twist = np.split(np.array(numbers), 2)
    np.testing.assert_allclose(in_beacon(pose, twist), turned(pose, twist), atol=1e-12)


@given(
    st.lists(st.floats(-6, 6), min_size=3, max_size=3),
    st.sampled_from([(1, "y"), (2, "z")]),
)
def test_a_leader_that_turns_swings_its_follower(place, about):
    """By small turns of the leader about the water's axes; the follower stands still."""
    (row, axis), turn = about, 1e-6
    leader = Rotation.from_euler(axis, turn)
    seen = leader.inv()
    moved = seen.apply(place) - place
    yaw, pitch, _ = seen.as_euler("ZYX")
    change = np.array([*moved, pitch, yaw]) / turn
    assert change[2 + row] == pytest.approx(-1)
    pose = np.array([*place, 0.0, 0.0])
    rate = np.zeros(5)
    rate[2 + row] = -1.0  # of the leader alone, at its own place
    np.testing.assert_allclose(swing(pose) @ rate, change, atol=1e-5)


@settings(max_examples=100)
@given(
    st.lists(st.integers(-(10**9), 10**9), max_size=6),
    st.integers(-(10**9), 10**9),
    st.integers(0, 10**9),
)
def test_each_command_holds_from_its_stamp_and_replaces_those_from_then_on(offsets, start, length):
    own, commands, twist = OwnMotion(), [(-np.inf, np.zeros(5))], np.empty(5)
    for k, offset in enumerate(offsets):
        twist[:] = (k + 1) * ALONG  # the caller's own array
        own.command(START_NS + offset, twist)
        commands = [each for each in commands if each[0] < offset] + [(offset, twist.copy())]
    ends = [stamp for stamp, _ in commands[1:]] + [np.inf]
    expected = np.zeros(5)
    for (since, held), until in zip(commands, ends, strict=True):
        expected += max(min(until, start + length) - max(since, start), 0.0) * 1e-9 * held
        if since > -np.inf:
            np.testing.assert_array_equal(own.twist(START_NS + since), held)
            np.testing.assert_array_equal(own.twist(START_NS + min(until, 10**12) - 1), held)
    displacement = own.displacement(START_NS + start, START_NS + start + length)
    np.testing.assert_allclose(displacement, expected, rtol=1e-12, atol=1e-12)


def test_what_is_forgotten_no_longer_held():
    own, whole = OwnMotion(), OwnMotion()
    for k in range(20):
        for motion in (own, whole):
            motion.command(START_NS + 10 * k, k * ALONG)
    own.forget(START_NS + 55)
    for start in (55, 59, 60, 61, 300):
        ends = START_NS + start, START_NS + 400
        np.testing.assert_array_equal(own.displacement(*ends), whole.displacement(*ends))
    # The oldest that is left stands for all before it.
    np.testing.assert_array_equal(own.twist(START_NS), 5 * ALONG)


@pytest.mark.parametrize(
    "twist", [ALONG[:4], [ALONG], 1.0, [np.nan, 0, 0, 0, 0], [0, 0, 0, 0, -1.1 * MAX_TWIST[4]]]
)
def test_a_bad_twist_is_refused_and_the_last_holds(twist):
    own = OwnMotion()
    own.command(START_NS, ALONG)
    with pytest.raises(
        ValueError, match=r"^twist: .*; give three within \+-10 m/s and two within \+-6 "
    ):
        own.command(START_NS - 5, twist)
    np.testing.assert_array_equal(own.twist(START_NS), ALONG)
