"""The closed loop: who moves when, who sees which lamps, and what the law is told."""

import numpy as np
import pytest
from scenes import changed, coarse

from uuv_optical_array.control.closed_loop import ClosedLoop, Light, Swimmer, clouded
from uuv_optical_array.control.following import State
from uuv_optical_array.control.vehicles.sea import Sea
from uuv_optical_array.control.vehicles.vehicle import Vehicle, VehicleLimits
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import rotation_matrix
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.others import Other
from uuv_optical_array.forward.scene import load_scene

NOTHING = dict.fromkeys(("sensor_noise", "saturation", "adc"))


@pytest.fixture(scope="module")
def estimator():
    """An estimator of light in water, without noise or converter, that takes every match."""
    return Estimator(build_table(changed(coarse("reference"), effects=NOTHING)), "sam")


class Law:
    """A law that locks at a time, and commands one twist from then on."""

    def __init__(self, locks_s=0.0, command=((0.2, 0.1, 0.0), (0.0, 0.0, 0.1)), refuses=False):
        self.locks_s, self.twist, self.refuses = locks_s, command, refuses
        self.state = State("waiting", 0.0, "")
        self.tracks, self.looks = [], []

    def looked(self, stamp_s, brightest):
        self.looks.append(stamp_s)

    def update(self, stamp_s, pose, covariance, rate, rate_covariance):
        self.tracks.append((stamp_s, pose))
        if self.refuses:
            raise NoPose("not this one")

    def command(self, now_s):
        if now_s < self.locks_s:
            return None
        self.state = State("locked", now_s, "")
        return tuple(map(np.array, self.twist))


def swimmer(estimator, law, place=(-5.0, 0.0, 0.0), light=None, **others):
    light = light or Light(ForwardModel(estimator.scene))
    return Swimmer(Vehicle(place), Pipeline(estimator), law, lambda t_s: light, **others)


def agile():
    leader = Vehicle(np.zeros(3))
    leader.limits = VehicleLimits((9.0,) * 5, (1e6,) * 5)
    return leader


def test_the_leader_goes_its_way_over_ground_once_every_follower_is_locked(estimator):
    laws = Law(0.35), Law(0.75, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    followers = [
        swimmer(estimator, law, (-5.0, side, 0.0)) for law, side in zip(laws, (-1, 1), strict=True)
    ]

    def motion(t_s):
        return np.array([0.5, 0.0, 0.0]), np.array([0.0, 0.0, 0.2])

    sea = Sea((0.0, 0.3, 0.0))
    loop = ClosedLoop(agile(), followers, np.random.default_rng(1), motion, sea)
    seen = [loop.step(0.1) for _ in range(28)]
    assert [one.state.name for one in seen[3]] == ["locked", "waiting"]
    assert loop.path_s == pytest.approx(2.0)  # the second locked at 0.8 s
    # On a circle of 2.5 m to port, which no current shifts.
    np.testing.assert_allclose(
        loop.leader.position, 2.5 * np.array([np.sin(0.4), 1 - np.cos(0.4), 0.0]), atol=0.02
    )
    # The second commands nothing, and the current carries it.
    np.testing.assert_allclose(followers[1].vehicle.position, [-5.0, 1.0 + 0.6, 0.0], atol=1e-9)
    assert followers[0].vehicle.position[0] > -5.0


def test_without_a_command_a_follower_rests(estimator):
    law = Law()
    loop = ClosedLoop(agile(), [swimmer(estimator, law)], np.random.default_rng(1))
    for _ in range(10):
        (seen,) = loop.step(0.1)
    assert seen.commanded[0][0] == 0.2
    law.locks_s = np.inf
    for _ in range(20):
        (seen,) = loop.step(0.1)
    np.testing.assert_array_equal(seen.commanded, np.zeros((2, 3)))
    assert not loop.followers[0].vehicle.linear.any()


def test_each_sees_the_lamp_that_it_follows(estimator):
    laws = Law(np.inf), Law(np.inf)
    places = (-5.0, 1.0, 0.0), (-9.5, 2.5, 0.5)
    followers = [swimmer(estimator, laws[k], places[k], ahead=k) for k in range(2)]
    leader = Vehicle([1.0, 2.0, 3.0], yaw=0.3)
    loop = ClosedLoop(leader, followers, np.random.default_rng(1))
    first, second = loop.step(0.1)
    to_leader = rotation_matrix(0.0, 0.3).T
    np.testing.assert_allclose(first.true_pose[:3], to_leader @ np.subtract(places[0], [1, 2, 3]))
    assert first.true_pose[4] == pytest.approx(-0.3)
    np.testing.assert_allclose(second.true_pose, [-4.5, 1.5, 0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(second.lamp[0], places[0])


def test_the_light_of_other_lamps_adds_up_in_the_frame_of_ours(estimator):
    model, place = ForwardModel(estimator.scene), np.array([1.0, 2.0, 3.0])
    turn = rotation_matrix(0.1, 0.3)
    # A lamp 0.7 m to port of ours and 1 m behind it shines from there as ours would.
    other = Other(np.array([-1.0, 0.7, 0.0]), np.eye(3), power=0.5)
    start = place + turn @ [-5.0, 0.2, 0.0]
    light = Light(model, others=[other])
    follower = swimmer(estimator, Law(np.inf), light=light)
    follower.vehicle = Vehicle(start, 0.1, 0.3)
    loop = ClosedLoop(Vehicle(place, 0.1, 0.3), [follower], np.random.default_rng(1))
    (seen,) = loop.step(0.1)
    ours, theirs = model.light([[-5.0, 0.2, 0, 0, 0], [-4.0, -0.5, 0, 0, 0]])
    np.testing.assert_allclose(seen.image, ours + 0.5 * theirs, rtol=1e-9)


def test_a_follower_between_takes_the_light_of_the_leader_and_gives_its_own(estimator):
    model = ForwardModel(estimator.scene)
    followers = [
        swimmer(estimator, Law(np.inf), place) for place in ((-3.0, 0.0, 0.0), (-6.0, 0.0, 0.0))
    ]
    loop = ClosedLoop(Vehicle(np.zeros(3)), followers, np.random.default_rng(1))
    _, behind = loop.step(0.1)
    np.testing.assert_allclose(behind.image, model.light([-3.0, 0, 0, 0, 0]), rtol=1e-9)


def test_the_law_gets_each_track_and_says_why_it_refuses(estimator):
    law = Law(refuses=True)
    loop = ClosedLoop(agile(), [swimmer(estimator, law)], np.random.default_rng(1))
    seen = [loop.step(0.1)[0] for _ in range(4)]
    assert law.looks == [one.t_s for one in seen]
    assert [stamp_s for stamp_s, _ in law.tracks] == law.looks
    for one, (_, pose) in zip(seen, law.tracks, strict=True):
        np.testing.assert_array_equal(one.answer.track.pose, pose)
    assert {one.answer.reason for one in seen} == {"not this one"}


def test_a_silent_imu_leaves_the_roll_that_it_told_last(estimator):
    law = Law(np.inf)
    told = swimmer(estimator, law, imu=lambda roll, t_s: roll if t_s < 0.25 else None)
    told.vehicle = Vehicle([-5.0, 0.4, 0.0])
    told.vehicle.roll = 0.5
    loop = ClosedLoop(agile(), [told], np.random.default_rng(1))
    seen = [loop.step(0.1)[0] for _ in range(2)]
    told.vehicle.roll = 0.3
    seen += [loop.step(0.1)[0] for _ in range(2)]
    for one in seen[0], seen[-1]:
        known = one.answer.estimate.pose
        np.testing.assert_array_equal(known, estimator.estimate(one.image, roll=0.5).pose)
        assert (known != estimator.estimate(one.image).pose).any()


def test_a_sounder_tells_the_track_the_true_range_and_its_error_at_its_time(estimator):
    sounded = []

    def sounder(range_m, t_s):
        sounded.append((range_m, t_s))
        return (range_m + 0.01, 0.05) if t_s > 0.15 else None

    loop = ClosedLoop(
        agile(), [swimmer(estimator, Law(), sounder=sounder)], np.random.default_rng(1)
    )
    seen = [loop.step(0.1)[0] for _ in range(4)]
    true = [(np.linalg.norm(one.true_pose[:3]), one.t_s) for one in seen]
    np.testing.assert_allclose(sounded, true, rtol=1e-12)
    assert seen[0].answer.track.range is None
    stamps = [one.answer.track.range.stamp_ns for one in seen[1:]]
    assert stamps == [round(one.t_s * 1e9) for one in seen[1:]]


def test_clouds_are_those_of_the_scene_or_of_the_night_and_a_seed_draws_them():
    night = load_scene("night_plume")
    pose = np.array([-5.0, 0, 0, 0, 0])

    def light(model):
        return model.light(pose, time_s=0.0)

    assert (light(clouded(night, 0.7)) == light(ForwardModel(night))).all()
    clear = light(clouded(night, 0.0))
    once, twice = (light(clouded(night, depth, 3)) for depth in (0.4, 0.8))
    np.testing.assert_allclose(clear * twice, once**2, rtol=1e-9)
    assert (light(clouded(night, 0.4, 4)) != once).any()
    assert (
        light(clouded(load_scene("follow"), 0.7)) < light(clouded(load_scene("follow"), 0))
    ).any()
