"""``uuv_array study robustness``: what estimates are worth where the sea is not the scene."""

import argparse
from collections.abc import Sequence
from typing import Any

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.studies.robustness.kinds import kinds_named
from uuv_optical_array.studies.robustness.study import KindResult, measure_kinds

DESCRIPTION = """\
Estimate poses from images of a sea that is not the scene, kind of mismatch by kind: another lamp,
other water, daylight, broken detectors, shade, images of no lamp at all. The estimator believes the
scene. An honest one answers what its prior covers and knows how well, and refuses the rest; an
answer off by more than six of its own standard deviations is false.
docs/reference/mismatches.md has the kinds and what to do about each."""

EPILOG = """\
examples:
  uuv_array study robustness                               every kind, in the default scene
  uuv_array study robustness --method sam                  the paper's method
  uuv_array study robustness --kinds k-0.05,power_x0.8     some kinds
  uuv_array study robustness --scene night_plume --kinds nothing,moving
Ctrl-C ends it early and reports the kinds it has."""

NUMBERS = {
    "poses": options.Number(Quantity("how many random poses of each kind", "", 1, 1e7), 300),
    "seed": options.Number(options.SEED, 1),
}
COLUMNS = {
    "kind": "kind",
    "times_prior": "times the prior",
    "answered": "answered",
    "beyond_6_sigma": "beyond 6 sigma",
    "indistinguishable": "indistinguishable",
    "beyond_1_m": "beyond 1 m",
    "rms_range_m": "range (m)",
    "rms_across_m": "across (m)",
    "rms_angle_deg": "angle (deg)",
    "nees_mean": "NEES",
}


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "robustness",
        run,
        "measure what estimates are worth where the sea is not the scene",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "follow")
    options.add_method(parser)
    parser.add_argument(
        "--kinds",
        metavar="NAME,...",
        help="kinds of mismatch, with commas between them (default: all that the scene can have)",
    )
    options.add_numbers(parser, NUMBERS)
    options.add_json(parser)
    outputs.add_picture(parser, "robustness.png")


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def cells(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return the table of kinds, its heads first."""
    return [list(COLUMNS.values()), *([_cell(row[key]) for key in COLUMNS] for row in rows)]


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Return the kinds as text."""
    lines = cells(rows)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])])
        for line in lines
    )


def run(args: argparse.Namespace) -> int:
    """Run the study, print and draw it."""
    count, seed = options.numbers_of(args, NUMBERS)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    scene = options.scene_of(args)
    try:
        kinds = kinds_named(args.kinds, scene)
    except ValueError as error:
        raise options.OptionError(f"--{error}") from None
    found: list[KindResult] = []
    try:
        estimator = Estimator(scene, args.method).wait()
        for result in measure_kinds(
            estimator, kinds, count, seed, lambda name, frames: progress.over(frames, "frame", name)
        ):
            found.append(result)
    except KeyboardInterrupt:
        print("interrupted: nothing measured")
        return options.INTERRUPTED
    complete = len(found) == len(kinds) and len(found[-1].frames.errors) == count
    rows = [result.as_object() for result in found]
    about = f"{args.method} in scene {scene.name}, {count} poses a kind, seed {seed}"
    from uuv_optical_array.plots.studies.robustness import draw_robustness

    draw_robustness(rows, about, output)
    if args.json:
        told = {"scene": scene.name, "method": args.method, "seed": seed, "poses": count}
        print(json_text({**told, "complete": complete, "kinds": rows, "picture": str(output)}))
    else:
        print(f"{about}\n\n{report(rows)}\n\npicture: {output}")
        if not complete:
            print("interrupted: the table ends where the work ended")
    return 0 if complete else options.INTERRUPTED
