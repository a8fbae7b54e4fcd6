"""An emulated array on a serial line: images of a scene, sent over a pseudo-terminal.

    python3 examples/serial_array_emulator.py --link /tmp/array
    python3 examples/serial_array_node.py --ros-args -p port:=/tmp/array

It sends what serial_array_node.py reads, ten images a second of an array that weaves behind the
lamp, until Ctrl-C. `--spoil 0.05` flips a bit or drops bytes in that share of the packets. Give the
scene's name to the nodes, too. It needs the extra `hardware`.

With `--bench 4` the array lies on a bench in the dark, so that `uuv_array commission --lamp 4` can
be rehearsed. Type, each with Enter: `1` moves a torch from port to starboard, `2` from top to
bottom, `lamp` lights the lamp 4 m ahead, `off` switches it off. `--in-air` takes the water away, as
that of `commission` does, and `--shuffle` connects the detectors in a random order.
"""

import argparse
import os
import select
import struct
import sys
import time
import tty
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from uuv_optical_array import ForwardModel
from uuv_optical_array.calibration.acceptance import in_air
from uuv_optical_array.core.messages import as_wired
from uuv_optical_array.forward.scene import Scene, load_scene

try:
    from cobs import cobs
except ImportError as error:
    raise SystemExit(f"{error}; run: python3 -m pip install cobs") from None

SWEEP_S = 8.0  # that a sweep of the torch takes
TORCH_M, TORCH_SHARE = 0.2, 0.6  # from the array; share of full scale in front of a detector
BEYOND_M, BEYOND_RAD = 0.2, np.radians(80)  # how far a sweep goes beside the middle of the array
HELD = 0.02, -0.03, 0.02, 0.03  # m and rad, by how much hands miss the lamp's place
SWEEPS = {"1": 1, "2": 2}  # the axis of each, y or z


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


class Bench:
    """An array in the dark, a torch that is moved before it, and its lamp at a range, m."""

    def __init__(self, scene: Scene, range_m: float, rng: np.random.Generator) -> None:
        self.model, self.rng = ForwardModel(scene), rng
        self.wiring, self.middle = scene.array.wiring, [scene.array.bow_m, 0.0, 0.0]
        self.radius_m, self.half_m = scene.array.radius_m, scene.array.width_m / 2
        y, z, pitch, yaw = HELD
        self.lamp = self.model.light(np.array([-range_m, y, z, pitch, yaw])) - scene.black_counts
        self.bright = TORCH_SHARE * (scene.full_scale_counts - scene.black_counts)
        self.what, self.since_s = "off", 0.0

    def do(self, what: str, now_s: float) -> str:
        """Begin what was typed, and say what happens."""
        if what not in (*SWEEPS, "lamp", "off"):
            return f"{what}: unknown; type 1, 2, lamp or off"
        self.what, self.since_s = what, now_s
        return f"{what}: the torch moves for {SWEEP_S:g} s" if what in SWEEPS else f"{what}: done"

    def image(self, now_s: float) -> np.ndarray:
        """Return what the array sends at a time, s."""
        light, part = np.zeros_like(self.lamp), (now_s - self.since_s) / SWEEP_S
        if self.what == "lamp":
            light = self.lamp
        elif self.what in SWEEPS and part < 1:
            # Where lamps are told apart by their modulation, the last one takes the torch's place.
            torch = self.torch(SWEEPS[self.what], 1 - 2 * part)
            light[-len(torch) :] = torch
        return as_wired(self.model.read(light + self.model.noise.black, self.rng), self.wiring)

    def torch(self, axis: int, along: float) -> np.ndarray:
        """Return the light of a torch beside the middle, from 1 to -1 along y or z.

        It shines like a matt disc and follows the surface: before a sphere it looks at its middle.
        """
        ahead = np.array([1.0, 0.0, 0.0])
        place = (self.half_m + BEYOND_M) * along * np.eye(3)[axis]
        if self.radius_m is not None:
            angle = BEYOND_RAD * along
            ahead = np.cos(angle) * ahead + np.sin(angle) * np.eye(3)[axis]
            place = self.radius_m * ahead
        array = self.model.array
        rays = self.middle + place + TORCH_M * ahead - array.positions
        away = np.linalg.norm(rays, axis=1)
        falls = np.maximum((rays * array.normals).sum(axis=1), 0) / away
        leaves = np.maximum(rays @ ahead, 0) / away
        share = falls * leaves * (TORCH_M / away) ** 2
        return self.bright * share.reshape(array.side, array.side)


def on_bench(bench: Bench, rate_hz: float) -> Iterator[tuple[float, np.ndarray]]:
    """Yield the time, s, and the readings of an array on a bench, as is typed."""
    for number in range(2**32):
        for word in typed():
            print(bench.do(word, number / rate_hz), flush=True)
        yield number / rate_hz, bench.image(number / rate_hz)


def typed() -> list[str]:
    """Return the lines that were typed since the last call."""
    if not select.select([sys.stdin], [], [], 0)[0]:
        return []
    return os.read(sys.stdin.fileno(), 4096).decode().split()


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
    parser.add_argument("--bench", type=float, help="on a bench, with the lamp so many m ahead")
    parser.add_argument("--in-air", action="store_true", help="on the bench: without water")
    parser.add_argument("--shuffle", action="store_true", help="on the bench: wired at random")
    args = parser.parse_args()
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    args.link.unlink(missing_ok=True)
    args.link.symlink_to(os.ttyname(theirs))
    print(f"port: {args.link}", flush=True)
    taken = images(args.scene, args.rate_hz, args.seed)
    if args.bench is not None:
        scene, rng = load_scene(args.scene), np.random.default_rng(args.seed)
        scene = in_air(scene) if args.in_air else scene
        if args.shuffle:
            wiring = rng.permutation(scene.array.detectors_per_side**2).tolist()
            scene = replace(scene, array=replace(scene.array, wiring=wiring))
        print("dark; type 1, 2, lamp or off, and Enter", flush=True)
        taken = on_bench(Bench(scene, args.bench, rng), args.rate_hz)
    damage, begin, sent, lost = np.random.default_rng(args.seed), time.monotonic(), 0, 0
    try:
        for number, (t, image) in enumerate(taken):
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
