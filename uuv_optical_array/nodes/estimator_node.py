"""From the image, or its key parameters, to the follower's pose in the leader's beacon frame."""

import math
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Pose, PoseStamped, PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Image, Imu, PointCloud2, Range
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from uuv_optical_array.core.geometry import Array, covariance_6x6
from uuv_optical_array.core.messages import (
    FOLLOWER_FRAME,
    ROLL_STD_RAD,
    Refused,
    image_from_message,
    signs,
    stamp_ns,
    twist_from_message,
)
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.estimator import Estimate, Estimator, EstimatorSettings, Method
from uuv_optical_array.estimation.large_table import load_table
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.signature.features import FeatureSettings
from uuv_optical_array.estimation.signature.plausibility import check_image
from uuv_optical_array.estimation.signature_table import SignatureTable, grid_axes
from uuv_optical_array.estimation.tracking.ranges import LEAST_M, MAX_STD_M
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import RangeUse, Track, relative_odometry
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, load_scene
from uuv_optical_array.nodes.estimator.figures import (
    figures,
    figures_of_track,
    table_margin,
    words_of,
)
from uuv_optical_array.nodes.estimator.follower_roll import FollowerRoll
from uuv_optical_array.nodes.estimator.image_inputs import ImageInputs
from uuv_optical_array.nodes.shared import markers, messages
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.node import (
    LASTING,
    publish,
    run,
    subscribe,
    transform_publisher,
)
from uuv_optical_array.nodes.shared.parameters import Parameter, Parameters, parameters_of, shared
from uuv_optical_array.nodes.shared.rest import Rest

PARAMETERS = {
    **shared("scene", "frame_prefix", "base_frame", "beacon_position_m", "publish_tf"),
    "table": Parameter(
        "",
        Quantity("folder of the signature table; empty: the sam methods build it in memory"),
    ),
    **parameters_of(EstimatorSettings),
    "use_image": Parameter(
        True,
        Quantity("read array/image: least_squares needs it, the sam methods check a match by it"),
        True,
    ),
    **parameters_of(FeatureSettings),
    "use_imu": Parameter(False, Quantity("read the follower's roll from imu"), True),
    "max_imu_age_s": Parameter(
        0.2,
        Quantity(
            "time between an image and the last roll, beyond which the roll is less certain",
            "s",
            0.001,
            10,
        ),
    ),
    "roll_std_rad": Parameter(
        ROLL_STD_RAD,
        Quantity(
            "standard deviation of the roll, whether read from imu or taken as 0", "rad", 1e-6, 3
        ),
    ),
    "use_commands": Parameter(True, Quantity("read the follower's own motion from cmd_vel"), True),
    "use_range": Parameter(False, Quantity("read the distance to the lamp from range"), True),
    "range_std_m": Parameter(
        0.2,
        Quantity(
            "standard deviation of a range whose message has no variance", "m", LEAST_M, MAX_STD_M
        ),
    ),
    "tracking": Parameter(
        True,
        Quantity(
            "filter the poses of many images; by least_squares also learn the sea's constants"
        ),
    ),
    **parameters_of(TrackerSettings),
    **shared("beacon_frame"),
    "tf_child_frame": Parameter(
        FOLLOWER_FRAME,
        Quantity("frame of the follower in relative_odometry, and below beacon_frame on /tf"),
        True,
    ),
    "tf_parent": Parameter(
        "beacon",
        Quantity("on /tf: beacon_frame is parent of tf_child_frame, or base_frame of beacon_frame"),
        True,
        ("beacon", "base"),
    ),
    "leader_frame": Parameter(
        "leader/base_link",
        Quantity("frame that /tf_static ties beacon_frame to; empty: none"),
        True,
    ),
}
# What needs a new estimator, and what a new track.
OF_ESTIMATOR = {"table", *parameters_of(EstimatorSettings)}
OF_TRACKER = {"tracking", *parameters_of(TrackerSettings)}
FIT: Method = "least_squares"


class EstimatorNode(Node):
    """Publish a pose for each image that the scene can explain, and nothing else.

    ``least_squares`` subscribes to the image alone. The sam methods subscribe to the key parameters
    and, with ``use_image``, to the image, and answer when both of a stamp are there.

    `hand_over` takes each track after it is published; with it neither key parameters nor images
    come by topic: a node of the same process calls `on_image` where the node `fits`, else
    `on_features`, and ``rest.finish`` once the pose is heard.
    """

    def __init__(self, hand_over: Callable[[Odometry], None] | None = None, **options: Any) -> None:
        super().__init__("estimator_node", **options)
        self.hand_over = hand_over
        self.parameters = Parameters(self, PARAMETERS, self.on_change)
        self.below_base = self.parameters["tf_parent"] == "base"
        self.beacon_frame, self.base_frame, child_frame = map(
            self.parameters.frame, ("beacon_frame", "base_frame", "tf_child_frame")
        )
        self.child_frame = messages.body_beside(self.beacon_frame, child_frame)
        self.check(self.parameters["method"])
        self.scene = load_scene(self.parameters["scene"])
        self.model = ForwardModel(self.scene)
        self.extent = np.transpose([(axis[0], axis[-1]) for axis in grid_axes(self.scene.table)])
        self.order, self.range_order = messages.StampOrder(), messages.StampOrder()
        self.shift_ns = 0  # to the stamps of the track, of which none is between two clocks
        self.range_ns = 0  # stamp of the last range that the track refused
        # Of the last frame, once its pose is out.
        self.rest = Rest(self if hand_over is None else None)
        self.diagnostics = Diagnostics(self, self.state)
        self.fits: bool | None = None  # whether images are answered by themselves; None: not yet
        images, refuse = self.parameters["use_image"], self.diagnostics.refuse
        self.inputs = ImageInputs(self, images, self.on_message, self.unpack, refuse)
        self.state_of_fit = ""
        self.roll = FollowerRoll(by_imu=self.parameters["use_imu"])
        self.source: Scene | SignatureTable = self.scene  # of the next estimator
        self.pipeline: Pipeline | None = None  # none while its table cannot be read
        self.poses = publish(self, PoseWithCovarianceStamped, "relative_pose")
        self.tracks = publish(self, Odometry, "relative_odometry")
        self.leaders = publish(self, PoseStamped, "leader_pose")
        self.send_transform = transform_publisher(self, self.parameters["publish_tf"])
        self.place_beacon()
        beam = markers.beam(self.scene, self.beacon_frame, -self.extent[0][0])
        body = markers.body(self.scene, self.base_frame if self.below_base else self.child_frame)
        shapes = markers.Shapes(self, publish(self, MarkerArray, "markers", LASTING))
        shapes.show(beam + body)
        self.listen(self.parameters["method"])
        if self.parameters["use_imu"]:
            subscribe(self, Imu, "imu", self.on_imu)
        if self.parameters["use_commands"]:
            subscribe(self, TwistStamped, "cmd_vel", self.on_command)
        if self.parameters["use_range"]:
            subscribe(self, Range, "range", self.on_range)
        # Last, as the middleware meanwhile finds who is at the other end of the topics.
        try:
            self.on_change({"table": self.parameters["table"]})
        except (ValueError, OSError) as reason:
            self.diagnostics.fail(str(reason))

    def check(self, method: str) -> None:
        """Raise ValueError for a method that lacks its input, and for axes that do not agree."""
        bodies = {"tf_child_frame": self.child_frame}
        if self.below_base:
            bodies["base_frame"] = self.base_frame
        for name, frame in bodies.items():
            if (signs(frame) != signs(self.beacon_frame)).any():
                raise ValueError(
                    f"{name}: {frame} does not have the axes of beacon_frame "
                    f"{self.beacon_frame}; let both names end in _ned or _frd, or neither"
                )
        if method == FIT and not self.parameters["use_image"]:
            raise ValueError(
                f"method: {FIT} fits the image, but use_image is false; start the node with "
                "use_image true, or choose sam or sam_interpolated"
            )

    def listen(self, method: str) -> None:
        """Take what a method needs of image and key parameters, and no more; or ValueError."""
        if self.fits == (method == FIT):
            return
        if self.hand_over is None:
            try:
                self.inputs.listen(alone=method == FIT)
            except RuntimeError as error:  # as where ROS is secured
                raise ValueError(
                    f"method: {method} needs other topics, which cannot be read: {error}"
                ) from None
        self.fits = method == FIT

    def place_beacon(self) -> None:
        """Publish once where the lamp is on the leader, so that the frames are one tree."""
        parent, child = self.parameters.frame("leader_frame"), self.beacon_frame
        if not parent:
            return
        pose, position = Pose(), np.array(self.parameters["beacon_position_m"])
        turned = (signs(parent) != signs(child)).any()
        if self.below_base:
            parent, child, position = child, parent, -position
        roll = math.pi if turned else 0.0
        messages.write_pose(pose, signs(parent)[:3] * position, 0.0, 0.0, roll)
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=parent)
        transform_publisher(self, self.parameters["publish_tf"], fixed=True)(header, child, pose)

    def on_change(self, changes: dict[str, Any]) -> None:
        """Take over parameters; a ValueError leaves everything as it was."""
        method = changes.get("method", self.parameters["method"])
        self.check(method)
        tracking, source, estimator = None, self.source, None
        if changes.get("tracking", self.parameters["tracking"]):
            tracking = self.parameters.settings(TrackerSettings, changes)
        if "table" in changes:
            folder = changes["table"]
            source = load_table(folder, self.scene) if folder else self.scene
        elif self.pipeline is None:
            self.listen(method)
            return
        if changes.keys() & OF_ESTIMATOR:
            settings = self.parameters.settings(EstimatorSettings, changes)
            estimator = Estimator(source, **asdict(settings))
            if settings.method != FIT:
                source = estimator.table  # the next one need not build it again
        self.listen(method)
        self.rest.finish()  # nothing is refused from here on
        self.source = source
        if estimator is not None:
            if self.pipeline is None:
                self.pipeline = Pipeline(estimator, tracking)
                self.diagnostics.fail("")
            self.pipeline.estimator = estimator
        if self.pipeline is not None and changes.keys() & OF_TRACKER:
            self.pipeline.track_with(tracking)
        if self.pipeline is not None:
            # What is too dim to match, the feature node has decided.
            light = self.parameters.settings(FeatureSettings, changes)
            least = light.min_peak_counts if self.fits else 0.0
            self.pipeline.least_counts = self.scene.black_counts + least

    def unpack(self, features: PointCloud2, image: Image | None = None) -> None:
        """Answer key parameters and their image where they belong together."""
        with self.diagnostics.refusing():
            parameters, counts = messages.features_from_message(features), None
            if parameters is not None and image is not None:
                counts = self.counts(image)
                check_image(parameters, counts, self.scene)  # refuses two exposures of one stamp
            self.on_features(features.header, parameters, counts)

    def on_message(self, message: Image) -> None:
        """Answer an image by itself."""
        with self.diagnostics.refusing():
            self.order.check_fresh(message.header, self.get_clock().now().nanoseconds)
            self.on_image(message.header, self.counts(message))

    def counts(self, message: Image) -> Array:
        """Return the readings of an image."""
        return image_from_message(message, self.scene.array, self.scene.lamp_count)

    def on_imu(self, message: Imu) -> None:
        """Keep the follower's roll."""
        with self.diagnostics.refusing("imu"):
            self.roll.take(message)

    def on_command(self, message: TwistStamped) -> None:
        """Tell the tracker how the follower moves by itself."""
        with self.diagnostics.refusing("cmd_vel"):
            command = twist_from_message(message)
            if self.pipeline is not None:
                self.pipeline.command(stamp_ns(message.header) + self.shift_ns, *command)

    def on_range(self, message: Range) -> None:
        """Tell the tracker how far the lamp is."""
        with self.diagnostics.refusing("range"):
            measured = messages.range_from_message(message, self.parameters["range_std_m"])
            self.range_order.check(message.header, self.get_clock().now().nanoseconds)
            if self.pipeline is not None:
                self.pipeline.range(stamp_ns(message.header) + self.shift_ns, *measured)

    def on_image(self, header: Header, image: Array) -> None:
        """Publish the pose of an image, counts, or say why not."""
        with self.diagnostics.refusing():
            self.answer(header, image, None)

    def on_features(self, header: Header, parameters: Array | None, image: Array | None) -> None:
        """Publish the pose of key parameters, ``None`` without light, or say why not."""
        with self.diagnostics.refusing():
            if parameters is None:
                raise Refused("no light: the feature node found none to match")
            self.answer(header, image if self.parameters["use_image"] else None, parameters)

    def answer(self, header: Header, image: Array | None, parameters: Array | None) -> None:
        """Publish the pose of image, key parameters or both; errors of `Pipeline.estimate`."""
        self.rest.finish()
        if self.pipeline is None:
            raise Refused("no table: see the error")
        told = self.parameters
        roll, roll_std = self.roll.at(header, told["roll_std_rad"], told["max_imu_age_s"])
        buffer_s, reset_s = told["buffer_s"], told["reset_after_s"]
        if self.order.set_back(header, round(buffer_s * 1e9)):
            # However far: else the track would wait for the new clock to catch up with the old.
            self.shift_ns -= round((buffer_s + reset_s) * 1e9)
        stamp = stamp_ns(header) + self.shift_ns
        estimate = self.pipeline.estimate(stamp, image, parameters, roll)
        self.order.check(header)
        roll += estimate.roll
        covariance = covariance_6x6(estimate.pose, estimate.covariance, roll_std, estimate.turn)
        header = Header(stamp=header.stamp, frame_id=self.beacon_frame)
        pose = messages.pose_to_message(estimate.pose, covariance, header, roll)
        if self.poses.publish(pose):
            known = roll, roll_std
            self.rest.leave(partial(self.follow_up, self.pipeline, estimate, pose, *known))

    def follow_up(
        self,
        pipeline: Pipeline,
        estimate: Estimate,
        pose: PoseWithCovarianceStamped,
        roll: float,
        roll_std: float,
    ) -> None:
        """Publish what else there is of a pose that is out: track, leader, transform, figures."""
        header, track = pose.header, pipeline.track(roll)
        mismatch = f"mismatch: {track.mismatch}" if track and track.mismatch else ""
        self.diagnostics.warn(estimate.fault, mismatch, self.roll.lost)
        if self.leaders.heard or self.below_base:
            own = Header(stamp=header.stamp, frame_id=self.base_frame)
            leader = messages.inverse_to_message((track or estimate).pose, own, roll)
            self.leaders.publish(leader)
            if self.below_base:
                self.send_transform(own, header.frame_id, leader.pose)
        if not self.below_base:
            self.send_transform(header, self.child_frame, pose.pose.pose)
        if track is not None:
            self.publish_track(track, header, roll, roll_std)
            self.tell_of_range(track.range)
        self.diagnostics.answer(
            stamp_ns(header), lambda: self.figures(pipeline.estimator, estimate, track)
        )

    def figures(
        self, estimator: Estimator, estimate: Estimate, track: Track | None
    ) -> dict[str, str]:
        """Return what the diagnostics show of an answer, and of what its track knows."""
        shown = {"table_margin": table_margin(self.extent, estimate.pose)} | figures(estimate)
        if track is not None:
            shown |= figures_of_track(self.model, estimator.constants, track)
        return shown

    def tell_of_range(self, use: RangeUse | None) -> None:
        """Refuse a range that the track refused, once."""
        if use is not None and use.refused and use.stamp_ns != self.range_ns:
            self.range_ns = use.stamp_ns
            self.diagnostics.refuse(f"false range: {words_of(use)}")

    def state(self) -> dict[str, str]:
        """Return the method and how its fit runs, with light or without; log each change."""
        if self.pipeline is None:
            return {}
        estimator = self.pipeline.estimator
        method = estimator.settings.method
        if method != FIT:
            return {"method": method}
        if estimator.state_of_fit != self.state_of_fit:
            self.state_of_fit = estimator.state_of_fit
            self.get_logger().info(f"{FIT}: {self.state_of_fit}")
        return {"method": method, "fit": estimator.state_of_fit}

    def publish_track(self, track: Track, header: Header, roll: float, roll_std: float) -> None:
        """Publish pose and twist of the track."""
        odometry = relative_odometry(track, roll, roll_std)
        pose = messages.pose_to_message(odometry.pose, odometry.covariance, header, roll)
        twist = odometry.twist, odometry.spread
        message = messages.odometry_to_message(pose, self.child_frame, *twist)
        self.tracks.publish(message)
        if self.hand_over is not None:
            self.hand_over(message)


main = partial(run, EstimatorNode)
