"""From image in to pose out, beside a bare rclpy relay: ``python benchmarks/latency.py``.

Blocks of images go to the follower's nodes and to a relay that answers each image with a ready-made
pose, in turn, so that a noisy machine slows both; their medians are compared. The images come from
the process that hears the answers, in the thread of its executor; follower and relay are in the
same one, or together in another. `frame` is the time from answer to answer while images come, and
`late` the age of which one pose of a hundred is older, in frame times; `passed` are images that got
no pose. The last three columns are the time that steps before the pose take in one process: the
fit, all of the estimate, and the track as far as the pose waits for it.
"""

import argparse
import gc
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from course import as_programs, exposures, serve, served, write_scene
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import Image

from uuv_optical_array.core.messages import stamp_ns
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.image_fit import ImageFit
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.nodes.follower_node import follower
from uuv_optical_array.nodes.shared.node import fastest_executor, spin, start

ASKED = {"follower": ("array/image", "relative_pose"), "relay": ("relay/image", "relay/pose")}
COLUMNS = ("proc.", "side", "Hz", "relay", "99 %", "pose", "99 %", "ratio", "poses", "passed")
COLUMNS += ("frame", "late", "fit", "estimate", "track")
BLOCK_S = 0.2
PATIENCE_S = 3.0  # for the answer to the last image of a block


class Relay(Node):
    """Answer an image with a ready-made pose."""

    def __init__(self) -> None:
        super().__init__("relay")
        self.pose = PoseWithCovarianceStamped()
        image, pose = ASKED["relay"]
        self.poses = self.create_publisher(PoseWithCovarianceStamped, pose, 10)
        self.create_subscription(Image, image, self.on_image, qos_profile_sensor_data)

    def on_image(self, message: Image) -> None:
        self.pose.header = message.header
        self.poses.publish(self.pose)


class Asker(Node):
    """Send images and take the time until their answers."""

    def __init__(self) -> None:
        super().__init__("asker")
        self.sent: dict[tuple[str, int], float] = {}
        self.heard: set[tuple[str, int]] = set()
        self.times: dict[str, list[float]] = {name: [] for name in ASKED}
        self.talkers, self.ears = {}, []
        for name, (image, pose) in ASKED.items():
            self.talkers[name] = self.create_publisher(Image, image, QoSProfile(depth=10))
            self.ears.append(
                self.create_subscription(
                    PoseWithCovarianceStamped, pose, self.taker(name), qos_profile_sensor_data
                )
            )

    def taker(self, name: str) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            heard = time.perf_counter()
            asked = name, stamp_ns(message.header)
            self.times[name].append(heard - self.sent[asked])
            self.heard.add(asked)

        return take

    def connected(self) -> bool:
        return all(talker.get_subscription_count() for talker in self.talkers.values()) and all(
            ear.handle.get_publisher_count() for ear in self.ears
        )

    def send(self, messages: list[Image], rate_hz: float) -> Iterator[float]:
        """Send images at a rate, as many blocks to the follower as to the relay.

        Yields until when callbacks are to be served.
        """
        length, due = max(2, round(BLOCK_S * rate_hz)), time.perf_counter()
        for first in range(0, len(messages), length):
            for name, talker in self.talkers.items():
                for message in messages[first : first + length]:
                    due += 1 / rate_hz
                    yield due
                    self.sent[name, stamp_ns(message.header)] = time.perf_counter()
                    talker.publish(message)
                # The newest is answered last; what is in work would hold up the next block.
                last = name, stamp_ns(message.header)
                until = time.perf_counter() + PATIENCE_S
                while last not in self.heard and (due := time.perf_counter()) < until:
                    yield due + 0.005


def watched(owner: Any, name: str, spent: dict[str, list[float]], stage: str) -> None:
    """Take the time of each call of an attribute."""
    call, times = getattr(owner, name), spent.setdefault(stage, [])

    def timed(*given: Any, **named: Any) -> Any:
        before = time.perf_counter()
        try:
            return call(*given, **named)
        finally:
            times.append(time.perf_counter() - before)

    setattr(owner, name, timed)


def measure(args: argparse.Namespace, apart: bool, method: str, side: int) -> None:
    """Print a line for each rate."""
    rng = np.random.default_rng(1)
    spent: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        scene, path = write_scene(Path(folder), side)
        arguments = ["-p", f"scene:={path}", "-p", f"estimator_node:method:={method}"]
        process = served(__file__, arguments) if apart else None
        start(["--ros-args", *arguments])
        asker, executor = Asker(), fastest_executor()
        nodes: list[Any] = [asker]
        if not apart:
            originals = ImageFit.__call__, Estimator.estimate, Tracker.take
            watched(ImageFit, "__call__", spent, "fit")
            watched(Estimator, "estimate", spent, "estimate")
            watched(Tracker, "take", spent, "track")
            feature, estimator, formation = follower()
            nodes += [Relay(), feature, estimator, formation]
        for node in nodes:
            executor.add_node(node)
        spin(executor, lambda: not asker.connected())
        if not apart:
            estimator.pipeline.estimator.wait()
        gc.freeze()  # as the programs do
        begun_ns = 10**9
        for rate_hz in args.rates:
            count = round(args.seconds * rate_hz)
            stamps = [begun_ns + round(i * 1e9 / rate_hz) for i in range(count)]
            begun_ns = stamps[-1] + 10**8
            messages = exposures(scene, stamps, rng)
            for times in (*asker.times.values(), *spent.values()):
                times.clear()
            for until in asker.send(messages, rate_hz):
                while (left := until - time.perf_counter()) > 0:
                    executor.spin_once(timeout_sec=left)
            line(apart, side, rate_hz, count, asker.times, spent)
        if not apart:
            ImageFit.__call__, Estimator.estimate, Tracker.take = originals
        rclpy.try_shutdown()
        if process is not None:
            process.send_signal(signal.SIGINT)
            process.wait()


def line(
    apart: bool,
    side: int,
    rate_hz: float,
    count: int,
    times: dict[str, list[float]],
    spent: dict[str, list[float]],
) -> None:
    """Print one line; times in ms."""
    first = 2 if apart else 1
    ages = {name: [age * 1e3 for age in answers] for name, answers in times.items()}
    if min(map(len, ages.values())) < 5:
        print(f"{first:8} {side:8} {rate_hz:8g}  too few answers", flush=True)
        return
    (relay, late_relay), (pose, late_pose) = (
        np.quantile(ages[name], [0.5, 0.99]) for name in ("relay", "follower")
    )
    figures = [relay, late_relay, pose, late_pose, pose / relay]
    cells = [f"{first}", f"{side}", f"{rate_hz:g}", *(f"{each:.2f}" for each in figures)]
    poses = len(ages["follower"])
    frame_ms = 1e3 / rate_hz * count / poses
    cells += [f"{poses}", f"{count - poses}", f"{frame_ms:.2f}"]
    cells += [f"{late_pose / frame_ms:.2f}"]
    cells += [f"{statistics.median(each) * 1e3:.2f}" for each in spent.values() if each]
    print(" ".join(f"{cell:>8}" for cell in cells), flush=True)


def table(args: argparse.Namespace) -> None:
    """Print the table of each method."""
    for method in args.methods:
        print(f"{method}, times in ms, 'late' in frame times")
        print(" ".join(f"{name:>8}" for name in COLUMNS))
        for processes in args.processes:
            for side in args.sides:
                measure(args, processes == 2, method, side)


def main() -> None:
    """Run from the command line."""
    as_programs()
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--rates", type=float, nargs="+", default=[10, 100, 500])
    parser.add_argument("--sides", type=int, nargs="+", default=[5, 21])
    parser.add_argument("--methods", nargs="+", default=["least_squares", "sam_interpolated"])
    parser.add_argument("--processes", type=int, nargs="+", choices=(1, 2), default=[1, 2])
    parser.add_argument("--seconds", type=float, default=5.0, help="of images, for each rate")
    args = parser.parse_args()
    table(args)


if __name__ == "__main__":
    if "--serve" in sys.argv[1:2]:
        serve(sys.argv[2:], (Relay,))
    else:
        main()
