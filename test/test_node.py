"""What all nodes share: a lean import, and an end by signal between two callbacks."""

import os
import signal
import subprocess
import sys

import pytest
import rclpy
from conftest import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from uuv_optical_array.nodes.shared.node import spin, start


@pytest.fixture
def executor():
    """Return an executor of a context that the test started as a node does."""
    usual = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    start([])
    yield SingleThreadedExecutor()
    rclpy.try_shutdown()
    for number, handler in usual.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
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


# Each takes a good part of a second to import, and no node needs it before its first frame.
HEAVY = ("matplotlib", "numba", "scipy.stats")
NODES = [
    "simulator",
    "feature",
    "estimator",
    "formation",
    "follower",
    "vehicles",
]


@pytest.mark.parametrize("node", NODES)
def test_importing_a_node_imports_nothing_heavy(node):
    program = (
        f"import sys, uuv_optical_array.nodes.{node}_node\n"
        f"print(*(name for name in {HEAVY} if name in sys.modules))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    assert ran.stdout.split() == []
