"""``uuv_array study design``: which array and which lamp to build."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.scene import Scene, save_scene
from uuv_optical_array.studies.design.designs import Mount, Power, Sweep, default_sweep
from uuv_optical_array.studies.design.fronts import (
    CLEAR_SIGMAS,
    as_object,
    numbered,
    resolved_counts,
    standing,
)
from uuv_optical_array.studies.design.study import DesignStudy, ScoredDesign
from uuv_optical_array.studies.results import Results

DESCRIPTION = """\
Sweep the array (shape, detectors, size, radius of curvature) and the width of the lamp's beam, and
score each design: by the criteria of Eren et al. (2016), whether the signature tells 0.2 m and
10 deg apart 4 to 8 m behind the lamp and how many detectors that takes, and by the Cramer-Rao bound
over the working volume. The scores go into a CSV and a picture beside it; the Pareto-optimal
designs are printed. A design that the CSV has a score of is not scored again, so the same command
goes on where it was interrupted."""

EPILOG = """\
examples:
  uuv_array study design                             the default scene, into follow.design.csv
  uuv_array study design --size 0.3 0.4 --side 5 7   some of it
  uuv_array study design --take 2                    all of it, and design 2 as a scene file
fronts: `fits` is of arrays no wider than the scene's, `resolved` of those of them that meet the
criterion at 4 m, `any` of all. A design is left out for one that has no more detectors and bounds
no more than 10 % larger. Ctrl-C ends it early and draws what there is."""

NUMBERS = {
    "poses": options.Number(Quantity("poses at which the bound is taken", "", 1, 10_000_000), 1000),
    "seed": options.Number(options.SEED, 1),
}
HEADS = ("position", "angle", "lit", "at 4 m", "4 to 8 m", "", "15 deg", "")
# Option and field of `Sweep`.
LISTS: dict[str, tuple[str, Callable[[str], Any], str]] = {
    "shapes": ("shape", str, "planar, curved"),
    "side": ("detectors_per_side", options.whole_number, "detectors in a row"),
    "size": ("width_m", float, "outermost detector to outermost, m"),
    "radius": ("radius_m", float, "of the sphere of a curved array, m"),
    "beam-sigma-deg": ("beam_sigma_deg", float, "standard deviation of the lamp's beam, deg"),
}


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "design",
        run,
        "sweep array and lamp, and say which design to build",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "follow")
    sweep = parser.add_argument_group("what is swept (default: a grid about the scene's own)")
    for option, (field, kind, text) in LISTS.items():
        sweep.add_argument(
            f"--{option}",
            dest=field,
            type=kind,
            nargs="+",
            choices=get_args(Shape) if field == "shape" else None,
            metavar="X",
            help=text,
        )
    about = parser.add_argument_group("how it is scored")
    about.add_argument(
        "--power",
        choices=get_args(Power),
        default="flux",
        help="lamps of equal flux; the same with the gain turned down where they would read "
        "brighter than the scene's own; or lamps of equal counts (default: %(default)s)",
    )
    about.add_argument(
        "--mount",
        choices=get_args(Mount),
        default="front",
        help="what stays in its place: the foremost point, or the array's frame, which is the "
        "centre of a sphere as in the paper (default: %(default)s)",
    )
    options.add_numbers(about, NUMBERS)
    written = parser.add_argument_group("what is written")
    written.add_argument(
        "--csv",
        type=Path,
        metavar="FILE",
        help="every design, a line each (default: SCENE.design.csv here)",
    )
    outputs.add_picture(written, None, "--picture", "picture, else beside the CSV")
    written.add_argument(
        "--take",
        type=options.whole_number,
        metavar="NO",
        help="write design NO of the table as a scene, too",
    )
    options.add_json(parser)


def sweep_of(args: argparse.Namespace, scene: Scene) -> Sweep:
    """Return the sweep that is asked for; a list that is not given is that of the default."""
    usual = default_sweep(scene)
    given = {field: getattr(args, field) for field, _, _ in LISTS.values()}
    lists = {
        field: getattr(usual, field) if values is None else values
        for field, values in given.items()
    }
    try:
        return Sweep(**lists)
    except ValueError as error:
        option = {field: f"--{option}" for option, (field, _, _) in LISTS.items()}
        name, _, rest = str(error).partition(":")
        raise options.OptionError(f"{option.get(name, name)}:{rest}") from None


def table(study: DesignStudy, rows: Sequence[ScoredDesign]) -> str:
    """Return the Pareto-optimal designs in words, numbered."""
    line = "{:>3} {:<51}{:>8}{:>7}{:>5}{:>12}{:>12}{:>7}  {:<9}{}"
    parts = [
        line.format("no", "design", *HEADS),
        line.format("", "", "m", "deg", "%", "deg", "deg", "sigma", "at", "front"),
    ]
    listed = zip(numbered(study, rows), standing(study, rows), strict=True)
    for number, (row, where) in enumerate(listed, start=1):
        design, score = row.design, row.score
        parts.append(
            line.format(
                number,
                design.label,
                f"{score.position_m:.3f}",
                f"{score.angle_deg:.2f}",
                f"{100 * score.lit:.0f}",
                f"{score.shift_near_deg:.1f}, {score.yaw_near_deg:.1f}",
                f"{score.shift_deg:.1f}, {score.yaw_deg:.1f}",
                f"{score.sigmas:.1f}",
                score.resolved,
                where,
            )
        )
    return "\n".join(parts)


def summary(rows: Sequence[ScoredDesign]) -> str:
    """Say how many designs meet the criterion, and how many of them in spite of noise."""
    near, far, clear = resolved_counts(rows)
    return (
        f"{near} of {len(rows)} designs tell 0.2 m and 10 deg apart by 15 deg at 4 m, "
        f"{far} from 4 to 8 m;\nof these, {clear} by {CLEAR_SIGMAS:g} or more standard "
        "deviations of their signature's noise"
    )


def run(args: argparse.Namespace) -> int:
    """Score what is not scored yet, and print, write and draw it."""
    poses, seed = options.numbers_of(args, NUMBERS)
    scene = options.scene_of(args)
    sweep = sweep_of(args, scene)
    study = DesignStudy(scene, sweep, args.power, args.mount, poses, seed)
    csv = outputs.file_to_write(args.csv or f"{scene.name}.design.csv", "--csv", outputs.CSV)
    picture = outputs.file_to_write(
        args.picture or csv.with_suffix(".png"), "--picture", outputs.PICTURE
    )
    results = Results(csv, ScoredDesign, study.origin)

    def tell(text: str) -> None:
        print(text, file=sys.stderr if args.json else sys.stdout)

    if dropped := study.sweep.dropped():
        tell(f"left out: {sum(dropped.values())} designs whose corners lie beyond their sphere")
    if there := study.swept(results):
        tell(f"{csv}: {len(there)} designs are there already")
    complete = True
    try:
        study.score_rest(results, lambda rounds: progress.over(rounds, "design"))
    except KeyboardInterrupt:
        complete = False
    rows = study.swept(results)
    if not rows:
        print("interrupted: nothing scored")
        return options.INTERRUPTED
    from uuv_optical_array.plots.studies.design import draw_designs

    draw_designs(study, rows, picture)
    written = [csv, picture]
    if args.take is not None:
        named = numbered(study, rows)
        number = check(Annotated[int, Quantity("", "", 1, len(named))], args.take, "--take")
        written.append(csv.with_suffix(f".{number}.yaml"))
        design = named[number - 1].design
        taken = study.scene_of(design, written[-1].stem)
        save_scene(
            taken, written[-1], f"{design.label}, by uuv_array study design from {scene.name}"
        )
    if args.json:
        names = [str(path) for path in written]
        print(json_text({"complete": complete, **as_object(study, rows), "files": names}))
    else:
        print(f"{table(study, rows)}\n\n{summary(rows)}")
        print(f"{len(rows)} designs: {', '.join(map(str, written))}")
        if not complete:
            count = len(study.sweep.designs())
            print(f"interrupted: {len(rows)} of {count} designs; the same command goes on")
    return 0 if complete else options.INTERRUPTED
