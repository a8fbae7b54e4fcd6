"""``uuv_array commission``: find an array's wiring with a torch, and test it with the lamp.

Find which reading belongs to which detector, and write the scene with this order as array.wiring,
by which every node reorders its images. Move a torch in front of the array, as the command tells
you: from port to starboard, then from top to bottom. The command finds any wiring, mirrored, turned
or scrambled; by one lamp a mirrored array gives false poses that no node notices. An array that
demodulates sees no torch: move one of the lamps in its place. --lamp adds the acceptance test
before the first dive, with the lamp, or all lamps, at a known range. It tests noise, dark level and
light of the detectors and of the whole array, prints what to do about a failure, and prints the
estimated pose beside the given one. The exit code is 1 if anything fails.

  uuv_array commission --scene sea.yaml -o sea.yaml     listens to array/image
  uuv_array commission --set image_topic=/bow/array/image
  uuv_array commission torch                            a bag of both sweeps; needs no ROS
  uuv_array commission --lamp 4 --in-air                the acceptance test on deck, lamp at 4 m
Keep the array in the dark or in steady light, and leave 1 s without the torch before (10 s with
--lamp), between and after the sweeps and at least 3 images for each column. An array on a serial
line needs the node that publishes its images. Every 15 s the command prints what it has not seen
yet; after 10 minutes without progress, or at Ctrl-C, it ends and writes nothing. To rehearse, use
the torch and the lamp of examples/serial_array_emulator.py.
"""

import argparse
import dataclasses
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from uuv_optical_array.calibration.acceptance import Acceptance, in_air
from uuv_optical_array.calibration.wiring import TorchSweeps, description
from uuv_optical_array.cli import bag, options, outputs
from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.geometry import IN_DEGREES, Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.estimate import Estimate
from uuv_optical_array.forward.scene import save_scene
from uuv_optical_array.forward.scene_files import own_text

MODULATED = "the array sees modulated light only: move one of the lamps, lit, in place of the torch"
AHEAD = "add the acceptance test, which ends with the lamp at this distance ahead of base_link"
LAMP = Quantity(AHEAD, "m", 0.3, 100)
TELL_S, PATIENCE_S = 15.0, 600.0  # without anything new: until it is reported, and until the end


class Watch:
    """Hands images over, reports what is not seen, and ends where that lasts.

    Time is of a steady clock, so that the command ends where no image comes.
    """

    def __init__(
        self,
        sweeps: TorchSweeps,
        show: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sweeps, self._show, self._clock = sweeps, show, clock
        self._since = self._told = clock()
        self._missing = sweeps.missing

    def take(self, stamp_ns: int, image: Array) -> None:
        """Take an image, as `TorchSweeps.take`."""
        self._sweeps.take(stamp_ns, image)

    def wanted(self) -> bool:
        """Return whether more is to be seen and was waited for no longer than `PATIENCE_S`."""
        missing, now = self._sweeps.missing, self._clock()
        # Of the same thing only figures change.
        if missing.partition(":")[0] != self._missing.partition(":")[0]:
            self._since = self._told = now
        self._missing = missing
        if missing and now - self._told >= TELL_S:
            self._told = now
            self._show(f"not seen: {missing}")
        return bool(missing) and not self.over

    @property
    def over(self) -> bool:
        """Whether nothing new was seen for `PATIENCE_S`."""
        return self._clock() - self._since >= PATIENCE_S


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    bag.add_bag(parser, {"image_topic": bag.READING["image_topic"]}, "listen to the topic")
    options.add_number(parser, "lamp", LAMP, None, float)
    about = "with --lamp: test on deck, without water and with the wider beam in air"
    parser.add_argument("--in-air", action="store_true", help=about)
    outputs.add_scene_file(parser, "commissioned.yaml")


def run(args: argparse.Namespace) -> int:
    """Watch both sweeps and write the scene."""
    if args.in_air and args.lamp is None:
        raise options.OptionError("--in-air: it is of the acceptance test; give --lamp, too")
    scene = options.scene_of(args)
    text = own_text(args.scene)
    output = outputs.file_to_write(args.output, "--output", outputs.SCENE)
    array = dataclasses.replace(scene.array, wiring=None)
    side = array.detectors_per_side
    listen = None
    if args.bag is None:
        listen = needs("ros", "uuv_optical_array.nodes.shared.image_listener").listen
    show = partial(print, flush=True)
    if "demodulation" in scene.effects:
        show(MODULATED)
    if args.lamp is None:
        sweeps = TorchSweeps(side, scene.full_scale_counts, show)
    else:
        sweeps = Acceptance(in_air(scene) if args.in_air else scene, args.lamp, show)
    if listen is not None:
        topic, watch = dict(args.set)["image_topic"], Watch(sweeps, show)
        listen(topic, array, watch.take, watch.wanted, scene.lamp_count)
        if sweeps.missing:
            text = f"nothing was written; not seen: {sweeps.missing}"
            if watch.over:
                raise ValueError(f"{topic}: no progress for {PATIENCE_S:g} s: {text}")
            print(f"interrupted: {text}")
            return options.INTERRUPTED
    else:
        as_wired = dataclasses.replace(scene, array=array)
        recording = bag.read_bag(args, as_wired, poses_needed=False)
        for line in recording.left_out:
            print(line)
        for stamp, image in zip(recording.stamps_ns, recording.images, strict=True):
            sweeps.take(int(stamp), image)
        sweeps.end_sweep()
        if sweeps.missing:
            raise ValueError(f"bag {args.bag}: not seen: {sweeps.missing}")
    wiring = sweeps.wiring
    assert wiring is not None  # as nothing is missing
    print(f"wiring: {description(wiring, side)}")
    in_order = wiring == list(range(len(wiring)))
    wired = dataclasses.replace(scene.array, wiring=None if in_order else wiring)
    comment = f"Commissioned by uuv_array commission, starting from {scene.name}."
    save_scene(dataclasses.replace(scene, array=wired), output, comment, text)
    print(f"scene: {output}")
    return report(sweeps, side, args.lamp) if isinstance(sweeps, Acceptance) else 0


def report(test: Acceptance, side: int, range_m: float) -> int:
    """Print what passes and what fails, and return the exit code."""
    detectors, whole, (dark, pedestal), seen = test.verdict()
    for row in range(side):
        print("  ".join("FAIL" if (row, column) in detectors else "pass" for column in range(side)))
    print(f"darkness: {dark:.4g} counts; the scene's: {pedestal:.4g}")
    if seen is not None:
        print(places(seen, range_m))
    for (row, column), text in sorted(detectors.items()):
        print(f"detector [{row}, {column}] fails: {text}")
    for text in whole:
        print(f"the array as a whole fails: {text}")
    failed = len(detectors) + len(whole)
    faults = "1 fault: repair it" if failed == 1 else f"{failed} faults: repair them"
    verdict = f"{faults}, and test again" if failed else "passed"
    print(f"acceptance test: {verdict}")
    return int(failed > 0)


def places(seen: Estimate, range_m: float) -> str:
    """Return the given pose, straight behind the lamp, beside the one that is seen."""
    std, pose = np.sqrt(np.diag(seen.covariance)) * IN_DEGREES, seen.pose * IN_DEGREES
    told = [-range_m, 0.0, 0.0, 0.0, 0.0]
    lines = ["                told    found      std"]
    names = "x (m)", "y (m)", "z (m)", "pitch (deg)", "yaw (deg)"
    for name, *values in zip(names, told, pose, std, strict=True):
        lines.append(f"{name:<11}" + "".join(f"{each:9.2f}" for each in values))
    return "\n".join(lines)
