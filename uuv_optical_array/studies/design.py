"""``uuv_array study design``: compare designs of array and lamp, and print the best ones.

Sweep the array (shape, detectors, size, radius of curvature), the width of the lamp's beam and, in
a scene with `lamps`, their number, distance from the centre and tilt. Each design is scored by the
criteria of Eren et al. (2016), whether the signature resolves 0.2 m and 10 deg 4 to 8 m behind the
lamp and how many detectors that takes, and by the Cramer-Rao bound over the working volume.
Pareto-optimal designs are printed. Scores go into a picture and a CSV, from which a sweep resumes.

  uuv_array study design                             the default scene, into follow.design.csv
  uuv_array study design --sweep width_m=0.3,0.4 detectors_per_side=5,7    some of it
  uuv_array study design --take 2                    all of it, and design 2 as a scene file
  uuv_array study design --scene leading_lights --sweep lamps=1,3 spread_m=0.2,0.4 tilt_deg=0,3
The Pareto front `fits` is that of arrays no wider than the scene's, `resolved` that of those among
them that meet the criterion at 4 m, `any` that of all arrays. A design is left out if one on the
front has no more detectors and bounds that are at most 10 % larger. Ctrl-C ends it early and draws
what there is.
"""

import argparse
import itertools
import sys
from collections.abc import Iterator
from typing import Annotated

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.forward.scene import save_scene, scene_from_settings
from uuv_optical_array.plots import style
from uuv_optical_array.studies.designs.choice import Choice, report
from uuv_optical_array.studies.designs.picture import draw
from uuv_optical_array.studies.designs.scores import (
    SEED,
    ScoredDesign,
    origin,
    scored,
    scored_before,
)
from uuv_optical_array.studies.designs.sweep import SWEPT, designed, designs_of, sweep_of
from uuv_optical_array.studies.shared.results import until_interrupted, write

POSES = Quantity("poses for the bound", "", 1, 1e7)
TAKEN = Quantity("number of a design in the table to write as a scene, too", "", 1, 1e9)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    about = f"values of {', '.join(SWEPT)} (default: a grid about the scene's own)"
    parser.add_argument("--sweep", nargs="+", default=[], metavar="NAME=VALUE,...", help=about)
    options.add_number(parser, "poses", POSES, 1000)
    about = "picture, with the CSV of every design beside it (default: SCENE.design.png here)"
    outputs.add_picture(parser, None, about=about)
    options.add_number(parser, "take", TAKEN, None, int)
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Score what is not scored yet, and print, write and draw it."""
    scene = options.scene_of(args)
    with options.checking_options():
        sweep = sweep_of(scene, args.sweep)
    picture = args.output or f"{scene.name}.design.png"
    picture = outputs.file_to_write(picture, "--output", outputs.PICTURE)
    csv = outputs.file_to_write(picture.with_suffix(".csv"), "--output")
    told, about = sys.stderr if args.json else sys.stdout, origin(scene, args.poses)
    there = {row.design: row for row in scored_before(csv, about)}
    designs, dropped = designs_of(sweep)
    if count := sum(dropped.values()):
        print(f"left out: {count} designs whose corners lie beyond their sphere", file=told)
    if known := [there[design] for design in designs if design in there]:
        print(f"{csv}: {len(known)} designs are there already", file=told)
    left = progress.over([design for design in designs if design not in there], "design")

    def kept() -> Iterator[ScoredDesign]:
        for row in scored(scene, left, args.poses):
            there[row.design] = row
            write(csv, about, [one.columns() for one in there.values()])
            yield row

    rows, complete = until_interrupted(itertools.chain(known, kept()))
    choice = Choice(scene, sorted(rows, key=lambda row: designs.index(row.design)))
    style.save(draw(choice, f"lamps of equal flux; {args.poses} poses, seed {SEED}"), picture)
    written = [csv, picture]
    if args.take is not None:
        with options.checking_options():
            numbers = Annotated[int, Quantity("", "", 1, len(choice.numbered))]
            design = choice.numbered[check(numbers, args.take, "--take") - 1].design
        written.append(csv.with_suffix(f".{args.take}.yaml"))
        taken = scene_from_settings(designed(scene, design).settings(), written[-1].stem)
        comment = f"{design.label}, by uuv_array study design from {scene.name}"
        save_scene(taken, written[-1], comment)
    names = [*map(str, written)]
    result = {"complete": complete, **about, "sweep": sweep, **choice.as_object()}
    result |= {"dropped": dropped, "files": names}
    text = f"{report(choice)}\n{len(rows)} designs: {', '.join(names)}"
    missing = f"{len(rows)} of {len(designs)} designs; the same command resumes it"
    return outputs.finish(args, result, text, complete, missing)
