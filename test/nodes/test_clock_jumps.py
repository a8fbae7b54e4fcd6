"""Whoever sets the system's clock, vehicles move and commands come as before."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from odometries import position, time_of
from rclpy.clock import ClockType
from rclpy.time import Time
from tracks import correlated

from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.vehicles_node import PAUSE_S, VehiclesNode


def set_clock(node, seconds):
    """Let a node's clock stand at a time; a timer by it would never be due."""
    clock = node.get_clock()
    clock._set_ros_time_is_active(True)
    clock.set_ros_time_override(Time(seconds=seconds, clock_type=ClockType.ROS_TIME))


TIMES = 1000, 970, 5000


def test_vehicles_swim_on_by_a_steady_clock(lab):
    lab.begin()
    node = lab.start(VehiclesNode)
    commands = lab.talk(TwistStamped, "cmd_vel")
    heard = lab.listen(Odometry, "leader/odometry")
    lab.connect()
    lab.deliver(node, commands, TwistStamped())
    for seconds in TIMES:
        set_clock(node, seconds)
        stamp = time_of(seconds * 10**9)
        lab.until(lambda stamp=stamp: [m.header.stamp for m in heard[-3:]] == [stamp] * 3, "three")
    ways = np.diff([position(message)[0] for message in heard])
    assert (ways[-2:] > 0).all()
    assert ways.max() <= 0.5 * PAUSE_S  # at 0.5 m/s


def track_at(stamp_ns):
    track = Odometry(child_frame_id="base_link_by_light")
    track.header.frame_id, track.header.stamp = "leader/beacon", time_of(stamp_ns)
    track.pose.pose.position.x, track.pose.pose.orientation.w = -6.0, 1.0
    covariance = np.zeros((6, 6))
    chosen = np.ix_([0, 1, 2, 4, 5], [0, 1, 2, 4, 5])
    covariance[chosen] = correlated([0.1, 0.1, 0.1, 0.05, 0.05])
    covariance[3, 3] = 1e-4
    track.pose.covariance = covariance.ravel().tolist()
    return track


@pytest.mark.parametrize("whose", ["the node's", "the sensor's", "both"])
def test_a_clock_that_is_set_takes_no_leader_away(lab, whose):
    """Within a minute of the steady clock, whatever the others show."""
    lab.begin({"settle_s": 0.0, "light_timeout_s": 60.0, "min_distance_m": 0.0})
    node = lab.start(FormationNode)
    states = lab.listen(DiagnosticStatus, "follow_state")
    heard = lab.listen(TwistStamped, "cmd_vel")
    lab.connect()
    for i, seconds in enumerate((1000, 970, 970, 1040, 5000, 1000)):
        set_clock(node, 1000 if whose == "the sensor's" else seconds)
        stamp_s = 1000 if whose == "the node's" else seconds
        node.on_track(track_at(stamp_s * 10**9 + i * 10**6))
        wanted = len(heard) + 3
        lab.until(lambda wanted=wanted: len(heard) >= wanted, "three commands")
        lab.report(node, DiagnosticStatus.OK)
    assert {state.message for state in states} <= {"waiting", "locked"}


def test_commands_are_sent_on_by_a_steady_clock(lab):
    lab.begin({"settle_s": 0.0})
    node = lab.start(FormationNode)
    heard = lab.listen(TwistStamped, "cmd_vel")
    lab.connect()
    set_clock(node, TIMES[0])
    node.on_track(track_at(TIMES[0] * 10**9))
    for seconds in TIMES:
        set_clock(node, seconds)
        stamp = time_of(seconds * 10**9)
        lab.until(lambda stamp=stamp: [m.header.stamp for m in heard[-3:]] == [stamp] * 3, "three")


@pytest.mark.parametrize("make", [VehiclesNode, FormationNode])
def test_simulated_time_is_the_clock_where_it_is_used(lab, make):
    lab.begin({"use_sim_time": True})
    node = lab.start(make)
    assert node.timer.clock is node.get_clock()
