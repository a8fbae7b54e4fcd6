"""``uuv_array study design``: sweep array and lamp, and say which design to build."""

import argparse
import sys
from typing import Annotated

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.forward.scene import save_scene, scene_from_settings
from uuv_optical_array.plots.style import save
from uuv_optical_array.studies.design_picture import draw
from uuv_optical_array.studies.design_score import CLEAR_SIGMAS, Choice, DesignStudy, ScoredDesign
from uuv_optical_array.studies.design_sweep import (
    SWEPT,
    Sweep,
    default_lists,
    designed,
    lists_named,
)
from uuv_optical_array.studies.shared.results import Results

DESCRIPTION = """\
Sweep the array (shape, detectors, size, radius of curvature), the width of the lamp's beam and, in
a scene with `lamps`, their number, distance from the centre and tilt. Each design is scored by the
criteria of Eren et al. (2016), whether the signature tells 0.2 m and 10 deg apart 4 to 8 m behind
the lamp and how many detectors that takes, and by the Cramer-Rao bound over the working volume. The
scores go into a picture and a CSV beside it; the Pareto-optimal designs are printed. A design that
has a score in the CSV is not scored again, so the same command resumes an interrupted sweep."""

EPILOG = """\
examples:
  uuv_array study design                             the default scene, into follow.design.csv
  uuv_array study design --sweep width_m=0.3,0.4 detectors_per_side=5,7    some of it
  uuv_array study design --take 2                    all of it, and design 2 as a scene file
  uuv_array study design --scene leading_lights --sweep lamps=1,3 spread_m=0.2,0.4 tilt_deg=0,3
fronts: `fits` is of arrays no wider than the scene's, `resolved` of those of them that meet the
criterion at 4 m, `any` of all. A design is left out if another one has no more detectors and bounds
that are no more than 10 % larger. Ctrl-C ends it early and draws what there is."""


def report(choice: Choice) -> str:
    """Return the designs that are listed, and how many meet the criterion."""
    near, far, clear = choice.resolved_counts
    return (
        f"{choice.table()}\n\n"
        f"{near} of {len(choice.rows)} designs tell 0.2 m and 10 deg apart by 15 deg at 4 m, "
        f"{far} from 4 to 8 m;\nof these, {clear} by {CLEAR_SIGMAS:g} or more standard "
        "deviations of their signature's noise"
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    parser.add_argument(
        "--sweep",
        nargs="+",
        default=[],
        metavar="NAME=VALUE,...",
        help=f"values of {', '.join(SWEPT)} (default: a grid about the scene's own)",
    )
    scored = parser.add_argument_group("how it is scored")
    options.add_settings(scored, DesignStudy, "power", "mount", "poses")
    written = parser.add_argument_group("what is written")
    about = "picture, with the CSV of every design beside it (default: SCENE.design.png here)"
    outputs.add_picture(written, None, about=about)
    written.add_argument(
        "--take",
        type=options.whole_number,
        metavar="NO",
        help="write design NO of the table as a scene, too",
    )
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Score what is not scored yet, and print, write and draw it."""
    scene = options.scene_of(args)
    with options.checking_options():
        sweep = Sweep(**{**default_lists(scene), **lists_named(args.sweep)})
    values = options.settings_of(args, DesignStudy, "power", "mount", "poses")
    study = DesignStudy(scene, sweep, **values)
    picture = args.output or f"{scene.name}.design.png"
    picture = outputs.file_to_write(picture, "--output", outputs.PICTURE)
    csv = outputs.file_to_write(picture.with_suffix(".csv"), "--output")
    results = Results(csv, ScoredDesign, study.origin)
    told = sys.stderr if args.json else sys.stdout
    if dropped := sweep.dropped():
        count = sum(dropped.values())
        print(f"left out: {count} designs whose corners lie beyond their sphere", file=told)
    if scored := study.swept(results):
        print(f"{csv}: {len(scored)} designs are there already", file=told)
    try:
        study.score_rest(results, lambda rounds: progress.over(rounds, "design"))
    except KeyboardInterrupt:
        if not study.swept(results):
            raise
    choice = Choice(study, study.swept(results))
    done, count = len(choice.rows), len(sweep.designs())
    save(draw(choice), picture)
    written = [csv, picture]
    if args.take is not None:
        with options.checking_options():
            numbers = Annotated[int, Quantity("", "", 1, len(choice.numbered))]
            design = choice.numbered[check(numbers, args.take, "--take") - 1].design
        written.append(csv.with_suffix(f".{args.take}.yaml"))
        taken = designed(scene, design, study.power, study.mount)
        taken = scene_from_settings(taken.settings(), written[-1].stem)
        about = f"{design.label}, by uuv_array study design from {scene.name}"
        save_scene(taken, written[-1], about)
    names = [*map(str, written)]
    result = {"complete": done == count, **choice.as_object(), "files": names}
    text = f"{report(choice)}\n{done} designs: {', '.join(names)}"
    missing = f"{done} of {count} designs; the same command resumes it" * (done < count)
    return outputs.finish(args, result, text, missing)
