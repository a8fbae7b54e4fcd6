"""``uuv_array commission``: find an array's wiring with a torch, and test it with the lamp.

Find which reading is which detector, and write it into the scene as array.wiring, in place of any
that is there; every node reorders its images by it. Move a torch in front of the array, as the
command tells you: from port to starboard, then from top to bottom. It finds any wiring, mirrored,
turned or scrambled; a mirrored array gives false poses that no software can detect. An array that
demodulates sees no torch: move one of the lamps in its place. --lamp adds the acceptance test
before the first dive, with the lamp, or all lamps, at a known range: detectors and the whole pass
or fail by noise, level in the dark and light, with what to do; the exit code is 1 if any fails.

  uuv_array commission --scene sea.yaml -o sea.yaml     listens to array/image
  uuv_array commission --set image_topic=/bow/array/image
  uuv_array commission torch                            a bag of both sweeps; needs no ROS
  uuv_array commission --lamp 4 --in-air                the acceptance test on deck, lamp at 4 m
Keep the array in the dark or in steady light, and leave 1 s without the torch before, between and
after the sweeps and at least 3 images for each column. An array on a serial line needs the node
that publishes its images. Ctrl-C writes nothing.
"""

import argparse
import dataclasses
from functools import partial

from uuv_optical_array.calibration.acceptance import Acceptance, in_air
from uuv_optical_array.calibration.wiring import TorchSweeps, description
from uuv_optical_array.cli import bag, options, outputs
from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.scene import save_scene
from uuv_optical_array.forward.scene_files import own_text

MODULATED = "the array sees modulated light only: move one of the lamps, lit, in place of the torch"
AHEAD = "then test with the lamp so far ahead of base_link: the acceptance test"
LAMP = Quantity(AHEAD, "m", 0.3, 100)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    bag.add_bag(parser, {"image_topic": bag.READING["image_topic"]}, "listen to the topic")
    options.add_number(parser, "lamp", LAMP, None, float)
    about = "on deck: without water, a wider beam"
    parser.add_argument("--in-air", action="store_true", help=about)
    outputs.add_scene_file(parser, "commissioned.yaml")


def run(args: argparse.Namespace) -> int:
    """Watch both sweeps and write the scene."""
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
        topic = dict(args.set)["image_topic"]
        listen(topic, array, sweeps.take, lambda: not sweeps.complete, scene.lamp_count)
    else:
        as_wired = dataclasses.replace(scene, array=array)
        recording = bag.read_bag(args, as_wired, poses_needed=False)
        for stamp, image in zip(recording.stamps_ns, recording.images, strict=True):
            sweeps.take(int(stamp), image)
        sweeps.end_sweep()
        if not sweeps.complete:
            what = "both sweeps are" if sweeps.wiring is None else "10 s of the lamp are"
            raise ValueError(f"bag {args.bag}: it ends before {what} over")
    wiring = sweeps.wiring
    if wiring is None or not sweeps.complete:
        print("interrupted: nothing was written")
        return options.INTERRUPTED
    print(f"wiring: {description(wiring, side)}")
    in_order = wiring == list(range(len(wiring)))
    wired = dataclasses.replace(scene.array, wiring=None if in_order else wiring)
    comment = f"Commissioned by uuv_array commission, starting from {scene.name}."
    save_scene(dataclasses.replace(scene, array=wired), output, comment, text)
    print(f"scene: {output}")
    return report(sweeps, side) if isinstance(sweeps, Acceptance) else 0


def report(test: Acceptance, side: int) -> int:
    """Print what passes and what fails, and return the exit code."""
    detectors, whole = test.faults()
    for row in range(side):
        print("  ".join("FAIL" if (row, column) in detectors else "pass" for column in range(side)))
    for (row, column), text in sorted(detectors.items()):
        print(f"detector [{row}, {column}] fails: {text}")
    for text in whole:
        print(f"the whole fails: {text}")
    failed = len(detectors) + len(whole)
    verdict = f"{failed} faults: mend them, and test again" if failed else "passed"
    print(f"acceptance test: {verdict}")
    return int(failed > 0)
