"""From key parameters to the follower's pose in the leader's beacon frame."""

import math
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from uuv_optical_array.estimate import Estimator, NoPose
from uuv_optical_array.nodes.diagnostics import Diagnostics
from uuv_optical_array.nodes.messages import (
    Refused,
    StampOrder,
    features_from_message,
    pose_to_message,
)
from uuv_optical_array.nodes.node import publish, run, subscribe, transform_publisher
from uuv_optical_array.nodes.parameters import SCENE, Parameter, Parameters
from uuv_optical_array.pose import DOF_NAMES, covariance_6x6
from uuv_optical_array.quantity import Quantity
from uuv_optical_array.scene import load_scene
from uuv_optical_array.table import cached_table, load_table

PARAMETERS = {
    "scene": SCENE,
    "table": Parameter(
        "", Quantity("folder of the signature table; empty: the cache, built at the first start")
    ),
    "max_angle_rad": Parameter(
        0.25, Quantity("spectral angle beyond which a match is no pose", "rad", 0, math.pi)
    ),
    "neighbours": Parameter(
        64, Quantity("nearest table rows whose spread is the covariance", "rows", 2, 10_000)
    ),
    "roll_std_rad": Parameter(
        0.02,
        Quantity("standard deviation of the relative roll, which is taken as 0", "rad", 1e-6, 3),
    ),
    "beacon_frame": Parameter("beacon", Quantity("frame of the pose: the lamp's"), True),
    "publish_tf": Parameter(
        False, Quantity("whether the pose goes to /tf too, where tf2_msgs is installed"), True
    ),
    "tf_child_frame": Parameter(
        "base_link_by_light", Quantity("frame that the pose places on /tf"), True
    ),
}


class EstimatorNode(Node):
    """Publish a pose for each signature that the table can answer, and nothing else."""

    def __init__(self) -> None:
        super().__init__("estimator_node")
        self.parameters = Parameters(self, PARAMETERS, self.on_change)
        self.scene = load_scene(self.parameters["scene"])
        self.order = StampOrder()
        self.diagnostics = Diagnostics(self)
        self.estimator: Estimator | None = None
        try:
            self.open_table(self.parameters["table"])
        except ValueError as reason:
            self.diagnostics.fail(str(reason))
        self.poses = publish(self, PoseWithCovarianceStamped, "relative_pose")
        self.send_transform = transform_publisher(self, self.parameters["publish_tf"])
        subscribe(self, PointCloud2, "array/features", self.on_features)

    def open_table(self, path: str) -> None:
        """Match against another table from now on; a ValueError leaves the present one."""
        table = load_table(path, self.scene) if path else cached_table(self.scene)
        self.estimator = Estimator(table)
        self.diagnostics.fail("")
        self.get_logger().info(f"{len(table.poses)} signatures of scene {self.scene.name}")

    def on_change(self, changes: dict[str, Any]) -> None:
        """Take over a parameter that was set while the node runs."""
        if "table" in changes:
            self.open_table(changes["table"])

    def on_features(self, message: PointCloud2) -> None:
        """Publish the pose of one signature."""
        try:
            self.order.check(message.header)
            if self.estimator is None:
                raise Refused("no table: see the error")
            parameters = features_from_message(message)
            if parameters is None:
                raise Refused("no light: the feature node found none to match")
            self.estimator.max_angle_rad = self.parameters["max_angle_rad"]
            self.estimator.neighbours = self.parameters["neighbours"]
            estimate = self.estimator.estimate(parameters)
        except (Refused, NoPose) as reason:
            self.diagnostics.refuse(str(reason))
            return
        header = Header(stamp=message.header.stamp, frame_id=self.parameters["beacon_frame"])
        covariance = covariance_6x6(
            estimate.pose, estimate.covariance, self.parameters["roll_std_rad"]
        )
        pose = pose_to_message(estimate.pose, covariance, header)
        self.poses.publish(pose)
        self.send_transform(self.transform(pose))
        self.diagnostics.answer(
            angle_rad=f"{estimate.angle_rad:.4f}",
            runner_up_angle_rad=f"{estimate.runner_up_angle_rad:.4f}",
            **{
                f"std_{name}": f"{math.sqrt(variance):.3f}"
                for name, variance in zip(DOF_NAMES, estimate.covariance.diagonal(), strict=True)
            },
        )

    def transform(self, pose: PoseWithCovarianceStamped) -> TransformStamped:
        """Return the pose as a transform."""
        transform = TransformStamped(
            header=pose.header, child_frame_id=self.parameters["tf_child_frame"]
        )
        position = pose.pose.pose.position
        translation = transform.transform.translation
        translation.x, translation.y, translation.z = position.x, position.y, position.z
        transform.transform.rotation = pose.pose.pose.orientation
        return transform


def main(args: list[str] | None = None) -> None:
    """Run the node."""
    run(EstimatorNode, args)
