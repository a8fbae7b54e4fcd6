"""What all nodes share: a lean import, and an end by signal between two callbacks."""

import gc
import os
import signal
import time
from types import SimpleNamespace

import pytest
import rclpy
from conftest import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import UInt8

from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.node import publish, run, spin, start, subscribe

ENDING = signal.SIGINT, signal.SIGTERM


@pytest.fixture
def executor():
    """Return an executor of a context that the test started as a node does."""
    usual = {number: signal.getsignal(number) for number in ENDING}
    start([])
    yield SingleThreadedExecutor()
    rclpy.try_shutdown()
    for number, handler in usual.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_in_a_callback_waits_for_its_end(executor, number):
    begun, ended = [], []
    node = Node("node", use_global_arguments=False)

    def callback():
        begun.append(1)
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)  # as launch sends it once more
        ended.append(node.get_clock().now())

    node.create_timer(0.001, callback)
    executor.add_node(node)
    spin(executor)
    assert len(begun) == len(ended) == 1
    assert signal.getsignal(number) is not signal.default_int_handler


def test_a_callback_that_does_not_end_is_broken_off_after_a_signal(executor):
    node, broken_off = Node("node", use_global_arguments=False), []

    def callback():
        os.kill(os.getpid(), signal.SIGINT)
        until = time.monotonic() + PATIENCE_S
        try:
            while time.monotonic() < until:
                pass
        except KeyboardInterrupt:
            broken_off.append(1)
            raise

    node.create_timer(0.001, callback)
    executor.add_node(node)
    assert spin(executor)
    assert broken_off == [1]


def test_what_is_broken_off_is_no_fault_of_its_message(capfd):
    """As the fit of an image by NumPy, amid which a node is stopped, under the node's executor."""

    class Slow(Node):
        def __init__(self):
            super().__init__("slow")
            self.diagnostics = Diagnostics(self)
            self.create_timer(0.001, self.callback)

        def callback(self):
            with self.diagnostics.refusing():
                os.kill(os.getpid(), signal.SIGINT)
                until = time.monotonic() + PATIENCE_S
                while time.monotonic() < until:
                    pass
                ended.append(1)

    ended, usual = [], [signal.getsignal(number) for number in ENDING]
    run(Slow)
    for number, handler in zip(ENDING, usual, strict=True):
        signal.signal(number, handler)
    assert not ended
    assert capfd.readouterr() == ("", "")


def test_what_is_no_longer_wanted_ends_and_signals_are_as_before(executor):
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    served = []
    node = Node("node", use_global_arguments=False)
    node.create_timer(0.001, lambda: served.append(1))
    executor.add_node(node)
    spin(executor, lambda: len(served) < 3)
    assert len(served) == 3
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def test_a_shutdown_from_elsewhere_ends_the_spin(executor):
    node = Node("node", use_global_arguments=False)
    node.create_timer(0.001, rclpy.try_shutdown)
    executor.add_node(node)
    spin(executor)
    assert not rclpy.ok()


def test_between_two_messages_others_have_their_turn_and_the_newest_is_next(executor):
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        pytest.skip("this rclpy has no events executor, whose queue is tested")
    executor = EventsExecutor()
    node = Node("node", use_global_arguments=False)
    while_served, passed_over, done = {1: (2, 3, 4, 5, 6), 6: (7, 8)}, [], []
    node.diagnostics = SimpleNamespace(pass_over=passed_over.append, watch=lambda topic: None)

    def serve(message):
        done.append((message.data, passed_over[-1]))
        answers.publish(message)
        for number in while_served.get(message.data, ()):
            images.publish(UInt8(data=number))

    images, answers = (node.create_publisher(UInt8, name, 10) for name in ("images", "answers"))
    subscribe(node, UInt8, "images", serve, newest=True)
    node.create_subscription(UInt8, "answers", lambda message: done.append(message.data), 10)
    executor.add_node(node)
    spin(executor, lambda: images.get_subscription_count() + answers.get_subscription_count() < 2)
    images.publish(UInt8(data=1))
    spin(executor, lambda: len(done) < 6)
    executor.shutdown()
    node.destroy_node()
    assert done == [(1, 0), 1, (6, 4), 6, (8, 1), 8]


def test_a_quality_of_service_is_overridden_for_its_own_topic_alone(executor):
    given = {"a.subscription.reliability": "reliable", "a.publisher.depth": 7}
    overrides = [Parameter(f"qos_overrides./{name}", value=given[name]) for name in given]
    node = Node("node", use_global_arguments=False, parameter_overrides=overrides)
    node.diagnostics = SimpleNamespace(watch=lambda topic: None)
    for topic in "ab":
        publish(node, UInt8, topic)
        subscribe(node, UInt8, topic, print)
    depths = {end.topic_name: end.qos_profile.depth for end in node.publishers}
    assert (depths["/a"], depths["/b"]) == (7, 10)
    reliable = {end.topic_name: end.qos_profile.reliability for end in node.subscriptions}
    assert reliable["/a"] == ReliabilityPolicy.RELIABLE
    assert reliable["/b"] == ReliabilityPolicy.BEST_EFFORT
    node.destroy_node()


def test_the_collector_does_not_look_through_what_a_node_was_made_of():
    frozen = []

    class Ending(Node):
        def __init__(self):
            super().__init__("ending")
            self.create_timer(0.001, self.end)

        def end(self):
            frozen.append(gc.get_freeze_count())
            rclpy.try_shutdown()

    run(Ending)
    gc.unfreeze()
    assert frozen[0] > 10_000


def test_a_node_that_ros_does_not_make_names_the_enclave_where_ros_is_secured(monkeypatch):
    def refused():
        raise RuntimeError("failed to create service")  # as rclpy does

    with pytest.raises(RuntimeError, match=r"^failed to create service$"):
        run(refused)

    def refused_for_security():
        monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
        refused()

    with pytest.raises(SystemExit, match=r"^failed to create service: the enclave has to allow"):
        run(refused_for_security)
