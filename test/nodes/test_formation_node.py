"""The formation node in simulated time: the controller's command at every tick of the clock."""

import numpy as np
import pytest
from asker import twist_of
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from odometries import time_of
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from uuv_optical_array.control.formation import FormationController, FormationSettings
from uuv_optical_array.core.geometry import body_twist, covariance_5x5
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared.messages import (
    odometry_to_message,
    pose_to_message,
    rate_from_message,
)

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
START = 100 * 10**9
STEP = 10**8
STATION = [-6.0, 0.0, 0.0, 0.0, 0.0]
STILL = np.zeros(5)
POSE_ASTERN = np.array([-7.0, 0.3, 0.2, 0.05, 0.1])


def odometry(pose, rate=STILL, roll=0.1, frame="leader/beacon"):
    twist, covariance = body_twist(pose, rate, np.eye(10), roll)
    where = pose_to_message(np.array(pose), np.eye(6), Header(frame_id=frame), roll)
    return odometry_to_message(where, "base_link", twist, covariance)


class Helm:
    """Ticks the clock of a formation node and collects its commands, one a tick."""

    def __init__(self, lab, **parameters):
        self.lab, self.now = lab, START
        self.engage_law()
        lab.begin({"use_sim_time": True, "station_m": STATION[:3], **parameters})
        self.node = lab.start(FormationNode)
        self.poses = lab.talk(Odometry, "relative_odometry")
        self.commands = lab.listen(TwistStamped, "cmd_vel")
        lab.connect()
        lab.tick(self.now)

    def engage_law(self):
        """Begin with a law of the test's own."""
        self.law = FormationController(FormationSettings(station_m=tuple(STATION[:3])))

    def see(self, pose, stamp=None, rate=STILL):
        """Tell node and law a pose and its rate, of this instant unless a stamp is given."""
        message, stamp = odometry(pose, rate), self.now if stamp is None else stamp
        message.header.stamp = time_of(stamp)
        self.law.update(stamp * 1e-9, pose, covariance_5x5(pose, np.eye(6)), rate)
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
    helm.command()
    assert [command.header.stamp for command in helm.commands] == [time_of(helm.now)]


def test_every_command_is_the_controllers_at_the_simulated_time_in_the_followers_frame(lab):
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
        (lambda m: setattr(m.pose.pose.position, "x", 40.0), ("outlier", "beyond the reach")),
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
        patch.setattr(helm.node.controller, "command", lambda now: broken)
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
