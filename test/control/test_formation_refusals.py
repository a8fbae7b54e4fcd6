"""Nothing broken steers: no number that is none, no stray, no stream of strays."""

import contextlib

import numpy as np
import pytest
from followers import PUBLISHED, STATION, off_station
from hypothesis import given, settings
from hypothesis import strategies as st

from uuv_optical_array.control.formation import FormationController, FormationSettings
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.tracking.track import Outlier

FASTEST = np.array([1.0, 0.6, 0.6, 0.0, *np.radians([10, 10])])


def told(controller: FormationController, now: float) -> Array:
    command = controller.command(now)
    assert command is not None
    return np.concatenate(command)


def under_way() -> tuple[FormationController, float]:
    controller = FormationController(FormationSettings())
    for tick in range(40):
        controller.update(tick * 0.1, off_station([-1.0, 0.1, -0.1, 0.05, 0.05]), PUBLISHED)
        command = told(controller, tick * 0.1)
    assert command[0] > 0.3
    return controller, tick * 0.1


number = st.one_of(
    st.floats(), st.sampled_from([1e308, -1e308, 1e6, 1e-308, 0.0, -6.0, np.inf, np.nan])
)


@given(
    st.lists(
        st.tuples(st.floats(-0.2, 0.5), st.lists(number, min_size=5, max_size=5), number),
        min_size=1,
        max_size=15,
    )
)
@settings(max_examples=60)
@pytest.mark.filterwarnings("error")
def test_no_numbers_whatever_make_a_command_that_is_none(
    frames: list[tuple[float, list[float], float]],
) -> None:
    controller, now = FormationController(FormationSettings()), 0.0
    controller.update(now, STATION, PUBLISHED)
    for step, pose, scale in frames:
        now += step
        with contextlib.suppress(ValueError, Outlier), np.errstate(all="ignore"):
            controller.update(now, pose, PUBLISHED * scale)
        command = told(controller, now)
        assert np.isfinite(command).all()
        assert (np.abs(command) <= FASTEST + 1e-12).all()
    for tick in range(1, 60):
        with contextlib.suppress(ValueError, Outlier):
            controller.update(now + 0.1 * tick, off_station([-1, 0, 0, 0, 0]), PUBLISHED)
        command = told(controller, now + 0.1 * tick)
    # Good poses steer again.
    assert command[0] > 0.05


@pytest.mark.parametrize("std", [1e-10, 1e-3])
def test_a_pose_far_off_that_claims_to_be_exact_does_not_pull(std: float) -> None:
    (controller, now), (without, _) = under_way(), under_way()
    with pytest.raises(Outlier):
        controller.update(now + 0.1, off_station([-4.0, 1, 0, 0, 0.3]), np.eye(5) * std**2)
    assert told(controller, now + 0.2) == pytest.approx(told(without, now + 0.2), abs=1e-12)


@pytest.mark.parametrize("stamp", [1e300, 9.1e9, -9.1e9])
def test_a_stamp_beyond_any_clock_is_refused(stamp: float) -> None:
    controller, now = under_way()
    with pytest.raises(ValueError, match=r"pose: stamp is .* out of bounds; .*\+-9e\+09"):
        controller.update(stamp, STATION, PUBLISHED)
    assert told(controller, now)[0] > 0.3


def strays(count: int) -> Array:
    """Return poses of which no two agree."""
    rng = np.random.default_rng(4)
    return np.array([-40.0, 0, 0, 0, 0]) + rng.uniform(-30, 30, (count, 5)) * [1, 1, 1, 0, 0]


def test_poses_that_the_gate_refuses_are_no_light() -> None:
    controller, now = under_way()
    refused = 0
    for stray in strays(60):
        now += 0.1
        try:
            controller.update(now, stray, PUBLISHED / 100)
        except Outlier:
            refused += 1
        command = told(controller, now)
    assert refused > 50
    # Timeout and stop time are over: it stands, and the next stray does not change that.
    assert (command == 0).all()


def test_after_refusals_a_new_track_steers_once_five_poses_agree() -> None:
    controller, now = under_way()
    for stray in strays(60):
        now += 0.1
        with contextlib.suppress(Outlier):
            controller.update(now, stray, PUBLISHED / 100)
        told(controller, now)
    now += 2.0  # the last stray is forgotten
    moved = []
    for _ in range(10):
        now += 0.1
        controller.update(now, off_station([-1.0, 0, 0, 0, 0]), PUBLISHED)
        told(controller, now)
        moved.append(bool(told(controller, now + 0.05).any()))
    assert moved == [False] * 4 + [True] * 6


def test_a_near_pose_without_a_track_stops_the_follower_at_once() -> None:
    controller, now = under_way()
    for tick in range(1, 12):  # two directions in turns agree with nothing
        stray = off_station([-20.0, 15.0 * (-1) ** tick, 0, 0, 0])
        with contextlib.suppress(Outlier):
            controller.update(now + 0.1 * tick, stray, PUBLISHED / 100)
        before = told(controller, now + 0.1 * tick)
    assert before[0] > 0.1  # on its way to a stop
    with contextlib.suppress(Outlier):
        controller.update(now + 1.2, [-1.0, 0, 0, 0, 0], PUBLISHED / 100)
    assert (told(controller, now + 1.2)[:3] == 0).all()
