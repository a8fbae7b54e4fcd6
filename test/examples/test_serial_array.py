"""The example of a serial array: its node, its sender in C, and its emulator."""

import binascii
import contextlib
import ctypes
import errno
import importlib.util
import itertools
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import serial
from command_line import begun, ended
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rclpy.duration import Duration
from scenes import changed
from sensor_msgs.msg import Image

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, save_scene

EXAMPLES = Path(__file__).parents[2] / "examples"


def script(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


example, emulator = script("serial_array_node"), script("serial_array_emulator")


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
    st.integers(2, 21).flatmap(lambda side: arrays(np.uint16, (side, side))),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**64 - 1),
)
def test_every_frame_survives_its_packet(readings, number, time_us):
    packet = stuffed(frame(number, time_us, readings))
    assert 0 not in packet
    found = example.frame_from(packet)
    assert found[:2] == (number, time_us)
    np.testing.assert_array_equal(found[2], readings)


MOST_SIDE = 21


class Sender(ctypes.Structure):
    _fields_ = (
        ("sums", ctypes.c_uint32 * MOST_SIDE**2),
        ("samples", ctypes.c_uint32),
        ("number", ctypes.c_uint32),
        ("side", ctypes.c_uint8),
    )


@pytest.fixture(scope="module")
def c_sender(tmp_path_factory):
    """Return a sender of a side, with functions that add samples and give a packet."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("the sender in C needs a compiler, cc")
    library = tmp_path_factory.mktemp("sender") / "sender.so"
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "-O1"]
    words = [compiler, *strict, f"-DUUV_MOST_SIDE={MOST_SIDE}", "-shared", "-fPIC"]
    subprocess.run([*words, "-o", library, EXAMPLES / "array_sender.c"], check=True)
    code = ctypes.CDLL(str(library))
    code.uuv_frame.restype = ctypes.c_size_t
    buffer = (ctypes.c_uint8 * 2048)()

    def begin(side):
        sender = Sender()
        code.uuv_begin(ctypes.byref(sender), ctypes.c_uint8(side))

        def add(image):
            image = np.ascontiguousarray(image, "<u2")
            code.uuv_add(ctypes.byref(sender), image.ctypes.data_as(ctypes.c_void_p))

        def packet(time_us):
            length = code.uuv_frame(ctypes.byref(sender), ctypes.c_uint64(time_us), buffer)
            return bytes(buffer[:length])

        return sender, add, packet

    return begin


@given(
    st.integers(2, MOST_SIDE),
    st.lists(st.integers(1, 9), min_size=1, max_size=3),
    st.integers(0, 2**64 - 1),
    st.sampled_from([1, 2, 255, 256, 65535]),
    st.integers(0, 2**32 - 1),
)
def test_the_sender_in_c_sends_the_mean_of_its_samples(c_sender, side, frames, time, most, seed):
    rng, (_, add, packet) = np.random.default_rng(seed), c_sender(side)
    assert packet(0) == b""
    for expected, samples in enumerate(frames):
        taken = rng.integers(0, most, (samples, side, side), endpoint=True)
        for image in taken:
            add(image)
        data = packet(time)
        assert data.count(b"\0") == 1
        assert len(data) <= 14 + 2 * side**2 + 4 + (18 + 2 * side**2) // 254 + 2
        number, time_us, readings = example.frame_from(data[:-1])
        assert (number, time_us) == (expected, time)
        np.testing.assert_array_equal(readings, np.floor(taken.mean(axis=0) + 0.5))


def test_the_sender_in_c_keeps_its_bounds(c_sender):
    sender, add, packet = c_sender(99)
    assert sender.side == MOST_SIDE
    image = np.full((MOST_SIDE, MOST_SIDE), 65535)
    for _ in range(3):
        add(image)
    sender.samples = 65536  # as if after so many
    for i in range(MOST_SIDE**2):
        sender.sums[i] = 65536 * 65535
    add(image)
    _, _, readings = example.frame_from(packet(1)[:-1])
    assert (readings == 65535).all()


def test_the_emulator_sends_the_images_of_its_scene(tmp_path):
    wired, path = {"wiring": np.arange(24, -1, -1).tolist()}, tmp_path / "wired.yaml"
    save_scene(changed("follow", array=wired), path, "Wired.")
    taken = list(itertools.islice(emulator.images(str(path), 10.0, 3), 3))
    assert [t for t, _ in taken] == [0.0, 0.1, 0.2]
    first = ForwardModel(load_scene("follow")).expose(
        [-3.5, 0, 0, 0, 0], np.random.default_rng(3), time_s=0.0
    )
    np.testing.assert_array_equal(taken[0][1], first[::-1, ::-1])
    data = emulator.packet(7, 12, first)
    assert data == stuffed(frame(7, 12, first.astype(int).tolist())) + b"\0"
    for damaged in emulator.spoilt(data[:-1], np.random.default_rng(1)).split(b"\0"):
        with pytest.raises(example.Refused):
            example.frame_from(damaged)


def test_the_node_reads_the_emulator(lab, tmp_path):
    """Both as processes, as a user starts them."""
    link = tmp_path / "array"
    lab.begin()
    lab.heard, told = lab.listen(Image, "array/image"), lab.listen(DiagnosticArray, "/diagnostics")
    sends, reads = (
        [sys.executable, EXAMPLES / f"serial_array_{name}.py"] for name in ("emulator", "node")
    )
    sends += ["--link", link, "--rate-hz", "50", "--spoil", "0.3"]
    reads += ["--ros-args", "-p", f"port:={link}"]
    with begun(sends) as sender, begun(reads) as reader:
        assert sender.stdout.readline() == f"port: {link}\n"
        damage = "corrupt: the checksum"
        lab.until(
            lambda: len(lab.heard) > 9 and any(damage in s.message for d in told for s in d.status),
            "images and damage",
        )
        for process in (sender, reader):
            process.send_signal(signal.SIGINT)
        assert "damaged" in ended(sender)[0]
        ended(reader)
    assert not link.is_symlink()
    assert {(message.height, message.width) for message in lab.heard} == {(5, 5)}


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


def begin(lab, port, **parameters):
    values = {"port": str(port), **parameters}
    lab.begin({f"serial_array_node:{name}": value for name, value in values.items()})
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
    words = "corrupt: the checksum", "lost: 2 frames before number 8", "late: 0.5"
    lab.report(node, DiagnosticStatus.WARN, *words)
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in lab.heard]
    np.testing.assert_array_equal(np.diff(stamps), [1000, 3000, 4000])
    assert 0 <= node.get_clock().now().nanoseconds - stamps[-1] < 60 * 10**9


def test_stamps_follow_the_arrays_clock_and_not_the_arrival(lab, line):
    """Arrivals with a jitter, by a clock of the test: steps of 0.1 s stay 0.1 s."""
    node = begin(lab, line.name)
    lag, jitter = 10**18, [0, 30, 10, 50, 0, 20]  # ns and ms
    found = [
        node.exposed_ns(i, 100_000 * i, lag + 10**8 * i + 10**6 * late)
        for i, late in enumerate(jitter)
    ]
    assert found == [lag + 10**8 * i for i in range(len(jitter))]
    # After a restart the clock begins anew.
    assert node.exposed_ns(0, 5, lag + 10**9) == lag + 10**9


def test_a_known_way_from_exposure_to_arrival_is_taken_off_the_stamps(lab, line):
    node = begin(lab, line.name, least_delay_s=0.011)
    assert node.exposed_ns(0, 5, 10**18) == 10**18 - 11_000_000
    # Whether a frame is late does not depend on it.
    with pytest.raises(example.Refused, match=r"late: 0\.2"):
        node.exposed_ns(1, 5, 10**18 + 2 * 10**8)


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


def test_a_socket_whose_other_end_loses_its_power_is_told_and_opened_anew(lab, monkeypatch):
    """Nobody ends the connection, so that it looks open."""
    monkeypatch.setattr(example, "SILENT_S", 1e9)
    with socket.create_server(("127.0.0.1", 0)) as server, contextlib.ExitStack() as wires:
        node = begin(lab, f"socket://127.0.0.1:{server.getsockname()[1]}")
        wire = wires.enter_context(server.accept()[0])
        wire.sendall(b"\0" + sent(3))
        lab.until(lambda: lab.heard, "an image")
        monkeypatch.setattr(example, "SILENT_S", 0.3)
        lab.report(node, DiagnosticStatus.ERROR, "no array", "gives nothing for 0.3 s")
        monkeypatch.setattr(example, "SILENT_S", 1e9)
        server.settimeout(0.1)
        opened = []

        def another():
            # Like an array it sends again: a port is emptied as it is opened, or given up already.
            with contextlib.suppress(TimeoutError):
                opened.append(wires.enter_context(server.accept()[0]))
            for wire in opened:
                with contextlib.suppress(OSError):
                    wire.sendall(b"\0" + sent(0))
            return len(lab.heard) == 2

        lab.until(another, "another")
        lab.report(node, DiagnosticStatus.WARN, "no input: nothing came for")
    assert numbers(lab) == [3, 0]


def test_a_port_that_may_not_be_opened_is_told_with_the_cure(lab, line, monkeypatch):
    def forbidden(url, *words, **options):
        if not options.get("do_not_open"):
            raise serial.SerialException(errno.EACCES, f"could not open port {url}")

    node = begin(lab, line.name)
    monkeypatch.setattr(example.serial, "serial_for_url", forbidden)
    line.unplug()
    lab.report(node, DiagnosticStatus.ERROR, "no array", "usermod -aG dialout")


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("tcp://192.168.2.4:5000", "tcp"),
        ("socket://192.168.2.4", "lacks host or port; write socket://HOST:PORT"),
        ("socket://:5000", "lacks host or port"),
        ("socket://192.168.2.4:70000", "out of range"),
        ("socket://192.168.2.4:array", "array"),
    ],
)
def test_a_port_that_can_be_none_ends_the_node_in_a_line(lab, url, words):
    lab.begin({"serial_array_node:port": url})
    with pytest.raises(ValueError, match=words):
        lab.start(example.SerialArrayNode)


def test_an_error_that_nothing_expects_leaves_the_reader_alive(lab, line, monkeypatch):
    read, errors = example.SerialArrayNode.read_from, [KeyError("what"), ZeroDivisionError()]
    opened = []

    def read_from(node, port):
        if errors:
            raise errors.pop()
        opened.append(port)
        read(node, port)

    monkeypatch.setattr(example.SerialArrayNode, "read_from", read_from)
    begin(lab, line.name)
    lab.until(lambda: opened, "the port, after the errors")
    line.send(b"\0" + sent(1))
    lab.until(lambda: lab.heard, "an image")


@pytest.mark.parametrize("step_s", [0.5, -0.75, 30.0, -3600.0])
def test_no_image_is_late_where_the_machines_clock_is_set(lab, line, step_s):
    node = begin(lab, line.name)
    line.send(b"\0" + sent(1))
    lab.until(lambda: lab.heard, "an image")
    clock, step = node.get_clock(), Duration(seconds=step_s)
    node.get_clock = lambda: SimpleNamespace(now=lambda: clock.now() + step)
    for number in range(2, 7):
        line.send(sent(number))
    lab.until(lambda: numbers(lab)[-1:] == [6], "the last image")
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in lab.heard]
    assert stamps[-1] - stamps[0] == pytest.approx(step_s, abs=0.01)
    assert len(lab.heard) == (6 if step_s > 0 else 5)  # of a clock set back the first is refused
