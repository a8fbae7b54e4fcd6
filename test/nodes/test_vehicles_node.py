"""The vehicles node in simulated time: odometry of one clock, a follower that obeys and stops."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from odometries import odometry, position, rotation, time_of
from rclpy.node import Node
from scipy.spatial.transform import Rotation

from uuv_optical_array.nodes.vehicles_node import VehiclesNode

START = 100 * 10**9
STEP = 10**8
ACCELERATION = 0.5  # m/s^2, of the small hovering vehicle


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
        lab.connect()

    def tick(self):
        """Move on by a period; return the odometry of leader and follower at the new time."""
        self.now += STEP
        self.lab.tick(self.now)
        return tuple(
            self.lab.answer(heard, time_of(self.now), f"odometry of the {name}")
            for name, heard in self.heard.items()
        )

    def order(self, surge=0.0, yaw_rate=0.0):
        """Command the follower and wait until the node has it."""
        message = TwistStamped()
        message.twist.linear.x, message.twist.angular.z = surge, yaw_rate
        self.lab.deliver(self.node, self.commands, message)


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
    messages = [basin.tick()[0] for _ in range(250)]  # into the turn, which begins at 12 s
    surges = [message.twist.twist.linear.x for message in messages]
    np.testing.assert_allclose(surges, np.minimum(ACCELERATION * np.arange(1, 251) / 10, 0.5))
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
    # Speeding up to 0.3 m/s takes 0.6 s; another 1.4 s at that speed.
    assert follower.twist.twist.linear.x == pytest.approx(0.3)
    way = position(follower) - position(before)
    np.testing.assert_allclose(way, [0.3**2 / 2 / ACCELERATION + 0.3 * 1.4, 0, 0], atol=1e-9)
    # The last command came a tick ago; it holds for 0.5 s of age, then braking takes 0.6 s.
    surges = [basin.tick()[1].twist.twist.linear.x for _ in range(20)]
    expected = [0.3 - ACCELERATION * max(0.0, 0.1 * (i + 1) - 0.4) for i in range(20)]
    np.testing.assert_allclose(surges, np.maximum(expected, 0.0), atol=1e-9)
    basin.order(surge=0.3)
    assert basin.tick()[1].twist.twist.linear.x == pytest.approx(0.05)


def test_a_clock_that_is_set_back_stops_nothing(basin):
    for _ in range(5):
        basin.tick()
    basin.now = START // 2
    basin.lab.tick(basin.now)
    leader, follower = [basin.tick() for _ in range(3)][-1]
    assert leader.header.stamp == follower.header.stamp == time_of(basin.now)


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
        lab.until(lambda: node.fits.get(f"/{name}") == fit, "the diagnostics to arrive")
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
