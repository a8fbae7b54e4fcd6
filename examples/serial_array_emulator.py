"""An array on a serial line that is none: images of a scene, sent over a pseudo-terminal.

    python3 examples/serial_array_emulator.py --link /tmp/array
    python3 examples/serial_array_node.py --ros-args -p port:=/tmp/array

It sends what serial_array_node.py reads, ten images a second of an array that weaves behind the
lamp, until Ctrl-C. `--spoil 0.05` flips a bit or drops bytes in that share of the packets. Give the
scene's name to the nodes, too. It needs the extra `hardware`.
"""

import argparse
import os
import struct
import time
import tty
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from cobs import cobs

from uuv_optical_array import ForwardModel
from uuv_optical_array.core.messages import as_wired
from uuv_optical_array.forward.scene import load_scene


def packet(number: int, time_us: int, readings: np.ndarray) -> bytes:
    """Return a frame of readings, shape ``(side, side)``, encoded and with its closing zero."""
    frame = (
        struct.pack("<BBIQ", 1, len(readings), number, time_us) + readings.astype("<u2").tobytes()
    )
    return cobs.encode(frame + struct.pack("<I", zlib.crc32(frame))) + b"\0"


def images(scene: str, rate_hz: float, seed: int) -> Iterator[tuple[float, np.ndarray]]:
    """Yield the time, s, and the readings of a drive, in the order of the scene's wiring."""
    settings, rng = load_scene(scene), np.random.default_rng(seed)
    model = ForwardModel(settings)
    for number in range(2**32):
        t = number / rate_hz
        y, z, pitch, yaw = (
            a * np.sin(f * t) for a, f in ((0.3, 0.4), (0.3, 0.5), (0.1, 0.6), (0.1, 0.7))
        )
        image = model.expose([-4.5 + np.cos(0.2 * t), y, z, pitch, yaw], rng, time_s=t)
        yield t, as_wired(image, settings.array.wiring)


def spoilt(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a packet with a bit flipped, or with a few bytes lost."""
    damaged, place = bytearray(data), int(rng.integers(len(data)))
    if rng.random() < 0.5:
        damaged[place] ^= 1 << int(rng.integers(8))
    else:
        del damaged[place : place + int(rng.integers(1, 9))]
    return bytes(damaged)


def main() -> None:
    """Send images until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--link", type=Path, default=Path("array"), help="name of the port")
    parser.add_argument("--scene", default="follow", help="ready scene or YAML file")
    parser.add_argument("--rate-hz", type=float, default=10.0, help="images a second")
    parser.add_argument("--spoil", type=float, default=0.0, help="share of the packets to damage")
    parser.add_argument("--seed", type=int, default=1, help="of noise and damage")
    args = parser.parse_args()
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    args.link.unlink(missing_ok=True)
    args.link.symlink_to(os.ttyname(theirs))
    print(f"port: {args.link}", flush=True)
    damage, begin, sent, lost = np.random.default_rng(args.seed), time.monotonic(), 0, 0
    try:
        for number, (t, image) in enumerate(images(args.scene, args.rate_hz, args.seed)):
            time.sleep(max(0.0, begin + t - time.monotonic()))
            data = packet(number, round(1e6 * t), image)
            if damage.random() < args.spoil:
                data, lost = spoilt(data, damage), lost + 1
            # Nobody reads: as on a real line, what does not fit is lost.
            with suppress(BlockingIOError):
                sent += os.write(ours, data) == len(data)
    except KeyboardInterrupt:
        print(f"sent: {sent} packets, {lost} of them damaged")
    finally:
        args.link.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
