"""Nodes in processes of their own, which the tests reach over DDS alone."""

import contextlib
import signal
import subprocess
import sys
import time

import rclpy
from conftest import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor


class Probe:
    """A node of the test's own process, which is spun while something is waited for."""

    def __init__(self, name):
        self.node = rclpy.create_node(name)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)

    def wait_for(self, condition, what):
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, f"waited {PATIENCE_S:g} s for {what}"
            self.executor.spin_once(timeout_sec=0.1)


@contextlib.contextmanager
def node_processes(log, nodes, **parameters):
    """Run nodes with parameters, such as ``**{"estimator_node:method": "sam"}``.

    At the end each must stop by Ctrl-C, without an error; the file `log` has what they wrote.
    """
    arguments = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    programs = [f"from uuv_optical_array.nodes.{node} import main; main()" for node in nodes]
    with log.open("w") as file:
        processes = [
            subprocess.Popen(
                [sys.executable, "-c", code, "--ros-args", *arguments], stderr=file, stdout=file
            )
            for code in programs
        ]
        try:
            yield
        finally:
            for process in processes:
                process.send_signal(signal.SIGINT)
            codes = [process.wait(timeout=PATIENCE_S) for process in processes]
    text = log.read_text()
    print(text)
    assert codes == [0] * len(nodes), text
    assert "Traceback" not in text
