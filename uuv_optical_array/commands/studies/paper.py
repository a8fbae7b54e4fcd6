"""``uuv_array study paper``: the figures of Eren et al. (2016), and what their text says."""

import argparse
import math

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.eren2016.figures import STATEMENTS, Statement, agreement
from uuv_optical_array.studies.eren2016.reproduction import Reproduction, as_object
from uuv_optical_array.studies.separation import THRESHOLD_DEG

DESCRIPTION = """\
Repeat Figs 4, 5 and 6 of Eren et al. (2016): the spectral angle between the signatures of an
aligned array and of one that is shifted to starboard or turned, for planar and curved arrays of
3 x 3 to 101 x 101 detectors, 4 to 8 m behind the lamp. Every number that the paper's text states of
these figures is printed beside ours, and again for other choices where the paper leaves one open:
the beam's width, the blur, the scaling of the five key parameters, the noise."""

EPILOG = """\
examples:
  uuv_array study paper                              the tables, and the figures into paper.png
  uuv_array study paper --output eren2016.png        the picture where you want it
  uuv_array study paper --json                       one JSON object, the curves with it
  uuv_array study paper --scene sea.yaml             your own lamp, water and sphere
Ctrl-C ends it early and reports what there is. docs/results/paper.md explains every figure."""

NUMBERS = {"seed": options.Number(options.SEED, 1)}


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "paper",
        run,
        "repeat the figures of Eren et al. (2016), their numbers beside ours",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "eren2016")
    options.add_numbers(parser, NUMBERS)
    outputs.add_picture(parser, "paper.png")
    options.add_json(parser)
    options.add_report(parser)


def number(ours: float) -> str:
    """Return one of our numbers as it is printed."""
    return "flat" if math.isnan(ours) else f"{ours:.1f}"


def verdict(statement: Statement, ours: float) -> str:
    """Return how our number compares with the paper's."""
    met = statement.met(ours)
    if met is not None:
        return "met" if met else "missed"
    return "" if statement.paper is None or math.isnan(ours) else f"{ours - statement.paper:+.1f}"


def report(found: Reproduction) -> str:
    """Return the tables, each with the rows that there are."""
    line = "{:<4}{:<4}{:<44}{:>16}{:>8}  {}"
    lines = [line.format("no.", "fig", "spectral angle (deg)", "paper", "ours", "")]
    for i, (statement, ours) in enumerate(zip(STATEMENTS, found.points, strict=False), 1):
        values = (statement.label, number(ours), verdict(statement, ours))
        lines.append(line.format(i, statement.figure, statement.text, *values))
    if found.sizes:
        lines += [
            "",
            f"Curved arrays: angles at 4 m; the least move that shows {THRESHOLD_DEG:g} deg there;",
            "and the angle between two readings of one pose, with 10 bits and 1 count of noise.",
        ]
        row = "{:<12}" + 6 * "{:>11}"
        heads = ("0.2 m", "10 deg", "shift (m)", "yaw (deg)", "noise 4 m", "noise 8 m")
        lines.append(row.format("detectors", *heads))
        for sized in found.sizes:
            side, at_shift, shift, at_yaw, yaw, *noise = sized.values()
            least = ["none" if step is None else f"{step:g}" for step in (shift, yaw)]
            cells = (number(at_shift), number(at_yaw), *least, *map(number, noise))
            lines.append(row.format(f"{side} x {side}", *cells))
    if found.choices:
        lines += [
            "",
            "Other choices, one at a time, by no. of the first table. met: how many of < and >;",
            "rms: of the differences from the stated angles; flat: the aligned image has no peak.",
        ]
        row = "{:<30}" + len(STATEMENTS) * "{:>6}" + "{:>5}{:>6}"
        lines.append(row.format("", *range(1, len(STATEMENTS) + 1), "met", "rms"))
        stated = [s.label.replace(" ", "") if s.paper is not None else "" for s in STATEMENTS]
        lines.append(row.format("the paper", *stated, "", ""))
        for text, points in found.choices:
            met, rms_deg = agreement(points)
            lines.append(row.format(text, *map(number, points), met, number(rms_deg)))
    return "\n".join(line.rstrip() for line in lines)


def run(args: argparse.Namespace) -> int:
    """Compute, print and draw."""
    (seed,) = options.numbers_of(args, NUMBERS)
    scene = load_scene(args.scene)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    found = Reproduction()
    try:
        found.compute(scene, seed, progress.over)
    except KeyboardInterrupt:
        if not found.points:
            print("interrupted: nothing computed")
            return options.INTERRUPTED
    picture = None
    if found.drawable:
        from uuv_optical_array.plots.studies.eren2016 import draw_paper

        picture = str(output)
        draw_paper(found.curves, scene.name, output)
    if args.json:
        told = {"scene": scene.name, "seed": seed, "picture": picture}
        print(json_text({**told, **as_object(found)}))
    else:
        print(f"Eren et al. (2016) and scene {scene.name}\n\n{report(found)}\n")
        print(f"picture: {picture}" if picture else "no picture")
        if not found.complete:
            print("interrupted: the tables end where the work ended")
    return 0 if found.complete else options.INTERRUPTED
