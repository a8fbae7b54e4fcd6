"""The example node of a serial array, over a pseudo-terminal and a socket."""

import binascii
import importlib.util
import os
import socket
import struct
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import Image

EXAMPLE = Path(__file__).parents[2] / "examples" / "serial_array_node.py"
spec = importlib.util.spec_from_file_location("serial_array_node", EXAMPLE)
example = importlib.util.module_from_spec(spec)
spec.loader.exec_module(example)


def stuffed(data):
    """Encode by COBS, group by group of bytes that are not zero, up to 254 of them."""
    packet = b""
    for group in data.split(b"\0"):
        while len(group) >= 254:
            packet += b"\xff" + group[:254]
            group = group[254:]
        packet += bytes([len(group) + 1]) + group
    return packet


def frame(number, time_us, readings, version=1):
    side = len(readings)
    data = struct.pack("<BBIQ", version, side, number, time_us)
    data += b"".join(struct.pack("<H", value) for row in readings for value in row)
    return data + struct.pack("<I", binascii.crc32(data))


def sent(number, time_us=None, readings=None):
    """Return a packet; its image tells its number."""
    time_us = 10**6 + number if time_us is None else time_us
    return stuffed(frame(number, time_us, readings or [[number, 0], [7, 65535]])) + b"\0"


@given(
    st.integers(2, 21).flatmap(
        lambda side: st.lists(
            st.lists(st.integers(0, 65535), min_size=side, max_size=side),
            min_size=side,
            max_size=side,
        )
    ),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**64 - 1),
)
def test_every_frame_survives_its_packet(readings, number, time_us):
    packet = stuffed(frame(number, time_us, readings))
    assert 0 not in packet
    found = example.frame_from(packet)
    assert found[:2] == (number, time_us)
    np.testing.assert_array_equal(found[2], readings)


@given(st.integers(0, 10**6), st.integers(1, 255), st.booleans())
def test_no_damaged_packet_is_taken(place, change, cut):
    packet = bytearray(sent(3)[:-1])
    place %= len(packet)
    if cut:
        packet = packet[:place]
    else:
        packet[place] ^= change
    with pytest.raises(example.Refused):
        example.frame_from(bytes(packet))


@pytest.mark.parametrize(
    ("packet", "kind"),
    [
        (stuffed(frame(1, 1, [[1, 2], [3, 4]], version=2)), "wrong version: 2"),
        (stuffed(frame(1, 1, [[1, 2, 3], [3, 4, 5]])), "wrong size: 12 bytes"),
        (stuffed(b"abc"), "short: 3 bytes"),
    ],
)
def test_what_is_no_frame_is_named(packet, kind):
    with pytest.raises(example.Refused, match=kind):
        example.frame_from(packet)


class Line:
    """A pseudo-terminal behind a name that stays, as udev gives one to an adapter."""

    def __init__(self, name):
        self.name, self.ends = name, ()

    def plug(self):
        self.ends = os.openpty()
        self.name.unlink(missing_ok=True)
        self.name.symlink_to(os.ttyname(self.ends[1]))

    def unplug(self):
        for end in self.ends:
            os.close(end)
        self.ends = ()

    def send(self, data):
        os.write(self.ends[0], data)


@pytest.fixture
def line(tmp_path):
    line = Line(tmp_path / "port")
    line.plug()
    yield line
    line.unplug()


def begin(lab, port):
    lab.begin({"serial_array_node:port": str(port)})
    node = lab.start(example.SerialArrayNode)
    lab.heard = lab.listen(Image, "array/image")
    lab.connect()
    lab.until(lambda: node.connected, "the port")
    return node


def numbers(lab):
    return [np.frombuffer(bytes(message.data), "<u2")[0] for message in lab.heard]


def test_whole_frames_become_images_and_the_others_are_told(lab, line):
    node = begin(lab, line.name)
    torn = sent(0)[20:]
    spoilt = bytearray(sent(4))
    spoilt[25] ^= 1
    line.send(torn + sent(1))
    lab.until(lambda: lab.heard, "the first image, which sets the clock")
    line.send(sent(2) + b"\0" + sent(3)[:-12] + b"\0" + bytes(spoilt))
    # 3 and 4 are lost with their frames, 6 and 7 never come, 8 is late: exposed long before 5.
    line.send(sent(5) + sent(8, 500_000) + sent(9)[:10])
    line.send(sent(9)[10:])
    lab.until(lambda: len(lab.heard) == 4, "images")
    assert numbers(lab) == [1, 2, 5, 9]
    message = lab.heard[0]
    assert message.header.frame_id == "follower/array"
    assert (message.height, message.width, message.encoding) == (2, 2, "mono16")
    told = "".join(node.diagnostics._refusals.values())
    for words in ("corrupt: the checksum", "lost: 2 frames before number 8", "late: 0.5"):
        assert words in told, told
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in lab.heard]
    np.testing.assert_array_equal(np.diff(stamps), [1000, 3000, 4000])
    assert 0 <= node.get_clock().now().nanoseconds - stamps[-1] < 60 * 10**9


def test_stamps_follow_the_arrays_clock_and_not_the_arrival(lab, line):
    """Arrivals with a jitter, by a clock of the test: steps of 0.1 s stay 0.1 s."""
    node = begin(lab, line.name)
    lag, jitter = 10**18, [0, 30, 10, 50, 0, 20]  # ns and ms
    found = [
        node.stamp_ns(i, 100_000 * i, lag + 10**8 * i + 10**6 * late)
        for i, late in enumerate(jitter)
    ]
    assert found == [lag + 10**8 * i for i in range(len(jitter))]
    # After a restart the clock begins anew.
    assert node.stamp_ns(0, 5, lag + 10**9) == lag + 10**9


def test_an_array_that_is_unplugged_is_told_and_one_that_is_back_is_read(lab, line):
    node = begin(lab, line.name)
    line.send(b"\0" + sent(1))
    lab.until(lambda: lab.heard, "an image")
    line.unplug()
    lab.report(node, DiagnosticStatus.ERROR, "no array")
    line.plug()
    lab.until(lambda: node.connected, "the port")
    line.send(b"\0" + sent(0))
    lab.until(lambda: len(lab.heard) == 2, "an image")
    assert numbers(lab) == [1, 0]


def test_a_socket_is_read_too(lab):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        begin(lab, f"socket://127.0.0.1:{port}")
        wire, _ = server.accept()
        with wire:
            wire.sendall(b"\0" + sent(3))
            lab.until(lambda: lab.heard, "an image")
            wire.sendall(sent(4))
            lab.until(lambda: len(lab.heard) == 2, "another")
    assert numbers(lab) == [3, 4]
