"""``uuv_array follow --record``: the bag of a run holds what the nodes said, message by message."""

import numpy as np
from asker import place_of
from builtin_interfaces.msg import Time
from command_line import run
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from needs import rosbags
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array.control.follow_states import values_of
from uuv_optical_array.control.following import State
from uuv_optical_array.forward.array import ArraySettings
from uuv_optical_array.nodes.bringup.demo import BagRecorderNode
from uuv_optical_array.nodes.shared.messages import image_to_message
from uuv_optical_array.recording.bag import BagWriter, opened
from uuv_optical_array.recording.images import read_recording

pytestmark = rosbags


def test_what_is_published_is_in_the_bag_byte_by_byte(lab, tmp_path):
    lab.begin()
    with BagWriter(tmp_path / "run") as bag:
        recorder = lab.start(lambda: BagRecorderNode(bag))
        images = lab.talk(Image, "array/image")
        tracks = lab.talk(Odometry, "relative_odometry")
        commands = lab.talk(TwistStamped, "cmd_vel")
        states = lab.talk(DiagnosticStatus, "follow_state")
        for talker in (images, tracks, commands, states):
            lab.until(talker.get_subscription_count, f"the recorder of {talker.topic_name}")
        written = []
        write = bag.write
        bag.write = lambda *given: (write(*given), written.append(given))
        for i in range(1, 4):
            stamp = Time(sec=i)
            images.publish(image_to_message(np.full((3, 3), 1000 * i), Header(stamp=stamp)))
            track = Odometry(header=Header(stamp=stamp, frame_id="leader/beacon"))
            track.pose.pose.position.x, track.pose.pose.orientation.w = -float(i), 1.0
            tracks.publish(track)
            command = TwistStamped(header=Header(stamp=stamp, frame_id="rov/base_link_frd"))
            command.twist.linear.y, command.twist.angular.z = 0.1 * i, np.nan if i == 2 else -0.2
            commands.publish(command)
        for name, since_s in (("coasting", 7.5), ("locked", 2.25), ("coasting", 7.5), ("odd", 8.0)):
            values = values_of(State("locked", since_s, f"why {name}"), 9.0)
            pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
            states.publish(DiagnosticStatus(message=name, values=pairs))
        lab.until(lambda: len(written) == 13, "all messages")
    found = read_recording(tmp_path / "run", ArraySettings("planar", 3), poses_needed=False)
    assert found.images[:, 0, 0].tolist() == [1000, 2000, 3000]
    assert found.stamps_ns.tolist() == [10**9, 2 * 10**9, 3 * 10**9]
    assert [stamp for stamp, *_ in found.commands] == [10**9, 3 * 10**9]
    np.testing.assert_allclose(found.commands[1][1:], [[0, -0.3, 0], [0, 0, 0.2]])
    assert found.states == [
        State("locked", 2.25, "why locked"),
        State("coasting", 7.5, "why coasting"),
    ]
    assert found.refused == {"/cmd_vel: not finite": 1, "/follow_state: no state": 1}
    with opened(tmp_path / "run") as held:
        tracks = {"/relative_odometry": "nav_msgs/msg/Odometry"}
        heard = [(at, message) for at, _, message in held.messages(tracks)]
    assert [place_of(message)[0][0] for _, message in heard] == [-1.0, -2.0, -3.0]
    now = recorder.get_clock().now().nanoseconds
    assert all(0 < now - at < 3600 * 10**9 for at, _ in heard)


def test_a_folder_that_is_there_is_not_written_to(tmp_path):
    words = ("--output", tmp_path / "x.png", "--record", tmp_path)
    assert "it exists" in run("follow", *words, code=2)
