"""``uuv_array design``: which array and which lamp to build."""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, get_args

from uuv_optical_array.commands.chunks import add_chunks, check_chunks, fill_chunks
from uuv_optical_array.commands.parser import (
    INTERRUPTED,
    Subparsers,
    add_command,
    add_json,
    add_scene,
)
from uuv_optical_array.core import files
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.scene import Scene, load_scene, save_scene, scene_from_settings
from uuv_optical_array.plots.design import draw_designs
from uuv_optical_array.studies.design.choice import fronts, numbered, of_the_paper, standing
from uuv_optical_array.studies.design.designs import Mount, Power, Sweep, default_sweep, designed
from uuv_optical_array.studies.design.store import DesignStore, Row, Study, write_csv

DESCRIPTION = """\
Sweep the array (shape, detectors, size, radius of curvature) and the width of the lamp's beam, and
score each design: by the criteria of Eren et al. (2016), whether the signature tells 0.2 m and
10 deg apart 4 to 8 m behind the lamp and how many detectors that takes, and by the Cramer-Rao bound
over the working volume. The scores go chunk by chunk into a Zarr store, on threads or on a Dask
cluster (the extra `cluster`), then into a CSV and a picture beside it; designs that none beats are
printed. What was interrupted goes on where it stopped when the same command is given again."""

EPILOG = """\
examples:
  uuv_array design                             the default scene, into follow.design.zarr/
  uuv_array design --size 0.3 0.4 --side 5 7   some of it
  uuv_array design --take 2                    all of it, and design 2 as a scene file
  uuv_array design -o /shared/d.zarr --scheduler tcp://10.0.0.1:8786
                                               on a cluster, into a folder that all of it sees
fronts: `fits` is of arrays no wider than the scene's, `told` of those of them that meet the
criterion at 4 m, `any` of all. A design is left out for one that has no more detectors and bounds
no more than 10 % larger."""

POSES = Quantity("poses at which the bound is taken", "", 1, 10_000_000)
SEED = Quantity("seed of poses and noise", "", 0, 2**32 - 1)
CLEAR_SIGMAS = 3.0
HEADS = ("position", "angle", "lit", "at 4 m", "4 to 8 m", "", "15 deg", "")
# Option and field of `Sweep`.
LISTS: dict[str, tuple[str, type, str]] = {
    "shapes": ("shape", str, "planar, curved"),
    "side": ("detectors_per_side", int, "detectors in a row"),
    "size": ("width_m", float, "outermost detector to outermost, m"),
    "radius": ("radius_m", float, "of the sphere of a curved array, m"),
    "beam-sigma-deg": ("beam_sigma_deg", float, "standard deviation of the lamp's beam, deg"),
}


def add_parser(subparsers: Subparsers) -> None:
    """Add the subcommand."""
    parser = add_command(
        subparsers,
        "design",
        run,
        "sweep array and lamp, and say which design to build",
        DESCRIPTION,
        EPILOG,
    )
    add_scene(parser, "follow")
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
    for option, quantity, default in (("poses", POSES, 1000), ("seed", SEED, 1)):
        about.add_argument(
            f"--{option}",
            type=int,
            default=default,
            metavar="N",
            help=f"{quantity.text} (default: %(default)s)",
        )
    written = parser.add_argument_group("what is written (default: all beside the store)")
    written.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="DIR",
        help="store (default: SCENE.design.zarr here)",
    )
    written.add_argument("--csv", type=Path, metavar="FILE", help="every design, a line each")
    written.add_argument("--picture", type=Path, metavar="FILE", help="PNG")
    written.add_argument(
        "--take", type=int, metavar="NO", help="write design NO of the table as a scene, too"
    )
    add_json(parser)
    add_chunks(parser, "where it is worked out")


def sweep_of(options: argparse.Namespace, scene: Scene) -> Sweep:
    """Return the sweep that is asked for; a list that is not given is that of the default."""
    usual = default_sweep(scene)
    given = {field: getattr(options, field) for field, _, _ in LISTS.values()}
    lists = {
        field: getattr(usual, field) if values is None else values
        for field, values in given.items()
    }
    try:
        return Sweep(**lists)
    except ValueError as error:
        option = {field: f"--{option}" for option, (field, _, _) in LISTS.items()}
        name, _, rest = str(error).partition(":")
        raise ValueError(f"{option.get(name, name)}:{rest}") from None


def table(study: Study, rows: Sequence[Row]) -> str:
    """Return the designs on a front in words, numbered."""
    line = "{:>3} {:<51}{:>8}{:>7}{:>5}{:>12}{:>12}{:>7}  {:<9}{}"
    parts = [
        line.format("no", "design", *HEADS),
        line.format("", "", "m", "deg", "%", "deg", "deg", "sigma", "at", "front"),
    ]
    told = zip(numbered(study, rows), standing(study, rows), strict=True)
    for number, ((design, score), where) in enumerate(told, start=1):
        parts.append(
            line.format(
                number,
                design.label,
                f"{score.position_m:.3f}",
                f"{score.angle_deg:.2f}",
                f"{100 * score.lit:.0f}",
                f"{score.shift_near_deg:.1f}, {score.yaw_near_deg:.1f}",
                f"{score.shift_deg:.1f}, {score.yaw_deg:.1f}",
                f"{min(score.shift_sigmas, score.yaw_sigmas):.1f}",
                "4 to 8 m" if score.told else "4 m" if score.told_near else "none",
                where,
            )
        )
    return "\n".join(parts)


def summary(rows: Sequence[Row]) -> str:
    """Say how many designs meet the criterion, and how many of them in spite of noise."""
    near = [row for row in rows if row.score.told_near]
    far = [row for row in rows if row.score.told]
    clear = [
        row for row in far if min(row.score.shift_sigmas, row.score.yaw_sigmas) >= CLEAR_SIGMAS
    ]
    return (
        f"{len(near)} of {len(rows)} designs tell 0.2 m and 10 deg apart by 15 deg at 4 m, "
        f"{len(far)} from 4 to 8 m;\nof these, {len(clear)} by {CLEAR_SIGMAS:g} or more standard "
        "deviations of their signature's noise"
    )


def take(study: Study, row: Row, path: Path) -> None:
    """Write a design as a scene file."""
    scene = designed(study.scene, row.design, study.power, study.mount)
    checked = scene_from_settings(scene.settings(), path.stem)
    save_scene(checked, path, f"{row.design.label}, by uuv_array design from {study.scene.name}")


def as_object(study: Study, rows: Sequence[Row]) -> dict[str, Any]:
    """Return a study as plain values."""
    return {
        "scene": study.scene.name,
        **{name: value for name, value in study.as_object().items() if name != "scene"},
        "designs": [row.as_object() for row in rows],
        "fronts": {
            name: [rows.index(row) for row in found] for name, found in fronts(study, rows).items()
        },
        "numbered": [rows.index(row) for row in numbered(study, rows)],
        "papers_array": [i for i, row in enumerate(rows) if of_the_paper(row.design)],
        "dropped": study.sweep.dropped(),
    }


def run(options: argparse.Namespace) -> int:
    """Score what is not scored yet, and print, write and draw it."""
    check(Annotated[int, POSES], options.poses, "--poses")
    check(Annotated[int, SEED], options.seed, "--seed")
    check_chunks(options)
    scene = load_scene(options.scene)
    study = Study(
        scene, sweep_of(options, scene), options.power, options.mount, options.poses, options.seed
    )
    output = files.user_path(options.output or f"{scene.name}.design.zarr")
    store = DesignStore.create(output, study)

    def tell(text: str) -> None:
        print(text, file=sys.stderr if options.json else sys.stdout)

    dropped = study.sweep.dropped()
    if dropped:
        tell(f"left out: {sum(dropped.values())} designs whose corners lie beyond their sphere")
    began = time.perf_counter()
    if fill_chunks(store, output, options, tell) is None:
        return INTERRUPTED
    rows, took_s = store.rows(), time.perf_counter() - began
    csv = files.user_path(options.csv or output.with_suffix(".csv"))
    picture = files.user_path(options.picture or output.with_suffix(".png"))
    write_csv(study, rows, csv)
    draw_designs(study, rows, picture)
    written = [output, csv, picture]
    if options.take is not None:
        named = numbered(study, rows)
        number = check(Annotated[int, Quantity("", "", 1, len(named))], options.take, "--take")
        written.append(output.with_suffix(f".{number}.yaml"))
        take(study, named[number - 1], written[-1])
    if options.json:
        print(json.dumps({**as_object(study, rows), "files": [str(path) for path in written]}))
        return 0
    print(f"{table(study, rows)}\n\n{summary(rows)}")
    print(f"{len(rows)} designs in {took_s:.0f} s: {', '.join(map(str, written))}")
    return 0
