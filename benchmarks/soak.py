"""The follower's nodes under load and faults: ``python benchmarks/soak.py``.

They run in a process of their own, on simulated time, and every pose that they publish is compared
with the truth of its stamp: one as improbable as six standard deviations of a Gaussian number is
false. First come frames as fast as they are answered, with the memory that the process takes; then
the faults, each between stretches of good frames at the rate of an array; the nodes are stopped for
10 s at most. Full run: a million frames, some hours. ``--frames 5000`` ends in a minute or two. The
exit code is 1 where a pose is false or the poses are not back within a second of a fault's end.
"""

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from course import as_programs, exposures, pose_at, serve, served, stamp_of, write_scene
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from scipy.special import chdtri, ndtr
from sensor_msgs.msg import Image

from uuv_optical_array.core.geometry import covariance_5x5, wrapped
from uuv_optical_array.core.messages import stamp_ns
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.nodes.shared.messages import covariance_from_message, pose_from_message
from uuv_optical_array.nodes.shared.node import fastest_executor, start

RATE_HZ = 20.0
FALSE = float(chdtri(5, 2 * ndtr(-6.0)))  # of the squared Mahalanobis distance
BLOCK = 200  # images drawn at once
KEPT = 10_000  # stamps whose truth is remembered
JUMP_NS = 30 * 10**9
BACK_S = 1.0
# What DDS has not heard of for 20 s it gives up, and finds anew only seconds after it is back.
LONGEST_STOP_S = 10.0

Fault = Callable[[Image], list[Image]]


class Sea(Node):
    """Send images of the course and compare what comes back with the truth."""

    def __init__(self, scene: Scene, rng: np.random.Generator) -> None:
        super().__init__("sea", use_global_arguments=False)
        self.scene, self.rng = scene, rng
        self.now_ns, self.offset_ns = 10**12, 0
        self.truth: dict[int, np.ndarray] = {}
        self.sent = self.poses = self.false = 0
        self.worst, self.heard_at, self.passed_over = 0.0, 0.0, 0
        self.newest_heard = -1
        self.frames = self.drawn()
        self.images = self.create_publisher(Image, "array/image", QoSProfile(depth=100))
        self.clock = self.create_publisher(Clock, "/clock", 10)
        for kind, topic in (
            (PoseWithCovarianceStamped, "relative_pose"),
            (Odometry, "relative_odometry"),
        ):
            self.create_subscription(kind, topic, self.compare, 100)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.read, 10)

    def drawn(self) -> Iterator[tuple[Image, np.ndarray]]:
        """Yield an image of the course after another, with its pose."""
        while True:
            stamps = [self.now_ns + round(i * 1e9 / RATE_HZ) for i in range(BLOCK)]
            self.now_ns = stamps[-1] + round(1e9 / RATE_HZ)
            poses = pose_at(np.array(stamps) * 1e-9)
            yield from zip(exposures(self.scene, stamps, self.rng), poses, strict=True)

    def send(self, fault: Fault = lambda image: [image]) -> int:
        """Send the next image, as a fault lets it through; return its stamp, ns."""
        image, pose = next(self.frames)
        # The clock may jump, while the vehicles go on as before.
        stamp = stamp_ns(image.header) + self.offset_ns
        image.header.stamp = stamp_of(stamp)
        self.truth[stamp] = pose
        if len(self.truth) > KEPT:
            del self.truth[next(iter(self.truth))]
        self.clock.publish(Clock(clock=image.header.stamp))
        for each in fault(image):
            self.images.publish(each)
            self.sent += 1
        return stamp

    def compare(self, message: Any) -> None:
        """Compare a pose with the truth."""
        pose = pose_from_message(message)
        stamp = stamp_ns(message.header)
        off = wrapped(pose - self.truth[stamp])
        covariance = covariance_5x5(pose, covariance_from_message(message))
        square = float(off @ np.linalg.solve(covariance, off))
        self.worst = max(self.worst, square)
        self.false += square > FALSE
        if isinstance(message, PoseWithCovarianceStamped):
            self.poses += 1
            self.heard_at, self.newest_heard = time.monotonic(), stamp

    def read(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for pair in status.values:
                if pair.key == "passed_over":
                    self.passed_over = int(pair.value)


def resident_mb(pid: int) -> float:
    """Return the memory that a process has, MB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * 4096 / 1e6


class Soak:
    """A sea, its follower in another process, and the outcome."""

    def __init__(self, sea: Sea, process: "subprocess.Popen[str]") -> None:
        self.sea, self.process = sea, process
        self.executor = fastest_executor()
        self.executor.add_node(sea)
        self.good = True

    def serve_until(self, until: float) -> None:
        while (left := until - time.monotonic()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def connect(self) -> None:
        """Send until a pose comes."""
        while not self.sea.poses:
            self.sea.send()
            self.serve_until(time.monotonic() + 0.1)

    def at_top_speed(self, frames: int) -> None:
        """Send frames as they are answered, and print memory and false poses."""
        print("frames     frames/s     memory, MB   false")
        step, begun = max(frames // 10, 1), time.monotonic()
        lost = 0
        for i in range(1, frames + 1):
            stamp, until = self.sea.send(), time.monotonic() + 1.0
            while self.sea.newest_heard != stamp and time.monotonic() < until:
                self.executor.spin_once(timeout_sec=0.01)
            lost += self.sea.newest_heard != stamp
            if i % step == 0:
                rate = i / (time.monotonic() - begun)
                memory = resident_mb(self.process.pid)
                print(f"{i:8} {rate:10.0f} {memory:12.1f} {self.sea.false:8}", flush=True)
        print(f"without a pose {lost}")
        self.good &= self.sea.false == 0

    def at_rate(self, seconds: float, fault: Fault = lambda image: [image]) -> None:
        due = time.monotonic()
        for _ in range(round(seconds * RATE_HZ)):
            self.sea.send(fault)
            due += 1 / RATE_HZ
            self.serve_until(due)

    def under(self, name: str, seconds: float, fault: "Callable[[Soak, float], None]") -> None:
        """Send good frames, a fault, and good frames again; print what came of it."""
        sea = self.sea
        self.at_rate(2.0)
        sea.sent = sea.poses = sea.false = 0
        sea.worst = 0.0
        before = sea.passed_over
        fault(self, seconds)
        ended, heard = time.monotonic(), sea.poses
        back = float("inf")
        while back == float("inf") and time.monotonic() < ended + 10:
            self.at_rate(1 / RATE_HZ)
            if sea.poses > heard:
                back = sea.heard_at - ended
        self.at_rate(2.0)
        self.good &= sea.false == 0 and back < BACK_S
        print(
            f"{name:12} {sea.sent:6} {sea.poses:6} {sea.passed_over - before:12} {sea.false:6}"
            f" {np.sqrt(sea.worst):10.2f} {back:8.2f}",
            flush=True,
        )


def loss(soak: Soak, seconds: float) -> None:
    rng = soak.sea.rng
    soak.at_rate(seconds, lambda image: [] if rng.random() < 0.3 else [image])


def duplicates(soak: Soak, seconds: float) -> None:
    soak.at_rate(seconds, lambda image: [image, image])


def reordering(soak: Soak, seconds: float) -> None:
    held: list[Image] = []

    def shuffled(image: Image) -> list[Image]:
        held.append(image)
        if len(held) < 4:
            return []
        out = [held[i] for i in soak.sea.rng.permutation(4)]
        held.clear()
        return out

    soak.at_rate(seconds, shuffled)


def clock_jumps(soak: Soak, seconds: float) -> None:
    for i in range(max(2, round(seconds))):
        soak.sea.offset_ns += JUMP_NS if i % 2 else -JUMP_NS
        soak.at_rate(1.0)


def stopped(soak: Soak, seconds: float) -> None:
    soak.process.send_signal(signal.SIGSTOP)
    try:
        soak.at_rate(min(seconds, LONGEST_STOP_S))
    finally:
        soak.process.send_signal(signal.SIGCONT)


def busy(soak: Soak, seconds: float) -> None:
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        soak.at_rate(seconds)
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


FAULTS = {
    "30 % lost": loss,
    "duplicates": duplicates,
    "reordering": reordering,
    "clock jumps": clock_jumps,
    "SIGSTOP": stopped,
    "busy loops": busy,
}


def main() -> int:
    """Run all and return the exit code."""
    as_programs()
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--frames", type=int, default=1_000_000, help="at top speed")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each fault")
    parser.add_argument("--method", default="least_squares")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scene, path = write_scene(Path(folder), 5)
        arguments = ["-p", f"scene:={path}", "-p", f"estimator_node:method:={options.method}"]
        process = served(__file__, [*arguments, "-p", "use_sim_time:=true"])
        start([])
        soak = Soak(Sea(scene, np.random.default_rng(1)), process)
        try:
            soak.connect()
            soak.at_top_speed(options.frames)
            print("fault          sent  poses  passed over  false  worst, std  back, s")
            for name, fault in FAULTS.items():
                soak.under(name, options.seconds, fault)
        finally:
            process.send_signal(signal.SIGINT)
            print(f"the nodes ended with {process.wait(30)}")
            rclpy.try_shutdown()
    return 0 if soak.good else 1


if __name__ == "__main__":
    if "--serve" in sys.argv[1:2]:
        serve(sys.argv[2:])
    else:
        sys.exit(main())
