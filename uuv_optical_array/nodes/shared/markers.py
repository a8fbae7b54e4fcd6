"""What RViz shows: beam, station, the follower's body and its state, each in its own frame."""

import numpy as np
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType  # type: ignore[attr-defined]
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from uuv_optical_array.control.follow_states import COLOURS
from uuv_optical_array.control.following import State
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.messages import signs
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.nodes.shared.node import FinitePublisher
from uuv_optical_array.view import shapes

LAMP, FOLLOWER, STATION = (1.0, 0.9, 0.5), (0.3, 0.7, 1.0), (1.0, 1.0, 1.0)  # red, green, blue
PERIOD_S = 1.0
ABOVE_M, TALL_M = 1.2, 0.3  # of the state's text: above the follower, and its letters


class Shapes:
    """Publish markers each second, as RViz keeps the error of one that came before its frame."""

    def __init__(self, node: Node, publisher: FinitePublisher) -> None:
        self._publisher, self._shown = publisher, MarkerArray()
        node.create_timer(PERIOD_S, self._again, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def show(self, shapes: list[Marker]) -> None:
        """Publish these from now on."""
        self._shown = MarkerArray(markers=shapes)
        self._publisher.publish(self._shown)

    def _again(self) -> None:
        if self._shown.markers and self._publisher.heard:
            self._publisher.publish(self._shown)


def beam(scene: Scene, frame: str, length_m: float) -> list[Marker]:
    """Return each lamp's beam out to one and two of its standard deviations."""
    return [
        _surface(f"beam_{stds}_sigma", frame, *mesh, LAMP, 0.1, number)
        for number, (_, meshes) in enumerate(shapes.beams(scene, length_m))
        for stds, mesh in enumerate(meshes, 1)
    ]


def body(scene: Scene, frame: str) -> list[Marker]:
    """Return a follower of the scene: a hull as long as the array is ahead, and an upright fin."""
    parts = shapes.body(max(scene.array.bow_m, 0.3))
    return [_surface(name, frame, *mesh, FOLLOWER, 0.8) for name, mesh in parts.items()]


def station(place_m: Array, frame: str) -> Marker:
    """Return a ball at a station, m, in REP 103's axes."""
    marker = _marker("station", frame, Marker.SPHERE, STATION, 0.8)
    marker.scale.x = marker.scale.y = marker.scale.z = 0.3
    place = marker.pose.position
    place.x, place.y, place.z = map(float, signs(frame)[:3] * place_m)
    return marker


def state(told: State, frame: str) -> Marker:
    """Return a follower's state and its reason as a text above it."""
    red, green, blue = (int(COLOURS[told.name][i : i + 2], 16) / 255 for i in (1, 3, 5))
    marker = _marker("state", frame, Marker.TEXT_VIEW_FACING, (red, green, blue), 1.0)
    marker.text = f"{told.name}\n{told.reason}"
    marker.scale.z = TALL_M
    marker.pose.position.z = float(signs(frame)[2] * ABOVE_M)
    return marker


def _surface(
    name: str,
    frame: str,
    vertices: Array,
    faces: NDArray[np.int64],
    rgb: tuple[float, ...],
    alpha: float,
    number: int = 0,
) -> Marker:
    marker = _marker(name, frame, Marker.TRIANGLE_LIST, rgb, alpha)
    marker.id = number
    corners = signs(frame)[:3] * vertices[faces.reshape(-1)]
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in corners.tolist()]
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    return marker


def _marker(name: str, frame: str, kind: int, rgb: tuple[float, ...], alpha: float) -> Marker:
    red, green, blue = rgb
    # Without a stamp and locked, it goes where its frame goes.
    marker = Marker(ns=name, type=kind, action=Marker.ADD, frame_locked=True)
    marker.header.frame_id, marker.pose.orientation.w = frame, 1.0
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker
