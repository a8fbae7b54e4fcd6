"""The vehicles node in simulated time: odometry of one clock, a follower that obeys and stops."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from odometries import odometry, position, rotation, time_of
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.vehicles.vehicle import VehicleLimits
from uuv_optical_array.nodes.vehicles_node import VehiclesNode

START = 100 * 10**9
STEP = 10**8
ACCELERATION = VehicleLimits().acceleration[0]  # m/s^2


class Basin:
    """Ticks the clock of a vehicles node and collects both odometries, one a tick."""

    def __init__(self, lab, **parameters):
        self.lab, self.now = lab, START - STEP
        lab.begin({"use_sim_time": True, **parameters})
        self.node = lab.start(VehiclesNode)
        self.heard = {
            name: lab.listen(Odometry, f"{name}/odometry") for name in ("leader", "follower")
        }
        self.commands = lab.talk(TwistStamped, "cmd_vel")
        self.drivers = lab.talk(TwistStamped, "leader/cmd_vel")
        lab.connect()

    def tick(self):
        """Move on by a period; return the odometry of leader and follower at the new time."""
        self.now += STEP
        self.lab.tick(self.now)
        return tuple(
            self.lab.answer(heard, time_of(self.now), f"odometry of the {name}")
            for name, heard in self.heard.items()
        )

    def order(self, surge=0.0, yaw_rate=0.0, to=None):
        """Command the follower, or by another publisher, and wait until the node has it."""
        message = TwistStamped()
        message.twist.linear.x, message.twist.angular.z = surge, yaw_rate
        self.lab.deliver(self.node, to or self.commands, message)

    def drive(self, surge=0.0, yaw_rate=0.0):
        """Command the leader."""
        self.order(surge, yaw_rate, self.drivers)


@pytest.fixture
def basin(lab):
    return Basin(lab)


def test_both_odometries_carry_every_tick_of_the_clock_in_one_world(lab):
    basin = Basin(lab, world_frame="sea")
    for _ in range(30):
        basin.tick()
    ticks = [time_of(START + i * STEP) for i in range(30)]
    for name, heard in basin.heard.items():
        assert [message.header.stamp for message in heard] == ticks
        assert {message.header.frame_id for message in heard} == {"sea"}
        assert {message.child_frame_id for message in heard} == {f"{name}/base_link"}


@pytest.mark.parametrize("station_m", [[-4.0, 0.0, 0.0], [-8.0, 1.0, -2.0]])
def test_the_follower_starts_at_rest_near_its_station(lab, station_m):
    leader, follower = Basin(lab, station_m=station_m).tick()
    gap = position(follower) - position(leader)
    assert gap == pytest.approx(station_m, abs=0.6)
    assert (rotation(leader).inv() * rotation(follower)).magnitude() < 1e-9
    assert follower.twist.twist == type(follower.twist.twist)()


def test_the_leader_waits_for_the_first_command_and_then_for_none(basin):
    start = position(basin.tick()[0])
    for _ in range(5):
        leader, _ = basin.tick()
        np.testing.assert_array_equal(position(leader), start)
    basin.order(surge=np.nan)
    basin.lab.report(
        basin.node, DiagnosticStatus.WARN, "leader waits", "cmd_vel, not finite", "nan"
    )
    np.testing.assert_array_equal(position(basin.tick()[0]), start)
    basin.order()
    basin.lab.report(basin.node, DiagnosticStatus.OK)
    # It speeds up from the beginning of its path; no other command has to come.
    messages = [basin.tick()[0] for _ in range(200)]  # into the turn, which begins at 12 s
    surges = [message.twist.twist.linear.x for message in messages]
    np.testing.assert_allclose(surges, np.minimum(ACCELERATION * np.arange(1, 201) / 10, 0.5))
    assert rotation(messages[100]).magnitude() < 1e-12
    assert rotation(messages[-1]).as_euler("ZYX")[0] > np.radians(5.0)
    way = 0.5 * 3.0 - 0.5**2 / 2 / ACCELERATION
    assert position(messages[29])[0] - start[0] == pytest.approx(way, abs=1e-3)
    # Integrated by the trapezoidal rule, the velocities give the path.
    velocities = np.array([over_ground(message) for message in messages])
    path = (velocities[1:] + velocities[:-1]).sum(axis=0) / 2 * 0.1
    np.testing.assert_allclose(path, position(messages[-1]) - position(messages[0]), atol=0.01)


def test_the_follower_obeys_and_stops_when_the_command_is_too_old(lab):
    basin = Basin(lab, command_timeout_s=2.0)
    _, before = basin.tick()
    assert lab.set(basin.node, "command_timeout_s", 0.5).successful
    for _ in range(20):
        basin.order(surge=0.3)
        _, follower = basin.tick()
    # Up to 0.3 m/s, and the rest of 2 s at that speed.
    assert follower.twist.twist.linear.x == pytest.approx(0.3)
    way = position(follower) - position(before)
    np.testing.assert_allclose(way, [0.6 - 0.3**2 / 2 / ACCELERATION, 0, 0], atol=1e-9)
    # The last command came a tick ago; it holds for 0.5 s of age, then it brakes.
    surges = [basin.tick()[1].twist.twist.linear.x for _ in range(20)]
    expected = [0.3 - ACCELERATION * max(0.0, 0.1 * (i + 1) - 0.4) for i in range(20)]
    np.testing.assert_allclose(surges, np.maximum(expected, 0.0), atol=1e-9)
    basin.order(surge=0.3)
    assert basin.tick()[1].twist.twist.linear.x == pytest.approx(0.1 * ACCELERATION)


def test_a_clock_that_is_set_back_stops_nothing(basin):
    for _ in range(5):
        basin.tick()
    basin.now = START // 2
    basin.lab.tick(basin.now)
    leader, follower = [basin.tick() for _ in range(3)][-1]
    assert leader.header.stamp == follower.header.stamp == time_of(basin.now)


def test_a_clock_that_jumps_moves_nobody_and_is_said(basin):
    for _ in range(20):
        basin.order(surge=0.3)
        before = basin.tick()
    basin.lab.report(basin.node, DiagnosticStatus.OK)
    for jump_s, told in ((30, "paused: a step of 30.1 s"), (-10, "paused: a step of -9.9 s")):
        basin.now += jump_s * 10**9
        basin.order(surge=0.3)
        if jump_s < 0:
            basin.lab.tick(basin.now)  # by which the timer is set anew
        after = basin.tick()
        for one, other in zip(before, after, strict=True):
            np.testing.assert_array_equal(position(other), position(one))
        basin.lab.report(basin.node, DiagnosticStatus.WARN, told)
        basin.order(surge=0.3)
        before = basin.tick()
        ways = [position(b)[0] - position(a)[0] for a, b in zip(after, before, strict=True)]
        assert ways == pytest.approx([0.05, 0.03])


def test_the_leader_obeys_its_own_commands_and_stops_when_they_end(lab):
    basin = Basin(lab, leader_path="dash", command_timeout_s=0.5)
    start = position(basin.tick()[0])
    basin.drive(surge=np.nan)
    basin.lab.report(
        basin.node, DiagnosticStatus.WARN, "leader waits", "leader/cmd_vel, not finite", "nan"
    )
    np.testing.assert_array_equal(position(basin.tick()[0]), start)
    for tick in range(30):  # it waits for no follower
        basin.drive(surge=-0.4, yaw_rate=0.2)
        leader, follower = basin.tick()
        assert leader.twist.twist.linear.x == pytest.approx(
            max(-0.1 * ACCELERATION * (tick + 1), -0.4)
        )
        assert not over_ground(follower).any()
    assert leader.twist.twist.angular.z == pytest.approx(0.2)
    basin.lab.report(basin.node, DiagnosticStatus.OK)
    basin.order(surge=0.2)  # the follower has a helm of its own
    surges = [[message.twist.twist.linear.x for message in basin.tick()] for _ in range(20)]
    # The last command came a tick ago; it holds for 0.5 s of age, then it brakes.
    braked = [-0.4 + ACCELERATION * max(0.0, 0.1 * (i + 1) - 0.4) for i in range(20)]
    np.testing.assert_allclose([surge for surge, _ in surges], np.minimum(braked, 0.0), atol=1e-9)
    assert surges[3][1] == pytest.approx(0.2)
    # Its path is no more, though every follower was commanded.
    basin.order()
    assert not over_ground(basin.tick()[0]).any()
    basin.drive(surge=0.3)
    assert basin.tick()[0].twist.twist.linear.x == pytest.approx(0.1 * ACCELERATION)


def test_a_driven_leader_drifts_with_the_current_as_what_is_commanded_is_through_the_water(lab):
    basin = Basin(lab, current_m_per_s=[0.0, 0.2, 0.0])
    basin.tick()
    for _ in range(20):
        basin.drive(surge=0.3)
        leader, _ = basin.tick()
    np.testing.assert_allclose(over_ground(leader), [0.3, 0.2, 0.0], atol=1e-9)


def test_the_leader_swims_the_path_of_a_file(lab, tmp_path):
    file = tmp_path / "path.csv"
    file.write_text(
        "t_s,surge_m_per_s,sway_m_per_s,heave_m_per_s,pitch_rate_deg_per_s,yaw_rate_deg_per_s\n"
        "0,0,0,-0.2,0,0\n1,0,0.3,0,0,0\n2,0,0,0,0,0\n"
    )
    basin = Basin(lab, leader_path=str(file))
    basin.tick()
    basin.order()
    speeds = np.array([over_ground(basin.tick()[0]) for _ in range(30)])
    assert speeds[9] == pytest.approx([0, 0, -0.2], abs=1e-9)
    assert speeds[19] == pytest.approx([0, 0.3, 0], abs=1e-9)
    assert speeds[29] == pytest.approx([0, 0, 0], abs=1e-9)


def test_a_path_that_is_none_is_refused_at_the_start(lab):
    lab.begin({"leader_path": "zigzags"})
    with pytest.raises(ValueError, match=r"'zigzags' is neither .*; did you mean zigzag\?"):
        lab.start(VehiclesNode)


@pytest.mark.parametrize("state", ["waiting", "searching", "lost"])
def test_the_leader_waits_for_a_follower_that_has_not_found_it(lab, state):
    lab.begin({"vehicles": "leader"})
    node = lab.start(VehiclesNode)
    command = lab.talk(TwistStamped, "follower_1/cmd_vel")
    lasting = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    states = lab.probe.create_publisher(DiagnosticStatus, "follower_1/follow_state", lasting)
    lab.publishers.append(states)
    heard = lab.listen(Odometry, "leader/odometry")
    lab.connect()
    for word in (state, "locked"):
        states.publish(DiagnosticStatus(message=word))
        lab.until(lambda word=word: word in node.waiting.states.values(), "the state")
        lab.deliver(node, command, TwistStamped())
        if word == state:
            words = f"leader waits: follower_1/cmd_vel is of a follower that is {state}"
            lab.report(node, DiagnosticStatus.WARN, words)
            assert node.path_s is None
            assert node.waiting.busy == (state == "searching")
    lab.until(lambda: heard and position(heard[-1])[0] > 0.01, "the leader to set off")
    lab.report(node, DiagnosticStatus.OK)


def test_a_follower_alone_waits_for_a_leader_and_starts_behind_it(lab):
    lab.begin({"vehicles": "follower", "station_m": [-5.0, 1.0, 0.0]})
    node = lab.start(VehiclesNode)
    leaders = lab.talk(Odometry, "leader/odometry")
    heard = lab.listen(Odometry, "follower/odometry")
    lab.connect()
    lab.report(node, DiagnosticStatus.WARN, "follower waits: no leader/odometry")
    assert node.count_publishers("leader/odometry") == 1  # the test's own
    assert not heard
    leaders.publish(odometry(0, [20.0, -3.0, 0.0], Rotation.from_euler("Z", np.pi / 2)))
    lab.until(lambda: heard, "a follower")
    # To the south of a leader that heads north, its port is in the west.
    assert position(heard[0]) == pytest.approx([19.0, -8.0, 0.0], abs=0.6)
    assert rotation(heard[0]).as_euler("ZYX")[0] == pytest.approx(np.pi / 2)
    leaders.publish(odometry(0, [90.0, 0.0, 0.0]))  # from now on it goes where it is commanded
    heard.clear()
    lab.until(lambda: len(heard) > 3, "the follower")
    assert position(heard[-1]) == pytest.approx([19.0, -8.0, 0.0], abs=0.6)


def test_a_leader_alone_waits_until_every_follower_is_commanded(lab):
    lab.begin({"vehicles": "leader", "followers": 2})
    node = lab.start(VehiclesNode)
    commands = [lab.talk(TwistStamped, f"follower_{i}/cmd_vel") for i in (1, 2)]
    heard = lab.listen(Odometry, "leader/odometry")
    lab.connect()
    lab.report(node, DiagnosticStatus.WARN, "follower_1/cmd_vel, follower_2/cmd_vel has come")
    lab.deliver(node, commands[1], TwistStamped())
    lab.report(node, DiagnosticStatus.WARN, "no follower_1/cmd_vel has come")
    heard.clear()
    lab.until(lambda: heard, "the leader")
    assert position(heard[-1]) == pytest.approx([0, 0, 0])
    lab.deliver(node, commands[0], TwistStamped())
    lab.until(lambda: position(heard[-1])[0] > 0.01, "the leader to set off")
    assert node.count_publishers("follower/odometry") == 0


@pytest.mark.parametrize("namespace", ["", "/rov"])
def test_the_leader_waits_until_an_estimator_has_the_fit_that_it_will_keep(lab, namespace):
    # The estimator is a node of its name whose diagnostics are those of one; it says how it fits.
    lab.begin({"vehicles": "leader"}, "-r", f"__ns:={namespace or '/'}")
    node = lab.start(VehiclesNode)
    space = f"{namespace}/follower_1"
    estimator = Node("estimator_node", namespace=space, use_global_arguments=False)
    estimator.create_publisher(DiagnosticArray, "/diagnostics", 10)
    commands = lab.talk(TwistStamped, f"{namespace}/follower_1/cmd_vel")
    told = lab.talk(DiagnosticArray, "/diagnostics")
    heard = lab.listen(Odometry, f"{namespace}/leader/odometry")
    lab.connect()

    def tell(fit):
        values = [KeyValue(key="method", value="least_squares"), KeyValue(key="fit", value=fit)]
        name = f"{namespace}/follower_1/estimator_node".lstrip("/")
        told.publish(DiagnosticArray(status=[DiagnosticStatus(name=name, values=values)]))
        lab.until(lambda: node.waiting.fits.get(f"/{name}") == fit, "the diagnostics to arrive")
        lab.deliver(node, commands, TwistStamped())

    ours = f"{namespace}/follower_1/estimator_node compiling the fit"
    lab.until(lambda: node.count_publishers("/diagnostics") == 3, "the estimator to be found")
    lab.deliver(node, commands, TwistStamped())
    lab.report(node, DiagnosticStatus.WARN, ours)  # it has not said anything
    tell("as it stands: it is being compiled")
    lab.report(node, DiagnosticStatus.WARN, ours)
    assert node.path_s is None
    tell("as it stands: Numba is not installed")
    assert node.path_s is not None
    lab.until(lambda: heard and position(heard[-1])[0] > 0.01, "the leader to set off")
    lab.report(node, DiagnosticStatus.OK)
    estimator.destroy_node()


def over_ground(message):
    linear = message.twist.twist.linear
    return rotation(message).apply([linear.x, linear.y, linear.z])


@pytest.mark.parametrize("vehicle", ["kinematic", "bluerov2"])
def test_the_leader_holds_its_path_in_a_current_that_carries_the_follower(lab, vehicle):
    basin = Basin(lab, vehicle_model=vehicle, current_m_per_s=[-0.1, 0.2, 0.0])
    start = basin.tick()
    # The sea is still until the leader sets off.
    for before, now in zip(start, basin.tick(), strict=True):
        np.testing.assert_allclose(position(now), position(before), atol=1e-9)
    basin.order()
    leader, follower = [basin.tick() for _ in range(100)][-1]
    np.testing.assert_allclose(over_ground(leader), [0.5, 0, 0], atol=0.03)
    np.testing.assert_allclose(over_ground(follower), [-0.1, 0.2, 0], atol=0.03)


def test_the_sea_can_change_while_the_node_runs(basin):
    basin.tick()
    assert basin.lab.set(basin.node, "current_m_per_s", [0.0, -0.4, 0.0]).successful
    np.testing.assert_array_equal(over_ground(basin.tick()[1]), np.zeros(3))
    basin.order()
    np.testing.assert_allclose(over_ground(basin.tick()[1]), [0, -0.4, 0], atol=1e-9)
    assert basin.lab.set(basin.node, "current_m_per_s", [0.0, 0.3, 0.0]).successful
    np.testing.assert_allclose(over_ground(basin.tick()[1]), [0, 0.3, 0], atol=1e-9)
    assert basin.lab.set(basin.node, "wave_height_m", 1.0).successful
    surges = [over_ground(basin.tick()[1])[0] for _ in range(80)]  # a period
    # At 10 m, by waves of 8 s: pi H / T exp(-k d).
    speed = np.pi / 8 * np.exp(-10 * (2 * np.pi / 8) ** 2 / 9.82)
    assert np.max(np.abs(surges)) == pytest.approx(speed, rel=0.02)


def test_however_long_the_leader_waited_one_wave_lifts_both(lab):
    # It goes along y, and the follower starts 0.2 m aside: 0.013 of a radian of the wave.
    basin = Basin(lab, wave_height_m=1.0, wave_direction_deg=90.0)
    for _ in range(17):
        basin.tick()
    basin.order()
    lifts = np.array([[over_ground(message)[2] for message in basin.tick()] for _ in range(40)])
    assert np.ptp(lifts[:, 0]) > 0.2
    np.testing.assert_allclose(lifts[:, 0], lifts[:, 1], atol=0.01)
