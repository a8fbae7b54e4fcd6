"""Images of a detector array on a serial line or a socket: the place to start from with your own.

    python3 -m pip install cobs pyserial
    python3 examples/serial_array_node.py --ros-args -p port:=/dev/ttyUSB0 -p baud_rate:=921600
    python3 examples/serial_array_node.py --ros-args -p port:=socket://192.168.2.4:5000

A frame, little-endian, before it is framed:

    u8   version     1
    u8   side        detectors in a row
    u32  number      of the frame, one more each time; 0 after a restart
    u64  time        of the exposure by the array's own clock, us
    u16  readings    side * side, counts, row by row, in whatever wiring
    u32  CRC-32      of all before it, as zlib and Ethernet have it

The whole is encoded by Consistent Overhead Byte Stuffing (Cheshire and Baker, IEEE/ACM Trans.
Networking 7(2), 1999), so that it holds no zero, and a zero ends it. So the reader is back in step
with the next frame, whatever was damaged. The wiring is for the scene (`uuv_array commission`).

The stamp is the exposure in ROS time: the array's clock plus the smallest lag of the arrivals of
late, which follows a clock that drifts, less `least_delay_s`: what passes from an exposure to the
arrival of its frame at least, which no clock tells. Of the firmware of the guide that is 0.011 s,
half of the exposure, the converters' filter and the line. Lags are by a steady clock, so that no
image is late where the machine's clock is set.

A port that gives no byte for `SILENT_S` is opened anew: an array that has lost its power does not
end a connection. An error that nothing here expects is told, and the port opened anew, too.
"""

import errno
import struct
import threading
import time
import zlib
from collections import deque
from queue import SimpleQueue
from urllib.parse import urlsplit

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array.core.messages import Refused
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.messages import StampOrder, image_to_message
from uuv_optical_array.nodes.shared.node import publish, run
from uuv_optical_array.nodes.shared.parameters import Parameter, Parameters

try:
    import serial
    from cobs import cobs
except ImportError as error:
    raise SystemExit(f"{error}; run: python3 -m pip install cobs pyserial") from None

PARAMETERS = {
    "port": Parameter(
        "/dev/ttyUSB0", Quantity("device, or a URL of pyserial such as socket://HOST:PORT"), True
    ),
    "baud_rate": Parameter(921_600, Quantity("of a device", "1/s", 50, 100_000_000), True),
    "frame_id": Parameter("follower/array", Quantity("frame of the image"), True),
    "max_delay_s": Parameter(
        0.1,
        Quantity(
            "a frame is refused that is later than the fastest of late by more", "s", 1e-3, 10
        ),
    ),
    "least_delay_s": Parameter(
        0.0, Quantity("least time from an exposure to the arrival of its frame", "s", 0, 10), True
    ),
}
VERSION, HEAD, CHECK = 1, struct.Struct("<BBIQ"), struct.Struct("<I")
MOST_BYTES = 1 << 20  # without a zero this is no frame
LAGS = 100  # arrivals that the array's clock is told by
LOOK_S = 0.005  # s, between two looks at what has arrived
WAIT_S = 0.2  # s, for bytes, and between two attempts to open the port
NOTED_NS = 1_000_000  # of a difference of clocks, which is read with a little noise
FORBIDDEN = "; run: sudo usermod -aG dialout $USER, and log in anew"
SILENT_S = 5.0  # s, longer than a board takes to start that opening its port resets


def frame_from(packet: bytes) -> tuple[int, int, np.ndarray]:
    """Return number, time in us and readings, shape ``(side, side)``, of a packet without its zero.

    Raises
    ------
    Refused
        For one that is damaged.
    """
    try:
        frame = cobs.decode(packet)
    except cobs.DecodeError as reason:
        raise Refused(f"corrupt: {reason}") from None
    if len(frame) < HEAD.size + CHECK.size:
        raise Refused(f"short: {len(frame)} bytes, less than head and check")
    (check,) = CHECK.unpack(frame[-CHECK.size :])
    if check != zlib.crc32(frame[: -CHECK.size]):
        raise Refused("corrupt: the checksum differs")
    version, side, number, time_us = HEAD.unpack_from(frame)
    readings = frame[HEAD.size : -CHECK.size]
    if version != VERSION:
        raise Refused(f"wrong version: {version}, not {VERSION}")
    if side < 2 or len(readings) != 2 * side * side:
        raise Refused(f"wrong size: {len(readings)} bytes of readings for {side} x {side}")
    return number, time_us, np.frombuffer(readings, "<u2").reshape(side, side)


def check_url(url: str) -> None:
    """Refuse what can never be opened, ValueError."""
    serial.serial_for_url(url, do_not_open=True)
    parts = urlsplit(url)
    if parts.scheme == "socket" and not (parts.hostname and parts.port):
        raise ValueError(f"port: {url!r} lacks host or port; write socket://HOST:PORT")


class SerialArrayNode(Node):
    """Publish each whole frame as ``array/image``; tell of the others, and wait for the port."""

    def __init__(self) -> None:
        super().__init__("serial_array_node")
        self.parameters = Parameters(self, PARAMETERS)
        self.diagnostics = Diagnostics(self)
        self.images = publish(self, Image, "array/image")
        self.order, self.connected = StampOrder(), False
        self.stopped = threading.Event()
        self.reader = threading.Thread(target=self.read, daemon=True)
        # A URL that can be none is a fault of the set-up, ValueError; what is not there may come.
        check_url(self.parameters["port"])
        self.steady, self.ahead_ns = Clock(clock_type=ClockType.STEADY_TIME), 0
        self.begin()
        self.arrived: SimpleQueue = SimpleQueue()
        # By a clock that no simulation stops; the executor of events has no guard conditions.
        self.create_timer(LOOK_S, self.on_arrival, clock=self.steady)
        self.context.on_shutdown(self.stop)
        self.reader.start()

    def stop(self) -> None:
        """End the thread that reads."""
        self.stopped.set()
        if self.reader.ident:  # else the set-up was refused
            self.reader.join()

    def destroy_node(self) -> None:
        """End the thread, and then the node."""
        self.stop()
        super().destroy_node()

    def begin(self) -> None:
        """Forget the port that was open before."""
        self.bytes, self.in_step = b"", False
        self.number, self.lags_ns = -1, deque(maxlen=LAGS)

    def read(self) -> None:
        """Hand over what arrives, in a thread of its own; open the port when it is there."""
        url, rate = self.parameters["port"], self.parameters["baud_rate"]
        while not self.stopped.is_set():
            try:
                with serial.serial_for_url(url, rate, timeout=WAIT_S) as port:
                    self.hand_over("")
                    self.read_from(port)
            except Exception as error:  # else the thread would end, and the node would be deaf
                cure = FORBIDDEN if getattr(error, "errno", None) == errno.EACCES else ""
                self.hand_over(f"no array: {error or type(error).__name__}{cure}")
                self.stopped.wait(WAIT_S)

    def read_from(self, port: serial.SerialBase) -> None:
        """Hand over what arrives at an open port; TimeoutError where nothing does."""
        heard_s = time.monotonic()
        while not self.stopped.is_set():
            if first := port.read(1):
                port.timeout = 0
                self.hand_over(first + port.read(4096))
                port.timeout = WAIT_S
                heard_s = time.monotonic()
            elif time.monotonic() - heard_s > SILENT_S:
                raise TimeoutError(f"{port.name or port.port} gives nothing for {SILENT_S:g} s")

    def hand_over(self, what: bytes | str) -> None:
        """Give bytes, or the state of the port, to the thread of the node."""
        self.arrived.put((self.steady.now().nanoseconds, what))

    def on_arrival(self) -> None:
        """Take all that has arrived."""
        while not self.arrived.empty():
            now_ns, what = self.arrived.get()
            if isinstance(what, str):
                self.begin()
                self.connected = not what
                if what:
                    self.diagnostics.fail(what)
                continue
            self.diagnostics.fail("")  # a port may be open, and silent
            *packets, self.bytes = (self.bytes + what).split(b"\0")
            if len(self.bytes) > MOST_BYTES:
                self.begin()
            for packet in packets:
                # The first may be the end of one that began before the port was open.
                if self.in_step and packet:
                    self.take(packet, now_ns)
                self.in_step = True

    def take(self, packet: bytes, now_ns: int) -> None:
        """Publish the image of a packet, or say why there is none."""
        try:
            number, time_us, readings = frame_from(packet)
            header = Header(frame_id=self.parameters["frame_id"])
            ahead_ns = self.get_clock().now().nanoseconds - self.steady.now().nanoseconds
            if abs(ahead_ns - self.ahead_ns) > NOTED_NS:
                self.ahead_ns = ahead_ns
            stamp_ns = self.ahead_ns + self.exposed_ns(number, time_us, now_ns)
            header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 10**9)
            self.order.check(header)
        except Refused as reason:
            self.diagnostics.refuse(str(reason))
            return
        self.images.publish(image_to_message(readings, header))
        self.diagnostics.answer(
            values=lambda: {"peak_counts": f"{readings.max()}", "number": str(number)}
        )

    def exposed_ns(self, number: int, time_us: int, now_ns: int) -> int:
        """Return the steady time of an exposure, and tell of frames that are missing before it."""
        if number < self.number:  # the array has started anew, and its clock too
            self.lags_ns.clear()
        elif number > self.number + 1 and self.number >= 0:
            missing = number - self.number - 1
            self.diagnostics.refuse(f"lost: {missing} frames before number {number}")
        self.number = number
        self.lags_ns.append(now_ns - 1000 * time_us)
        delay_s = (self.lags_ns[-1] - min(self.lags_ns)) * 1e-9
        if delay_s > self.parameters["max_delay_s"]:
            raise Refused(
                f"late: {delay_s:.3f} s behind the fastest frame, more than max_delay_s "
                f"{self.parameters['max_delay_s']:g}"
            )
        least_ns = round(1e9 * self.parameters["least_delay_s"])
        return 1000 * time_us + min(self.lags_ns) - least_ns


def main(args: list[str] | None = None) -> None:
    """Run the node."""
    run(SerialArrayNode, args)


if __name__ == "__main__":
    main()
