"""The live view of ROS topics: what the other nodes publish, on a page in the browser."""

from collections import deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Image

from uuv_optical_array.control.follow_states import state_from_status
from uuv_optical_array.control.following import State
from uuv_optical_array.control.vehicles.trajectory import TooEarly, Trajectory
from uuv_optical_array.core.geometry import Array, covariance_5x5, relative_pose
from uuv_optical_array.core.messages import image_from_message, odometry_pose, stamp_ns
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.shared import messages
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.node import LASTING, run, subscribe
from uuv_optical_array.nodes.shared.parameters import Parameter, Parameters, shared
from uuv_optical_array.view import LOOPBACK, PORT
from uuv_optical_array.view.page import Page
from uuv_optical_array.view.sight import Sight

PARAMETERS = {
    **shared("scene", "beacon_position_m", "odometry_axes", "max_gap_s"),
    "host": Parameter(
        LOOPBACK, Quantity("address of the page; 0.0.0.0: for the whole network"), True
    ),
    "port": Parameter(
        PORT, Quantity("port of the page; where it is taken, the next free one", "", 1, 65535), True
    ),
    "max_rate_hz": Parameter(
        10.0, Quantity("largest rate of the images that are shown", "Hz", 0.1, 100)
    ),
}


WAITING = 10  # images that wait for a track that is late


class ViewNode(Node):
    """Show images and tracks, and the truth where there are odometries; options as of `Node`."""

    page: Page | None = None  # none where the node is refused

    def __init__(self, **options: Any) -> None:
        super().__init__("view_node", **options)
        self.parameters = Parameters(self, PARAMETERS)
        self.scene = load_scene(self.parameters["scene"])
        self.diagnostics = Diagnostics(self)
        # Stamp and image: they wait for the track, and for the next image and so the odometry.
        self.waiting: deque[tuple[int, Array]] = deque()
        self.tracks: dict[int, Odometry] = {}
        self.state: State | None = None  # the last one, since a time of the stamps
        self.first_ns = self.shown_ns = 0
        self.trajectories = {
            name: Trajectory(self.parameters["max_gap_s"]) for name in ("leader", "follower")
        }
        title = f"uuv_optical_array: topics of {self.get_namespace()}"
        address = self.parameters["host"], self.parameters["port"]
        self.page = Page(self.scene, title, *address)
        self.get_logger().info(f"open {self.page.url} in a browser")
        subscribe(self, Image, "array/image", self.on_image)
        subscribe(self, Odometry, "relative_odometry", self.on_track)
        subscribe(self, DiagnosticStatus, "follow_state", self.on_state, qos=LASTING)
        subscribe(self, Odometry, "leader/odometry", partial(self.on_vehicle, "leader"))
        subscribe(self, Odometry, "follower/odometry", partial(self.on_vehicle, "follower"))

    def on_vehicle(self, name: str, message: Odometry) -> None:
        """Record where a vehicle is."""
        with self.diagnostics.refusing(f"{name}/odometry"):
            pose = odometry_pose(message, self.parameters["odometry_axes"])
            self.trajectories[name].add(stamp_ns(message.header), *pose)

    def on_state(self, message: DiagnosticStatus) -> None:
        """Keep what the follower does, for the images from now on."""
        with self.diagnostics.refusing("follow_state"):
            self.state = state_from_status(message)

    def on_track(self, message: Odometry) -> None:
        """Keep a track, and show the images that waited for it."""
        self.tracks[stamp_ns(message.header)] = message
        while len(self.tracks) > 2 * WAITING:
            del self.tracks[next(iter(self.tracks))]
        self.serve()

    def on_image(self, message: Image) -> None:
        """Let an image wait, and show those before it that need not wait longer."""
        with self.diagnostics.refusing():
            image = image_from_message(message, self.scene.array, self.scene.lamp_count)
            self.waiting.append((stamp_ns(message.header), image))
        self.serve()

    def serve(self) -> None:
        """Show images in order: each with its track, or without where a later one is there."""
        while len(self.waiting) > 1:
            first, _ = self.waiting[0]
            late = bool(self.tracks) and all(stamp < first for stamp in self.tracks)
            if late and len(self.waiting) <= WAITING:
                return
            self.show(*self.waiting.popleft())

    def show(self, stamp: int, image: Array) -> None:
        """Draw what is known of an image."""
        if stamp < self.shown_ns:
            self.first_ns = self.shown_ns = 0  # the clock was set back
        if self.shown_ns and stamp - self.shown_ns < 1e9 / self.parameters["max_rate_hz"] - 1e6:
            return
        self.first_ns, self.shown_ns = self.first_ns or stamp, stamp
        note = "no pose of this image: see the diagnostics of estimator_node"
        sight = Sight((stamp - self.first_ns) * 1e-9, image, note=note)
        if self.state is not None:
            since_s = self.state.since_s - self.first_ns * 1e-9
            sight = replace(sight, state=self.state._replace(since_s=since_s))
        if track := self.tracks.get(stamp):
            with self.diagnostics.refusing("relative_odometry"):
                pose = messages.pose_from_message(track)
                covariance = covariance_5x5(pose, messages.covariance_from_message(track))
                sight = replace(sight, pose=pose, covariance=covariance, note="")
        with suppress(TooEarly, LookupError):  # hardware knows no truth
            place, attitude = self.trajectories["leader"].at(stamp)
            leader = place + attitude @ np.array(self.parameters["beacon_position_m"]), attitude
            sight = replace(sight, leader=leader)
            true_pose, _ = relative_pose(*leader, *self.trajectories["follower"].at(stamp))
            sight = replace(sight, true_pose=true_pose)
        assert self.page is not None
        self.page.show(sight)
        self.diagnostics.answer(stamp, lambda: {"peak_counts": f"{image.max():g}"})

    def destroy_node(self) -> None:
        """Serve the page no more."""
        if self.page is not None:
            self.page.close()
        super().destroy_node()


main = partial(run, ViewNode)
