"""``uuv_array study drives``: what a track learns of the sea while the vehicles move."""

import argparse
from functools import partial
from typing import Any

from uuv_optical_array.cli import options, progress
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.studies.drives import Drive, as_object, measure_drives

DESCRIPTION = """\
Drive from 8 to 4 m behind the lamp and back, swaying, each time through another sea: what the
scene's prior leaves open, such as the lamp's power, is drawn from it and stays for the drive. Each
image goes through the stages of the nodes, and the track is compared with the truth. A track that
knows how well it knows has a mean NEES of 5. At the end, when the track has learnt most of the sea,
it is compared with poses of single images, which know the prior only."""

EPILOG = """\
examples:
  uuv_array study drives                        50 drives of a minute in the default scene
  uuv_array study drives --scene harbour        in another one
  uuv_array study drives --rate 20 --seconds 30
Ctrl-C ends the study early and reports the drives it has."""

NUMBERS = {
    "drives": options.Number(Quantity("how many drives", "", 1, 1e5), 50),
    "seconds": options.Number(Quantity("duration of a drive", "s", 10, 3600), 60.0),
    "rate": options.Number(Quantity("rate of the images", "Hz", 0.5, 1000), 10.0),
    "seed": options.Number(options.SEED, 1),
}


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "drives",
        run,
        "measure tracks of drives through seas drawn from the scene's prior",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "follow")
    options.add_method(parser)
    options.add_numbers(parser, NUMBERS)
    options.add_json(parser)


def report(told: dict[str, Any]) -> str:
    """Return what `as_object` told in words."""
    heads = f"{'':<8}{'tracked':>9}{'single':>9}   RMS error in the last {told['last_s']:g} s"
    lines = [
        f"{name:<8}{told['rms_tracked'][name]:>9.4f}{told['rms_single'][name]:>9.4f}   {unit}"
        for name, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
    ]
    low, median, high = told["nees_of_drives"]
    return "\n".join(
        [
            heads,
            *lines,
            "",
            f"range, tracked over single: {told['range_ratio']:.2f}",
            f"mean NEES: {told['nees_mean']:.2f}; of single drives {low:.2f} to {high:.2f} "
            f"(5 to 95 %), median {median:.2f}",
            f"off by more than 6 of its own standard deviations: {told['beyond_6_sigma']} "
            f"of {told['frames']}",
            f"not in the track: {told['refused']} of {told['frames']}",
        ]
    )


def run(args: argparse.Namespace) -> int:
    """Run the study and print it."""
    count, seconds, rate, seed = options.numbers_of(args, NUMBERS)
    scene = options.scene_of(args)
    if not scene.prior.nuisance_std():
        raise options.OptionError(
            f"--scene: {scene.name} has no prior to draw seas from; give it one"
        )
    found: list[Drive] = []
    try:
        estimator = Estimator(scene, args.method).wait()
        over = partial(progress.over, unit="drive")
        for each in measure_drives(estimator, count, seconds, rate, seed, over):
            found.append(each)
    except KeyboardInterrupt:
        if not found:
            print("interrupted: nothing measured")
            return options.INTERRUPTED
    told = as_object(found)
    complete = len(found) == count
    if args.json:
        about = {"scene": scene.name, "method": args.method, "seed": seed, "complete": complete}
        print(json_text({**about, **told}))
    else:
        print(
            f"{args.method} in scene {scene.name}, {len(found)} drives of {seconds:g} s at "
            f"{rate:g} Hz, seed {seed}\n\n{report(told)}"
        )
        if not complete:
            print("interrupted: only the drives that were complete count")
    return 0 if complete else options.INTERRUPTED
