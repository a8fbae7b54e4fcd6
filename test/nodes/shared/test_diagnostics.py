"""Diagnostics: level, rate, age and jitter of stamps, refusals by kind, and what to do."""

from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from uuv_optical_array.estimation.estimator import Estimate
from uuv_optical_array.nodes.estimator.figures import figures
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared import diagnostics
from uuv_optical_array.nodes.shared.messages import image_to_message
from uuv_optical_array.nodes.vehicles_node import VehiclesNode

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
NOW = 100 * 10**9
IMAGE = np.arange(25.0).reshape(5, 5) * 10


class Bench:
    """A feature node in simulated time whose images carry any stamp."""

    def __init__(self, lab, namespace=None):
        self.lab = lab
        lab.begin({"scene": "reference", "use_sim_time": True}, any_stamp=False)
        self.node = lab.start(FeatureNode, namespace)
        place = f"{namespace}/array/image" if namespace else "array/image"
        self.images = lab.talk(Image, place)
        lab.connect()
        lab.tick(NOW)

    def send(self, *stamps_ns, image=IMAGE):
        for stamp in stamps_ns:
            header = Header()
            header.stamp.sec, header.stamp.nanosec = divmod(stamp, 10**9)
            self.lab.deliver(self.node, self.images, image_to_message(image, header))

    def report(self):
        """End the period and return its status and its values."""
        self.node.diagnostics.publish()
        status = self.lab.until(lambda: self.lab.statuses, "a report")[-1]
        self.lab.statuses.clear()
        return status, {pair.key: pair.value for pair in status.values}


@pytest.fixture
def bench(lab):
    return Bench(lab)


@pytest.fixture
def clock(monkeypatch):
    """Return the steady clock, which the test sets by `now_s`; a bench comes after it."""
    steady = SimpleNamespace(now_s=1000.0)
    monkeypatch.setattr(diagnostics.time, "monotonic", lambda: steady.now_s)
    return steady


def test_age_and_jitter_of_stamps_are_those_of_the_nodes_clock(bench):
    bench.send(NOW - 400_000_000, NOW - 300_000_000, NOW - 100_000_000)
    status, values = bench.report()
    assert (status.level, status.message) == (OK, "3 answered")
    assert float(values["Earliest timestamp delay:"]) == pytest.approx(0.1)
    assert float(values["Latest timestamp delay:"]) == pytest.approx(0.4)
    assert float(values["Timestamp jitter (s)"]) == pytest.approx(0.05)  # of 0.1 s and 0.2 s
    # The next period begins with the last stamp of this one, and has nothing to say without any.
    bench.send(NOW, NOW + 300_000_000)
    status, values = bench.report()
    assert status.message == "2 answered"
    assert float(values["Timestamp jitter (s)"]) == pytest.approx(0.1)  # of 0.1 s and 0.3 s
    _, values = bench.report()
    assert "Latest timestamp delay:" not in values


@pytest.mark.parametrize(
    ("stamp", "text"),
    [
        (NOW - 5_100_000_000, "old stamps: 5.1 s old, more than 5 s"),
        (NOW + 1_200_000_000, "future stamps: 1.2 s ahead, more than 1 s"),
        (0, "zero stamp: a message has none"),
        (NOW - 4_900_000_000, ""),
        (NOW + 900_000_000, ""),
    ],
)
def test_stamps_of_another_clock_are_told(bench, stamp, text):
    bench.send(stamp)
    status, _ = bench.report()
    assert (status.level, status.message) == ((WARN, text) if text else (OK, "1 answered"))


def test_a_node_without_its_clock_says_so_by_itself(lab):
    lab.begin({"scene": "reference", "use_sim_time": True}, any_stamp=False)
    node = lab.start(FeatureNode, reports=True)
    status = lab.until(lambda: lab.statuses, "a report")[0]
    assert (status.name, status.level) == (node.get_name(), WARN)
    assert status.message == "no clock: use_sim_time is true, and no /clock has come yet"


def test_the_rate_is_that_of_the_last_five_periods(clock, bench):
    stamps = iter(range(NOW, 2 * NOW, 10**6))
    for step, answers in enumerate((10, 4, 4, 4, 4, 4, 0)):
        clock.now_s += 1.0
        bench.send(*(next(stamps) for _ in range(answers)))
        _, values = bench.report()
        if step == 0:
            assert float(values["Actual frequency (Hz)"]) == pytest.approx(10)
    # Seven periods of a second: in the last five of them there were 4, 4, 4, 4 and 0.
    assert float(values["Actual frequency (Hz)"]) == pytest.approx(16 / 5)
    assert (values["Events in window"], values["Events since startup"]) == ("16", "30")
    assert float(values["Duration of window (s)"]) == pytest.approx(5)


def test_refusals_are_counted_by_their_kind_since_the_start(bench):
    bench.send(NOW, NOW, NOW)
    bench.send(NOW + 1, image=np.zeros((5, 5)))
    status, values = bench.report()
    assert status.level == WARN
    assert "stamp not later" in status.message
    assert "no light" in status.message
    assert (values["refused: stamp not later"], values["refused: no light"]) == ("2", "1")
    assert "clock that was set back" in values["cure: stamp not later"]
    bench.send(NOW + 2)
    status, values = bench.report()
    assert (status.level, values["refused"], values["refused: no light"]) == (OK, "3", "1")
    assert not any(key.startswith("cure") for key in values)


def test_without_input_the_node_warns_and_never_says_stale(clock, bench):
    bench.send(NOW)
    for passed_s in (2.0, 7.5):
        clock.now_s += passed_s
        status, values = bench.report()
    assert (status.level, status.message) == (WARN, "no input: nothing came for 7.5 s")
    assert "ros2 topic hz" in values["cure: no input"]


def test_a_failure_is_an_error_whatever_else_there_is(bench):
    bench.node.diagnostics.fail("table /nowhere: no table there")
    bench.send(NOW, NOW)
    status, values = bench.report()
    assert (status.level, status.message) == (ERROR, "table /nowhere: no table there")
    assert "uuv_array table" in values["cure: table"]


def test_a_failure_that_is_found_again_and_again_is_logged_once(bench):
    gone = "table /nowhere: no table there"
    for reason in (gone, gone, "", gone, "table /last: no table there"):
        bench.node.diagnostics.fail(reason)
    assert [line.msg for line in bench.lab.logged("/last")].count(gone) == 2


@pytest.mark.parametrize(
    ("namespace", "hardware"), [(None, "uuv_optical_array"), ("/fleet/rov_2", "fleet/rov_2")]
)
def test_the_hardware_is_named_by_the_namespace(lab, namespace, hardware):
    bench = Bench(lab, namespace)
    bench.send(NOW)
    status, _ = bench.report()
    assert status.hardware_id == hardware
    assert status.name == f"{namespace or ''}/feature_node".lstrip("/")


def test_a_figure_that_there_is_not_is_not_shown():
    estimate = Estimate(np.zeros(5), np.eye(5), 0.1, None, 0.2, misfit=0.5)
    shown = figures(estimate)
    assert shown["misfit"] == "0.5"
    assert "nan" not in shown.values()


def test_the_light_is_told_as_a_share_of_full_scale(bench):
    image = np.full((5, 5), 341.0)
    image[0, :3] = 1023
    bench.send(NOW, image=image)
    _, values = bench.report()
    assert (values["light_level"], values["saturated_share"]) == ("1.000", "0.120")
    bench.send(NOW + 1, image=np.minimum(image, 341) - np.eye(5))
    _, values = bench.report()
    assert (values["light_level"], values["saturated_share"]) == ("0.333", "0.000")


def test_all_that_lasts_is_told_each_with_its_cure_until_it_is_over(bench):
    bench.node.diagnostics.warn("faulty detector: row 1 column 3", "", "mismatch: lamp.power")
    status, values = bench.report()
    assert status.level == WARN
    assert status.message == "faulty detector: row 1 column 3; mismatch: lamp.power"
    assert {"cure: faulty detector", "cure: mismatch"} <= values.keys()
    bench.node.diagnostics.warn("", "mismatch: lamp.power")
    status, values = bench.report()
    assert status.message == "mismatch: lamp.power"
    assert "cure: faulty detector" not in values


def stranger(lab, message_type, topic):
    """Return another node that publishes on a topic."""
    node = rclpy.create_node("stranger", namespace="/far", use_global_arguments=False)
    lab.executor.add_node(node)
    lab.nodes.append(node)
    node.create_publisher(message_type, topic, 1)
    return node


@pytest.mark.parametrize(
    ("node_type", "message_type", "topic", "other"),
    [
        (FeatureNode, Image, "/array/image", "/probe"),  # both are others than the node
        (FeatureNode, PointCloud2, "/array/features", "/feature_node"),
        (FormationNode, TwistStamped, "/cmd_vel", "/formation_node"),
        (VehiclesNode, Odometry, "/leader/odometry", "/vehicles_node"),
    ],
)
def test_the_diagnostics_name_both_until_one_is_gone(lab, node_type, message_type, topic, other):
    lab.begin()
    node = lab.start(node_type)
    if other == "/probe":
        lab.talk(message_type, topic)
    lab.until(lambda: node.count_publishers(topic) == 1, "the first publisher")
    node.diagnostics.warn("")  # of a leader that waits
    lab.report(node, WARN, "no input")
    second = stranger(lab, message_type, topic)
    words = f"several publishers: {topic} of", "/far/stranger", other, "ROS_DOMAIN_ID"
    lab.report(node, WARN, *words)
    lab.logged(words[0])
    lab.executor.remove_node(second)
    lab.nodes.remove(second)
    second.destroy_node()
    lab.report(node, WARN, "no input")
