"""The live view of topics: what it shows of an image, its track and both odometries."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from odometries import odometry
from rclpy.time import Time
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array.control.follow_states import values_of
from uuv_optical_array.control.following import State
from uuv_optical_array.core.geometry import covariance_6x6
from uuv_optical_array.core.messages import stamp_ns
from uuv_optical_array.nodes.shared.messages import (
    image_to_message,
    odometry_to_message,
    pose_to_message,
)
from uuv_optical_array.nodes.shared.node import LASTING
from uuv_optical_array.nodes.view_node import WAITING

START_NS = 1_700_000_000 * 10**9
POSE = np.array([-5.0, 0.4, -0.3, 0.1, -0.2])
SPREAD = np.diag([0.04, 0.01, 0.01, 1e-4, 1e-4])
NO_TWIST = np.zeros(6), np.eye(6)


def header(i, frame):
    return Header(stamp=Time(nanoseconds=START_NS + i * 10**8).to_msg(), frame_id=frame)


@pytest.fixture
def view(lab, scene_file):
    """A view node whose page keeps what it is to show, and the topics to it."""
    from uuv_optical_array.nodes.view_node import ViewNode

    lab.begin({"scene": scene_file, "port": 18300, "beacon_position_m": [-0.5, 0.0, 0.0]})
    node = lab.start(ViewNode)
    node.seen = []
    lab.patch.setattr(node.page, "show", node.seen.append)
    node.images = lab.talk(Image, "array/image")
    node.odometries = lab.talk(Odometry, "relative_odometry")
    node.vehicles = {
        name: lab.talk(Odometry, f"{name}/odometry") for name in ("leader", "follower")
    }
    lab.connect()
    return node


def send_image(lab, node, i):
    """Send an image whose brightest detector reads 100 + i, and wait until it is taken."""
    image = np.zeros((node.scene.array.detectors_per_side,) * 2)
    image[0, -1] = 100 + i
    node.images.publish(image_to_message(image, header(i, "array")))
    stamp = START_NS + i * 10**8
    lab.until(lambda: node.waiting and node.waiting[-1][0] == stamp, f"image {i}")


def send_track(lab, node, i, frame="beacon", child="base_link"):
    pose = pose_to_message(POSE, covariance_6x6(POSE, SPREAD, 1e-6), header(i, frame))
    node.odometries.publish(odometry_to_message(pose, child, *NO_TWIST))
    lab.until(lambda: stamp_ns(pose.header) in node.tracks, f"track {i}")


def send_vehicle(lab, node, name, i, position, turn):
    stamp = START_NS + i * 10**8
    node.vehicles[name].publish(odometry(stamp, position, Rotation.from_matrix(turn)))
    known = node.trajectories[name]
    lab.until(lambda: known.newest_ns == stamp, f"{name} {i}")


@pytest.mark.parametrize(("frame", "child"), [("beacon", "base_link"), ("lamp_ned", "hull_frd")])
def test_an_image_is_shown_with_its_track_and_the_next_without(lab, view, frame, child):
    send_image(lab, view, 0)
    send_track(lab, view, 0, frame, child)
    send_image(lab, view, 1)
    send_image(lab, view, 2)
    send_track(lab, view, 2, frame, child)
    first, second = view.seen
    np.testing.assert_allclose(first.pose, POSE, atol=1e-12)
    np.testing.assert_allclose(first.covariance, SPREAD, atol=1e-9)
    assert (first.image.max(), first.image[0, -1], first.t_s) == (100, 100, 0.0)
    assert (first.note, first.true_pose, first.leader) == ("", None, None)
    assert (second.pose, second.covariance, second.t_s) == (None, None, pytest.approx(0.1))
    assert second.note.startswith("no pose")


def test_an_image_waits_for_a_track_that_is_late_but_not_for_ever(lab, view):
    send_image(lab, view, 0)
    send_track(lab, view, 0)
    for i in (1, 2, 3):
        send_image(lab, view, i)
    assert len(view.seen) == 1
    send_track(lab, view, 1)
    assert [sight.t_s for sight in view.seen] == pytest.approx([0.0, 0.1])
    np.testing.assert_allclose(view.seen[1].pose, POSE, atol=1e-12)
    for i in range(4, 4 + WAITING):
        send_image(lab, view, i)
    assert view.seen[-1].pose is None
    assert len(view.waiting) == WAITING


def test_the_truth_is_that_of_both_odometries_and_the_place_of_the_lamp(lab, view):
    leads = Rotation.from_euler("ZY", [0.7, 0.1]).as_matrix()
    leader = np.array([10.0, -4.0, 1.0])
    follows = leads @ Rotation.from_euler("ZY", POSE[[4, 3]]).as_matrix()
    follower = leader + leads @ (POSE[:3] - np.array([0.5, 0.0, 0.0]))
    send_image(lab, view, 1)
    for i in (0, 2):  # interpolated between
        send_vehicle(lab, view, "leader", i, leader + np.array([0.3 * (i - 1), 0, 0]), leads)
        send_vehicle(lab, view, "follower", i, follower, follows)
    send_image(lab, view, 2)
    (seen,) = view.seen
    np.testing.assert_allclose(seen.true_pose, POSE, atol=1e-9)
    np.testing.assert_allclose(seen.leader[0], leader - 0.5 * leads[:, 0])
    np.testing.assert_allclose(seen.leader[1], leads, atol=1e-12)


def test_what_the_follower_does_is_shown_on_the_clock_of_the_images(lab, view):
    states = lab.probe.create_publisher(DiagnosticStatus, "follow_state", LASTING)

    def tell(name, tenths):
        values = values_of(State(name, START_NS * 1e-9 + 0.1 * tenths, f"it is {name}"), 0.0)
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        states.publish(DiagnosticStatus(message=name, values=pairs))

    send_image(lab, view, 0)
    send_image(lab, view, 1)
    tell("coasting", -30)
    lab.until(lambda: view.state, "the state")
    send_image(lab, view, 2)
    tell("gliding", 0)
    lab.report(view, DiagnosticStatus.WARN, "follow_state, no state")
    tell("lost", 1)
    lab.until(lambda: view.state.name == "lost", "the next state")
    send_image(lab, view, 3)
    assert [sight.state and sight.state.name for sight in view.seen] == [None, "coasting", "lost"]
    since = [sight.state.since_s for sight in view.seen[1:]]
    assert since == pytest.approx([-3.0, 0.1], abs=1e-5)
    assert view.seen[2].state.reason == "it is lost"


def test_fast_images_are_thinned_and_a_clock_set_back_begins_anew(lab, view):
    lab.set(view, "max_rate_hz", 5.0)
    for i in range(6):
        send_image(lab, view, i)
    assert [sight.t_s for sight in view.seen] == pytest.approx([0.0, 0.2, 0.4])
    send_image(lab, view, -50)
    send_image(lab, view, -48)
    assert view.seen[-1].t_s == 0.0
    assert view.seen[-1].image.max() == 50


def test_an_image_of_another_array_is_refused_and_a_damaged_track_is_no_pose(lab, view):
    other = image_to_message(np.ones((3, 3)), header(0, "array"))
    lab.deliver(view, view.images, other)
    assert not view.waiting
    send_image(lab, view, 0)
    track = Odometry(header=header(0, "beacon"))
    track.pose.pose.position.x = np.nan
    view.odometries.publish(track)
    lab.until(lambda: view.tracks, "the track")
    send_image(lab, view, 1)
    assert view.seen[0].pose is None
