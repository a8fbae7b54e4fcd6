"""The formation node in simulated time: the law's command at every tick, and its state, as told."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from asker import twist_of
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from odometries import time_of
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from uuv_optical_array.control.darkness import SearchSettings
from uuv_optical_array.control.following import Following
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.leader.motion import Glow
from uuv_optical_array.control.leader.told_motion import Message
from uuv_optical_array.core.geometry import body_twist, covariance_5x5
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.formation_node import FormationNode, slow_station
from uuv_optical_array.nodes.shared.messages import (
    features_to_message,
    odometry_to_message,
    pose_to_message,
    rate_from_message,
)

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
SIMULATED = {"use_sim_time": True}
START = 100 * 10**9
STEP = 10**8
STATION = [-6.0, 0.0, 0.0, 0.0, 0.0]
STILL = np.zeros(5)
SPREAD = np.diag([0.16] * 3 + [0.01] * 3)
SEARCH = SearchSettings(settle_s=0.0)
POSE_ASTERN = np.array([-7.0, 0.3, 0.2, 0.05, 0.1])


def odometry(pose, rate=STILL, roll=0.1, frame="leader/beacon"):
    # Of an attitude that is known, so that the twist errs as the rate does.
    twist, covariance = body_twist(pose, rate, np.diag([0.0] * 5 + [1.0] * 5), roll)
    where = pose_to_message(np.array(pose), SPREAD, Header(frame_id=frame), roll)
    return odometry_to_message(where, "base_link", twist, covariance)


class Helm:
    """Ticks the clock of a formation node and collects its commands, one a tick."""

    def __init__(self, lab, search=SEARCH, **parameters):
        self.lab, self.now, self.search = lab, START, search
        self.engage_law()
        given = {"station_m": STATION[:3], **vars(search), **parameters}
        lab.begin({f"formation_node:{name}": value for name, value in given.items()} | SIMULATED)
        self.node = lab.start(FormationNode)
        self.poses = lab.talk(Odometry, "relative_odometry")
        self.clouds = lab.talk(PointCloud2, "array/features")
        self.faint_clouds = lab.talk(PointCloud2, "array/faint_features")
        self.commands = lab.listen(TwistStamped, "cmd_vel")
        self.states = lab.listen(DiagnosticStatus, "follow_state")
        lab.connect()
        lab.tick(self.now)

    def engage_law(self):
        """Begin with a law of the test's own."""
        self.law = Following(FormationSettings(station_m=tuple(STATION[:3])), self.search)

    def look(self, parameters=None, glow=None):
        """Tell node and law of an image of this instant, which shows no light unless it is told."""
        stamp = time_of(self.now)
        self.hear(self.clouds, features_to_message(parameters, Header(stamp=stamp)), PointCloud2())
        self.law.looked(self.now * 1e-9, glow)

    def glimmer(self, parameters, glow):
        """Tell node and law of light of this instant that no single image shows."""
        message = features_to_message(parameters, Header(stamp=time_of(self.now)))
        self.hear(self.faint_clouds, message, PointCloud2())
        self.law.glimmered(self.now * 1e-9, glow)

    def hear(self, talker, message, refused):
        """Tell the node what it does not answer, and wait until one after it has been refused."""
        talker.publish(message)
        self.lab.deliver(self.node, talker, refused)

    def told(self, name):
        """Wait until a state is told, and return how it is told at first."""
        return self.lab.until(
            lambda: next((state for state in self.states if state.message == name), None), name
        )

    def see(self, pose, stamp=None, rate=STILL, rate_covariance=None):
        """Tell node and law a pose and its rate, of this instant unless a stamp is given."""
        message, stamp = odometry(pose, rate), self.now if stamp is None else stamp
        message.header.stamp = time_of(stamp)
        covariance = covariance_5x5(pose, SPREAD)
        self.law.update(stamp * 1e-9, pose, covariance, rate, rate_covariance)
        self.lab.deliver(self.node, self.poses, message)

    def tick(self):
        """Move on by a period of the commands."""
        self.now += STEP
        self.lab.tick(self.now)

    def command(self):
        """Move on by a period and return the command of it: surge, sway, heave, and turns."""
        self.tick()
        message = self.lab.answer(self.commands, time_of(self.now), "a command")
        return np.array(twist_of(message.twist))

    def check_command(self):
        """Expect the command of the law and return it."""
        found, expected = self.command(), self.law.command(self.now * 1e-9)
        np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-9)
        return found


@pytest.fixture
def helm(lab):
    return Helm(lab)


def test_nothing_is_commanded_before_the_first_pose(helm):
    for _ in range(20):
        helm.tick()
    helm.see([-7.0, 0.3, 0.2, 0.05, 0.1])
    # A pose that came is no command yet, and it is commands that are told.
    helm.lab.report(helm.node, WARN, "no output")
    helm.command()
    assert [command.header.stamp for command in helm.commands] == [time_of(helm.now)]


def test_every_command_is_the_laws_at_the_simulated_time_in_the_followers_frame(lab):
    helm, rng = Helm(lab, base_frame="rov/base_link"), np.random.default_rng(2)
    for i in range(30):
        if i % 3 != 1:  # the light flickers
            pose = STATION + rng.normal(0.0, [0.5, 0.2, 0.2, 0.1, 0.1])
            taken = helm.now - 30_000_000  # when the image was; the pose took its time
            helm.see(pose, taken, rng.normal(0.0, [0.3, 0.2, 0.2, 0.1, 0.1]))
        found = helm.check_command()
    assert np.abs(found).max() > 0.01
    assert {command.header.frame_id for command in helm.commands} == {"rov/base_link"}


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda m: setattr(m.twist.twist.linear, "x", 11.0), ("out of bounds", "twist")),
        (lambda m: setattr(m.pose.pose.position, "x", 40.0), ("outlier", "another lamp")),
        (lambda m: setattr(m.header, "stamp", time_of(START)), ("100.0", "not after")),
    ],
)
def test_a_bad_pose_is_told_and_steers_nothing(helm, spoil, words):
    helm.see([-7.0, 0.0, 0.0, 0.0, 0.0])
    message = odometry([-4.0, 1.0, 1.0, 0.5, 0.5])
    message.header.stamp = time_of(helm.now + STEP // 2)
    spoil(message)
    helm.lab.deliver(helm.node, helm.poses, message)
    helm.lab.report(helm.node, WARN, *words)
    for _ in range(3):
        helm.check_command()
    helm.see([-7.0, 0.0, 0.0, 0.0, 0.0])
    helm.lab.report(helm.node, OK)


def test_a_command_that_is_not_finite_is_held_back_and_told(helm, monkeypatch):
    helm.see(POSE_ASTERN)
    with monkeypatch.context() as patch:
        broken = np.array([0.0, np.nan, 0.0]), np.zeros(3)
        patch.setattr(helm.node.following, "command", lambda now: broken)
        helm.tick()
        helm.lab.report(helm.node, WARN, "not finite: twist.linear.y of /cmd_vel")
    helm.check_command()
    assert len(helm.commands) == 1


def test_the_helm_is_given_let_go_with_a_stop_and_taken_back_as_at_the_start(lab):
    helm = Helm(lab, start_engaged=False)

    def engage(wanted):
        answer = helm.lab.call(SetBool, "formation_node/engage", data=wanted)
        assert answer.success
        return answer.message

    helm.lab.report(helm.node, WARN, "not engaged")
    helm.see(POSE_ASTERN)
    helm.tick()
    assert not helm.commands
    engage(True)
    for _ in range(5):
        helm.see(POSE_ASTERN)
        before = helm.command()
    assert before[0] > 0.05
    helm.commands.clear()
    assert "commanded a stop" in engage(False)
    stop = helm.lab.until(lambda: helm.commands, "a stop")[0]
    assert (stop.twist, stop.header.frame_id) == (Twist(), "follower/base_link")
    helm.lab.report(helm.node, WARN, "not engaged")
    for _ in range(5):
        helm.see(POSE_ASTERN)
        helm.tick()
    assert engage(False)
    assert len(helm.commands) == 1
    assert f"steers to station_m {STATION[:3]}" in engage(True)
    helm.engage_law()
    for _ in range(3):
        helm.see(POSE_ASTERN)
        helm.check_command()
    helm.lab.report(helm.node, OK)


@pytest.mark.parametrize("frame", ["leader/beacon", "leader/beacon_ned"])
def test_the_rate_of_an_odometry_is_that_of_its_pose_in_any_axes(frame):
    pose, rate = [-6.0, 0.4, -0.3, 0.2, -0.3], [0.3, -0.2, 0.1, 0.05, -0.08]
    np.testing.assert_allclose(rate_from_message(odometry(pose, rate, 0.2, frame)), rate)


@pytest.mark.parametrize(
    ("station_m", "signs"), [([-5.0, 0.0, 0.0], [1, 0, 0]), ([-8.0, 1.0, -1.0], [-1, 1, -1])]
)
def test_the_station_can_change_while_the_node_runs(helm, station_m, signs):
    for _ in range(10):
        helm.see(STATION)
        np.testing.assert_allclose(helm.command(), 0.0, atol=1e-9)
    result = helm.lab.set(helm.node, "station_m", station_m)
    assert result.successful, result.reason
    for _ in range(20):
        helm.see(STATION)
        command = helm.command()
    np.testing.assert_array_equal(
        np.where(np.abs(command[:3]) > 0.05, np.sign(command[:3]), 0), signs
    )


def test_a_clock_that_is_set_back_stops_nothing(helm):
    for _ in range(5):
        helm.see(STATION)
        helm.command()
    helm.now = START // 2
    helm.lab.tick(helm.now)
    helm.see([-7.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(10):
        helm.see([-7.0, 0.0, 0.0, 0.0, 0.0], helm.now + 1)
        command = helm.command()
    assert command[0] > 0


@pytest.mark.parametrize("frame", ["", "odom", "leader/beacon_ned"])
def test_a_track_in_another_frame_is_refused(helm, frame):
    helm.lab.deliver(helm.node, helm.poses, odometry(POSE_ASTERN, frame=frame))
    helm.lab.report(
        helm.node, WARN, f"wrong frame: the track is in {frame!r}, not in leader/beacon"
    )
    helm.tick()
    assert not helm.commands


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_without_light_it_coasts_searches_and_ends_and_tells_of_each_at_once(lab):
    helm = Helm(lab, SearchSettings(settle_s=0.0, coast_s=2.0, search_time_s=4.0))
    assert helm.told("waiting").level == WARN
    leader_rate = [-0.3, 0.0, 0.0, 0.0, 0.0]  # it swims away
    for _ in range(10):
        helm.see(STATION, rate=leader_rate)
        helm.check_command()
    seen = helm.now - STEP  # the stamp of the last pose
    locked = helm.told("locked")
    assert (locked.level, locked.name, locked.hardware_id) == (
        OK,
        "formation_node",
        "uuv_optical_array",
    )
    helm.lab.report(helm.node, OK)
    # It is coasting at the first command after light_timeout_s, and so on.
    ends = ("coasting", WARN, 1.0), ("searching", WARN, 2.0), ("lost", ERROR, 4.0)
    for name, level, after in ends:
        while (helm.now - seen) * 1e-9 <= after + 0.01:
            helm.look()
            moving = helm.check_command()
        told = helm.told(name)
        assert told.level == level
        assert float(values(told)["since (s)"]) == pytest.approx(helm.now * 1e-9)
        assert values(told)["reason"] == helm.law.state.reason
        report = helm.lab.report(helm.node, WARN, f"{name}: {helm.law.state.reason}")
        assert f"cure: {name}" in values(report)
        if name == "coasting":
            assert moving[0] > 0.1  # it does not stop for its leader
    names = [key for key, _ in itertools.groupby(state.message for state in helm.states)]
    assert names == ["waiting", "locked", "coasting", "searching", "lost"]
    late = helm.lab.listen_late(DiagnosticStatus, "follow_state")
    helm.lab.until(lambda: late, "the last state, for one who comes later")
    assert late[0].message == "lost"
    for _ in range(12):
        helm.see(STATION)
        helm.check_command()
    assert values(helm.told("locked"))["reason"]
    helm.lab.report(helm.node, OK)


def test_a_state_is_told_again_and_again_with_how_long_it_lasts(helm):
    helm.see(STATION)
    helm.command()
    since = f"{START * 1e-9:.9f}"
    for _ in range(14):
        helm.see(STATION)
        helm.command()

    def told():
        return [(values(state)["since (s)"], values(state)["for (s)"]) for state in helm.states]

    helm.lab.until(lambda: (since, "1.5") in told(), "the state after 1.5 s")
    assert (since, "0.0") in told()


def test_a_search_is_begun_by_a_service_and_refused_where_there_is_nothing_to_search(lab):
    helm = Helm(
        lab, SearchSettings(settle_s=0.0, coast_s=60.0, search_start_s=0.0, search_time_s=3.0)
    )

    def search():
        answer = lab.call(Trigger, "formation_node/search")
        return answer.success, answer.message

    def dark(seconds):
        for _ in range(round(10 * seconds)):
            helm.look()
            helm.tick()

    helm.see(STATION)
    helm.command()
    assert search() == (False, "it is locked: the leader's light steers")
    dark(1.5)
    helm.told("coasting")
    assert search() == (True, "it searches for 3 s at most")
    helm.told("searching")
    dark(4.0)
    helm.told("lost")
    for _ in range(25):
        helm.tick()
    assert search() == (False, "no image comes, so that a search would be blind")
    lab.call(SetBool, "formation_node/engage", data=False)
    success, words = search()
    assert not success
    assert "call ~/engage" in words


def test_a_search_that_ended_can_be_begun_again(lab):
    helm = Helm(
        lab, SearchSettings(settle_s=0.0, coast_s=1.0, search_start_s=0.0, search_time_s=2.0)
    )
    helm.see(STATION)
    helm.command()
    for _ in range(25):
        helm.look()
        helm.tick()
    helm.told("lost")
    helm.states.clear()
    assert lab.call(Trigger, "formation_node/search").success
    helm.told("searching")
    for _ in range(10):
        helm.look()
        helm.tick()
    # That it was lost is told more than once, and may be heard after the call.
    told = [state.message for state in helm.states]
    assert "lost" not in told[told.index("searching") :]


@pytest.mark.parametrize("faint", [False, True])
@pytest.mark.parametrize(("scene", "half"), [("follow", 2.0)])
def test_a_search_goes_to_light_that_has_no_pose(lab, scene, half, faint):
    side = load_scene(scene).array.detectors_per_side
    assert side == 2 * half + 1
    helm = Helm(lab, SearchSettings(settle_s=0.0, coast_s=0.0), scene=scene)
    helm.see(STATION)
    helm.command()
    while helm.law.state.name != "searching":
        helm.look()
        helm.check_command()
    # Of key parameters: one detector to starboard, two down.
    parameters, glow = np.array([0.01, 1.0, 2.0, 0.3, 0.2]), Glow(-1.0 / half, -2.0 / half, 0.01)
    commands = []
    for _ in range(80):
        if faint:
            helm.look()
            helm.glimmer(parameters, glow)
        else:
            helm.look(parameters, glow)
        commands.append(helm.check_command())
    assert helm.law.state.name == "searching"
    way = np.sum(commands, axis=0) * STEP * 1e-9
    assert way[1] < -0.1  # to starboard
    assert way[2] < -0.05  # down
    assert way[5] < -0.01


def test_in_the_dark_it_knows_its_way_by_its_odometry_where_it_is_told_to(lab):
    helm = Helm(lab, replace(SEARCH, search_depth_m=0.05), use_odometry=True)
    odometries, damaged = lab.talk(Odometry, "odometry"), Odometry()
    damaged.twist.twist.linear.x = np.nan
    lab.connect()

    def swim(surge, frame="base_link"):
        message = Odometry(child_frame_id=frame)
        message.header.stamp, sign = time_of(helm.now), -1 if frame.endswith("_frd") else 1
        message.twist.twist.linear.x, message.twist.twist.linear.z = surge, sign * 0.1
        message.twist.twist.angular.y = sign * 0.02
        up = None
        if sign < 0:  # of a bow that is 0.6 rad down, in a world whose z is down
            message.header.frame_id, q = "map_ned", message.pose.pose.orientation
            q.x, q.y, q.z, q.w = Rotation.from_euler("y", -0.6).as_quat().tolist()
            up = np.array([-math.sin(0.6), 0.0, math.cos(0.6)])
        helm.hear(odometries, message, damaged)
        helm.law.moved(helm.now * 1e-9, [surge, 0, 0.1], [0, 0.02, 0], up)

    helm.see(STATION)
    helm.check_command()
    for _ in range(30):
        swim(-0.5)  # a current carries it astern
        helm.look()
        found = helm.check_command()
    other = Following(FormationSettings(station_m=tuple(STATION[:3])), helm.search)
    assert found[0] > 0.3  # it swims back
    assert helm.law.state.name == "coasting"
    assert other.state.name == "waiting"
    for _ in range(5):
        swim(0.2, "hull_frd")
        helm.look()
        helm.check_command()
    lab.report(helm.node, WARN, "odometry, not finite")


def test_it_goes_by_what_its_leader_tells_where_it_is_told_to(lab):
    lamp, spread = [-0.5, 0.1, 0.2], np.diag([0.02, 0.03, 0.02, 1.0, 0.01, 0.02]) ** 2
    helm = Helm(lab, use_leader_odometry=True, beacon_position_m=lamp)
    told, mirror = lab.talk(Odometry, "leader/odometry"), [1, -1, -1, 1, -1, -1]
    damaged = Odometry()
    damaged.twist.covariance[7] = np.nan
    lab.connect()

    def swim(surge, frame="leader/base_link", covariance=spread):
        message, signs = Odometry(child_frame_id=frame), np.ones(6)
        message.header.stamp = time_of(helm.now - 3 * STEP)
        if frame.endswith("_frd"):
            signs = np.array(mirror)
        twist = signs * [surge, 0.1, 0.0, 0.0, 0.05, 0.3]
        message.twist.twist.linear.x, message.twist.twist.linear.y = twist[:2]
        message.twist.twist.angular.y, message.twist.twist.angular.z = twist[4:]
        message.twist.covariance = (np.outer(signs, signs) * covariance).ravel()
        helm.hear(told, message, damaged)

    def motion(surge):
        """Return that of the lamp, which the turn moves, too."""
        lever = np.eye(6)
        lever[:3, 3:] = np.cross(np.eye(3), lamp).T
        twist = lever @ [surge, 0.1, 0.0, 0.0, 0.05, 0.3]
        return Message(helm.now * 1e-9 - 0.3, twist[:3], twist[3:], lever @ spread @ lever.T)

    law, rate, known = helm.law, np.array([-0.2, 1.2, 0.0, 0.0, -0.2]), np.eye(5)
    untold = Following(FormationSettings(station_m=tuple(STATION[:3])), helm.search)
    for i in range(8):
        swim(0.4 + 0.1 * i, ("leader/base_link", "leader_frd")[i % 2])
        law.leader_moves(helm.now * 1e-9, motion(0.4 + 0.1 * i))
        seen = helm.now * 1e-9, STATION, covariance_5x5(STATION, SPREAD), rate
        untold.update(*seen, known)
        helm.see(STATION, rate=rate, rate_covariance=known)
        found, alone = helm.check_command(), untold.command(helm.now * 1e-9)
    assert np.abs(found - np.concatenate(alone)).max() > 0.01
    lab.report(helm.node, WARN, "leader/odometry, not finite: the twist's covariance")
    helm.tick()
    silent = Odometry()
    silent.header.stamp = time_of(helm.now)
    lab.deliver(helm.node, told, silent)
    lab.report(helm.node, WARN, "leader/odometry, covariance: variances [0.0,")
    helm.see(STATION, rate=rate)
    helm.command()


def test_a_station_that_a_minimum_distance_slows_is_said(helm):
    helm.see(STATION)
    helm.command()
    assert helm.lab.set(helm.node, "light_timeout_s", 4.0).successful
    # 6 - 2 m within 4 + 3 / 2 s.
    report = helm.lab.report(helm.node, WARN, "slow station: 4 m", "0.73 m/s at most", "is 1.4")
    assert "cure: slow station" in values(report)
    assert helm.lab.set(helm.node, "min_distance_m", 0.0).successful
    helm.see(STATION)
    helm.command()
    helm.lab.report(helm.node, OK)
    refused = helm.lab.set(helm.node, "min_distance_m", 6.5)
    assert not refused.successful


def test_the_default_station_is_as_fast_as_its_law():
    assert slow_station(FormationSettings()) == ""
