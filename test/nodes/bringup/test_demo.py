"""The record of the demonstration begins when the leader sets off; two runs do not mix."""

import numpy as np
import pytest
from command_line import PROGRAM, begun, ended
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from odometries import odometry, time_of
from rclpy.time import Time
from std_msgs.msg import Header

from uuv_optical_array.control.fleet import vee
from uuv_optical_array.control.follow_record import FollowRecord
from uuv_optical_array.control.follow_states import values_of
from uuv_optical_array.control.following import State
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.bringup import demo
from uuv_optical_array.nodes.bringup.demo import START_S, RecorderNode, TimeLeft, options_of
from uuv_optical_array.nodes.shared.messages import image_to_message
from uuv_optical_array.nodes.simulator_node import SimulatorNode


def test_what_comes_before_the_leader_sets_off_is_no_part_of_the_run(lab):
    lab.begin()
    record = FollowRecord((-6.0, 0.0, 0.0))
    recorder = RecorderNode(record, load_scene("follow"), "leader/odometry")
    lab.nodes.append(recorder)

    def take(tenths):
        header = Header(stamp=time_of(tenths * 10**8))
        pose = PoseWithCovarianceStamped(header=header)
        pose.pose.pose.orientation.w = 1.0
        recorder.on_follower(odometry(tenths * 10**8, [-6.0, 0.0, 0.0]))
        recorder.on_image(image_to_message(np.full((5, 5), tenths), header))
        recorder.add(record.truth, header, np.full(5, -tenths))
        recorder.on_pose(pose)

    for tenths in range(1, 7):
        # The leader sets off at 0.3 s; what was taken before then comes later.
        surge = 0.5 if tenths >= 3 else 0.0
        leader = odometry(tenths * 10**8, [surge * (tenths - 3) / 10, 0.0, 0.0])
        leader.twist.twist.linear.x = surge
        recorder.on_leader(leader)
        if tenths == 3:
            take(2)
        take(tenths)
    for part in (
        record.leader_path,
        record.follower_path,
        record.truth,
        record.estimates,
        record.images,
    ):
        assert list(part) == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert [image[0, 0] for image in record.images.values()] == [3, 4, 5, 6]
    assert [pose[0] for pose in record.truth.values()] == [-3, -4, -5, -6]


class Hands:
    """Of a clock that a test sets."""

    def __init__(self):
        self.seconds = 100

    def now(self):
        return Time(seconds=self.seconds)


def test_a_run_waits_as_long_as_what_it_waits_for_is_busy_and_then_takes_its_time(monkeypatch):
    clock = Hands()
    monkeypatch.setattr(demo, "steady_clock", lambda node: clock)
    time_left = TimeLeft(None, 60.0)
    for busy in (True, False):
        clock.seconds += int(START_S) - 1
        assert time_left.wanted(True, busy)
    assert time_left.elapsed_s == 0
    clock.seconds += 1
    assert not time_left.wanted(True, False)
    for seconds, goes_on in ((0, True), (59, True), (1, False)):
        clock.seconds += seconds
        assert time_left.wanted(False, False) is goes_on
    assert time_left.elapsed_s == pytest.approx(60)


def test_a_simulated_clock_that_stands_is_told(monkeypatch):
    now_s, clock = 5.0, Hands()
    monkeypatch.setattr(demo, "steady_clock", lambda node: clock)
    monkeypatch.setattr(demo.time, "monotonic", lambda: now_s)
    time_left = TimeLeft(None, 60.0)
    assert time_left.wanted(True, True)
    now_s += START_S + 1
    clock.seconds += 1
    assert time_left.wanted(True, True)
    now_s += START_S + 1
    with pytest.raises(ValueError, match="the simulated clock stands at 101 s"):
        time_left.wanted(True, True)


def test_the_run_of_a_leader_that_stands_begins_once(lab):
    lab.begin()
    record = FollowRecord((-6.0, 0.0, 0.0))
    recorder = RecorderNode(record, load_scene("follow"), "leader/odometry")
    lab.nodes.append(recorder)
    for tenths in range(1, 7):
        if tenths in (3, 5):
            recorder.start(tenths * 10**8)
        recorder.on_leader(odometry(tenths * 10**8, [1.0, 0.0, 0.0]))
    assert list(record.leader_path) == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_states_are_of_the_run_from_the_one_in_which_the_leader_sets_off(lab):
    lab.begin()
    record = FollowRecord((-6.0, 0.0, 0.0))
    recorder = RecorderNode(record, load_scene("follow"), "leader/odometry")
    lab.nodes.append(recorder)

    def tell(name, since_s):
        values = values_of(State(name, since_s, f"it is {name}"), since_s + 1.0)
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        recorder.on_state(DiagnosticStatus(message=name, values=pairs))

    tell("waiting", 20.0)
    tell("locked", 21.0)
    leader = odometry(23 * 10**9, [0.0, 0.0, 0.0])
    leader.twist.twist.linear.x = 0.5
    recorder.on_leader(leader)
    tell("locked", 21.0)
    tell("coasting", 25.0)
    tell("coasting", 25.0)
    assert record.states == [
        State("locked", -2.0, "it is locked"),
        State("coasting", 2.0, "it is coasting"),
    ]


def test_a_run_beside_another_is_refused_and_says_how_to_separate_them(lab, tmp_path):
    lab.begin()
    lab.talk(TwistStamped, "cmd_vel")  # of a pilot, or of another demonstration
    error = refused(tmp_path, "--duration", "60")
    # By the lookout, or where discovery is slow by the run itself.
    assert "/cmd_vel of" in error
    assert "/probe;" in error
    assert "ROS_DOMAIN_ID" in error


def test_a_run_that_another_joins_ends_with_an_error(lab, tmp_path):
    lab.begin()
    poses = lab.listen(PoseWithCovarianceStamped, "relative_pose")

    def join():
        lab.until(lambda: poses, "a pose")
        lab.talk(Odometry, "leader/odometry")

    error = refused(tmp_path, "--duration", "600", meanwhile=join)
    assert "several publishers: /leader/odometry of /probe and /vehicles_node;" in error


def refused(folder, *words, meanwhile=lambda: None):
    """Run ``uuv_array follow`` until it refuses; return the line of its error."""
    picture = folder / "x.png"
    program = [*PROGRAM, "follow", "--scene", "reference", "--output", picture, *words]
    with begun(program) as process:
        meanwhile()
        _, error = ended(process, 1)
    assert not picture.exists()
    return error.splitlines()[-1]


def test_the_simulator_of_a_follower_draws_all_vehicles_but_it_and_the_one_ahead(lab):
    lab.begin({"scene": "formation"})
    fleet = vee(3)
    simulator = SimulatorNode(**options_of(fleet[2], fleet))
    lab.nodes.append(simulator)
    assert list(simulator.others) == ["/leader/odometry", "/follower_2/follower/odometry"]
    heard = [each.topic_name for each in simulator.subscriptions]
    assert {"/leader/odometry", "/follower_1/follower/odometry"} <= {*heard}
