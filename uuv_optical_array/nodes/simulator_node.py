"""From the odometry of both vehicles, and of others, to the image of the detector array.

The sea is drawn from the scene's prior, once at the start, so that it differs from what the
estimator believes as much as the prior says that a sea may.
"""

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Pose
from nav_msgs.msg import Odometry
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image, Range
from std_msgs.msg import Header

from uuv_optical_array.control.vehicles.trajectory import TooEarly, Trajectory
from uuv_optical_array.core.geometry import Array, relative_pose
from uuv_optical_array.core.messages import Refused, as_wired, odometry_pose, stamp_ns
from uuv_optical_array.core.settings import Place, Quantity
from uuv_optical_array.estimation.tracking.motion import LONG_AGO_NS
from uuv_optical_array.forward.drawn_sea import DrawnSea, draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.others import Other, sight
from uuv_optical_array.forward.prior import LAMP_POWER, power_offsets
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.shared import messages
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.node import publish, run, subscribe, transform_publisher
from uuv_optical_array.nodes.shared.parameters import (
    Parameter,
    Parameters,
    checked_topic,
    shared,
)

PARAMETERS = {
    **shared(
        "scene", "frame_prefix", "beacon_position_m", "odometry_axes", "max_gap_s", "publish_tf"
    ),
    "lamp_power": Parameter([1.0], LAMP_POWER, any_length=True),
    "others": Parameter(
        "", Quantity("odometry topics of other vehicles, separated by spaces; empty: none"), True
    ),
    "code_by_vehicle": Parameter(
        True,
        Quantity(
            "give other vehicles' lamps codes of their own, which demodulation by square or sine "
            "separates"
        ),
        True,
    ),
    "range_std_m": Parameter(
        0.0,
        Quantity("standard deviation of the simulated range to the lamp; 0: no range", "m", 0, 100),
    ),
    "range_rate_hz": Parameter(
        1.0, Quantity("rate of the simulated ranges, at most one with each image", "Hz", 0.01, 1000)
    ),
    "draw_sea": Parameter(
        True,
        Quantity("draw the sea from the scene's prior; false: it is exactly the scene's"),
        True,
    ),
    "seed": Parameter(
        -1, Quantity("seed of noise and sea; -1: a new one at each start", "", -1, 2**31 - 1), True
    ),
    "array_frame": Parameter(
        "", Quantity("frame of the image; empty: `array` beside the follower's base_link"), True
    ),
}
SEEDS = 2**31
WAITING = 50  # follower poses kept until the leader's odometry catches up


class SimulatorNode(Node):
    """Publish what the array would read at each pose of the follower; options as of `Node`.

    `hand_over` takes header and true pose, m and rad, shape ``(5,)``, of each published image.
    """

    def __init__(
        self, hand_over: Callable[[Header, Array], None] | None = None, **options: Any
    ) -> None:
        super().__init__("simulator_node", **options)
        self.hand_over = hand_over
        self.parameters = Parameters(self, PARAMETERS, self.on_change)
        self.scene = scene = load_scene(self.parameters["scene"])
        if "adc" not in scene.effects:
            raise ValueError(
                f"scene {scene.name}: array/image is mono16, so the scene needs "
                "effects.adc, with bits from 1 to 16"
            )
        self.model = ForwardModel(scene)
        self.on_change({"lamp_power": self.parameters["lamp_power"]})
        self.ranged_ns = LONG_AGO_NS  # stamp of the last range
        seed = self.parameters["seed"]
        if seed < 0:
            seed = int(np.random.default_rng().integers(SEEDS))
        self.rng = np.random.default_rng(seed)
        self.sea = self.drawn_sea(seed)
        self.get_logger().info(f"sea: {self.sea_in_words}")
        self.leader = Trajectory(self.parameters["max_gap_s"])
        self.leader_frame, self.axes = "", self.parameters["odometry_axes"]
        self.others = {
            checked_topic("others", topic): Trajectory(self.parameters["max_gap_s"])
            for topic in self.parameters["others"].split()
        }
        self.waiting: deque[Odometry] = deque()
        self.order = messages.StampOrder()
        self.diagnostics = Diagnostics(self, lambda: {"sea": self.sea_in_words})
        self.images = publish(self, Image, "array/image")
        self.ranges = publish(self, Range, "range")
        self.place = transform_publisher(self, self.parameters["publish_tf"], fixed=True)
        self.placed = ""
        subscribe(self, Odometry, "leader/odometry", self.on_leader)
        subscribe(self, Odometry, "follower/odometry", self.on_follower)
        for other in self.others:
            subscribe(self, Odometry, other, partial(self.on_other, other))

    def drawn_sea(self, seed: int) -> DrawnSea | None:
        """Draw what differs from the scene, and put it in words; ``None``: nothing does."""
        exact = f"exactly that of scene {self.scene.name}, seed {seed}"
        self.sea_in_words = exact
        if not self.parameters["draw_sea"]:
            return None
        # Apart from the noise, which is the same in either sea.
        sea = draw_sea(self.scene, np.random.default_rng((seed, 1)))
        if not (words := sea.in_words(self.scene)):
            return None
        where = f"drawn from the prior of scene {self.scene.name}, seed {seed}"
        self.sea_in_words = f"{where}: {words}"
        return sea

    def on_change(self, changes: dict[str, Any]) -> None:
        """Take over a parameter that was set while the node runs."""
        if "lamp_power" in changes:
            self.powers = power_offsets(changes["lamp_power"], self.scene.lamp_count)

    def on_leader(self, message: Odometry) -> None:
        """Record the leader's pose and serve the follower poses that waited for it."""
        with self.diagnostics.refusing("leader/odometry"):
            self.leader.add(stamp_ns(message.header), *odometry_pose(message, self.axes))
            self.leader_frame = message.header.frame_id
        self.serve()

    def on_other(self, topic: str, message: Odometry) -> None:
        """Record another vehicle's pose."""
        with self.diagnostics.refusing(topic):
            self.check_frame(topic, message)
            self.others[topic].add(stamp_ns(message.header), *odometry_pose(message, self.axes))
        self.serve()

    def check_frame(self, topic: str, message: Odometry) -> None:
        """Refuse an odometry in another frame than the leader's."""
        if self.leader_frame and message.header.frame_id != self.leader_frame:
            raise Refused(
                f"frames differ: leader/odometry is in {self.leader_frame!r}, "
                f"{topic} in {message.header.frame_id!r}; both must share one"
            )

    def on_follower(self, message: Odometry) -> None:
        """Queue the follower's pose."""
        # Where the clock was set back, poses of the old time would wait for ever.
        now = stamp_ns(message.header)
        self.waiting = deque(old for old in self.waiting if stamp_ns(old.header) <= now)
        with self.diagnostics.refusing("follower/odometry"):
            self.order.check(message.header)
            odometry_pose(message, self.axes)
            self.waiting.append(message)
        self.serve()

    def serve(self) -> None:
        """Publish an image for every waiting pose whose instant the leader's record has reached."""
        while self.waiting:
            try:
                with self.diagnostics.refusing():
                    self.expose(self.waiting[0])
            except TooEarly:
                if len(self.waiting) <= WAITING:
                    return
                self.diagnostics.refuse(
                    f"no leader: leader/odometry is more than {WAITING} poses behind"
                )
            self.waiting.popleft()

    def expose(self, follower: Odometry) -> None:
        """Publish the image at one pose of the follower."""
        stamp = stamp_ns(follower.header)
        try:
            leader_position, leader_rotation = self.leader.at(stamp)
        except LookupError as reason:
            raise Refused(f"no leader pose at the follower's stamp: {reason}") from None
        self.check_frame("follower/odometry", follower)
        lamp_m = tuple(self.parameters["beacon_position_m"])
        leader = Other(leader_position, leader_rotation, lamp_m=lamp_m)
        others = self.others_at(stamp, lamp_m)
        position, quaternion = odometry_pose(follower, self.axes)
        rotation = Rotation.from_quat(quaternion).as_matrix()
        pose, _ = relative_pose(leader.beacon, leader_rotation, position, rotation)
        place, time_s = (position, rotation), stamp * 1e-9
        seen = sight(self.model, place, leader, others, self.powers, time_s, self.sea)
        image = self.model.read(seen.light, self.rng, seen.beside)
        place, slash, _ = follower.child_frame_id.rpartition("/")
        frame = self.parameters.frame("array_frame") or f"{place}{slash}array"
        header = Header(stamp=follower.header.stamp, frame_id=frame)
        self.place_array(follower, frame)
        self.measure_range(float(np.linalg.norm(pose[:3])), follower)
        wired = as_wired(image, self.scene.array.wiring)
        self.images.publish(messages.image_to_message(wired, header))
        if self.hand_over is not None:
            self.hand_over(header, pose)
        shown = {"peak_counts": f"{image.max():g}", "range_m": f"{-pose[0]:.2f}"}
        self.diagnostics.answer(stamp, lambda: shown)

    def measure_range(self, range_m: float, follower: Odometry) -> None:
        """Publish the distance from lamp to base_link, with noise, where the next one is due."""
        stamp, std = stamp_ns(follower.header), self.parameters["range_std_m"]
        due_ns = 0.999e9 / self.parameters["range_rate_hz"]  # stamps vary a little
        if std > 0 and abs(stamp - self.ranged_ns) >= due_ns:  # clocks are set back, too
            self.ranged_ns = stamp
            header = Header(stamp=follower.header.stamp, frame_id=follower.child_frame_id)
            measured = range_m + std * float(self.rng.standard_normal())
            self.ranges.publish(messages.range_to_message(measured, std, header))

    def others_at(self, stamp: int, lamp_m: Place) -> list[Other]:
        """Return the other vehicles at an instant, ns, and report those of which nothing is known.

        TooEarly where one is late, but not by more than the longest gap.
        """
        found, absent = [], []
        newest, gap_ns = stamp_ns(self.waiting[-1].header), self.parameters["max_gap_s"] * 1e9
        for code, (topic, trajectory) in enumerate(self.others.items(), start=1):
            try:
                position, rotation = trajectory.at(stamp)
            except TooEarly:
                last = trajectory.newest_ns
                if last is not None and newest - last <= gap_ns and len(self.waiting) <= WAITING:
                    raise
                absent.append(topic)
            except LookupError:
                absent.append(topic)
            else:
                told_apart = code if self.parameters["code_by_vehicle"] else 0
                found.append(Other(position, rotation, code=told_apart, lamp_m=lamp_m))
        missing = ", ".join(absent)
        self.diagnostics.warn(f"left out: no pose of {missing} at this instant" if absent else "")
        return found

    def place_array(self, follower: Odometry, frame: str) -> None:
        """Tell once where the array is on the follower: at its bow."""
        if self.placed != follower.child_frame_id:
            self.placed = follower.child_frame_id
            header = Header(stamp=follower.header.stamp, frame_id=follower.child_frame_id)
            bow = Pose()
            bow.position.x = self.model.scene.array.bow_m
            self.place(header, frame, bow)


main = partial(run, SimulatorNode)
