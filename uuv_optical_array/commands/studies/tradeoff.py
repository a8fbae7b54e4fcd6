"""``uuv_array study tradeoff``: what accuracy costs in time, by method, array and table."""

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.estimation.table.signature_table import Progress
from uuv_optical_array.studies.tradeoff.fronts import (
    MOST_WITHOUT_POSE,
    as_object,
    fronts,
    numbered,
)
from uuv_optical_array.studies.tradeoff.measurement import expected_s
from uuv_optical_array.studies.tradeoff.plan import QUICK_LEAVES_OUT
from uuv_optical_array.studies.tradeoff.results import (
    SETTINGS_CSV,
    TABLES_CSV,
    Measurement,
    Mode,
    at_one_speed,
)
from uuv_optical_array.studies.tradeoff.run import TradeoffRun

DESCRIPTION = """\
Measure error and time per frame of every method (sam, sam_interpolated, least_squares, and the
published look-up and moments) on arrays of 3, 5, 7 and 21 detectors a side, planar and curved, with
tables of 1e3 to 1e7 poses. Errors are of random poses 4 to 8 m behind the lamp, +-0.9 m and
+-20 deg; times are from an image to its pose. Two CSV files grow in the output folder, and two
pictures show them. A stopped run goes on where it was. See docs/results/tradeoff.md."""

EPILOG = """\
examples:
  uuv_array study tradeoff                       some settings of the reference scene: minutes
  uuv_array study tradeoff --full                all of them; says first how long that takes
  uuv_array study tradeoff --scene sea.yaml      your own scene, into sea.tradeoff/
Ctrl-C ends it early and draws what there is."""

NUMBERS = {"seed": options.Number(options.SEED, 1)}
PICTURE, TABLES_PICTURE = "tradeoff", "table_cost"


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "tradeoff",
        run,
        "measure and draw what accuracy costs in time, by method, array and table",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "reference")
    parser.add_argument(
        "--full", action="store_true", help="every method, array and table, and more frames"
    )
    options.add_numbers(parser, NUMBERS)
    options.add_json(parser)
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="folder of CSV files and pictures (default: SCENE.tradeoff here)",
    )
    parser.add_argument(
        "--pictures",
        choices=outputs.PICTURE,
        default=".png",
        help="suffix of the pictures (default: %(default)s)",
    )


def measure_rest(run: TradeoffRun) -> None:
    """Measure what is left, and show progress by the time that it is expected to take."""
    groups = run.left()
    if not groups:
        return
    expected = expected_s(run.scene, groups, run.frames)
    minutes = math.ceil(sum(expected) / 60)
    already = f", {len(run.settings.lines)} are there" if run.settings.lines else ""
    about = f"{run.count} settings{already}; about {minutes} min; into {run.folder}"
    print(about, file=sys.stderr)

    def rounds_of(percent: float) -> Progress:
        return lambda rounds: _advance(bar, percent, rounds)

    total = sum(expected)
    with progress.counter(100, "%", expected_s=total) as bar:
        for group, seconds in zip(groups, expected, strict=True):
            side, table = group.detectors_per_side, f" {group.steps}^5" if group.steps else ""
            bar.set_description(f"{group.methods[-1]} {group.shape} {side} x {side}{table}")
            half = 50 * seconds / total
            run.measure(group, rounds_of(half))  # the other half is for the table
            bar.update(half)


def _advance(bar: Any, percent: float, rounds: Iterable[int]) -> Iterator[int]:
    """Go through rounds that are `percent` of the work together."""
    rounds = list(rounds)
    for i in rounds:
        yield i
        bar.update(percent / len(rounds))


def report(rows: Sequence[Measurement]) -> str:
    """Return the settings on a front in words, with times at one speed of the machine."""
    rows = at_one_speed(rows)
    numbers = numbered(rows)
    line = "{:>3} {:<46}{:>9}{:>8}{:>9}{:>9}{:>8}  {}"
    parts = [line.format("no", "setting", "position", "angle", "median", "99 %", "models", "front")]
    parts.append(line.format("", "", "m", "deg", "ms", "ms", "", ""))
    on = fronts(rows)
    for number, i in enumerate(numbers, start=1):
        row = rows[i]
        names = " and ".join(name for name, front in on.items() if front[i])
        parts.append(
            line.format(
                number,
                row.label,
                f"{row.position_m:.3f}",
                f"{row.angle_deg:.2f}",
                f"{row.median_ms:.2f}",
                f"{row.p99_ms:.2f}",
                f"{row.models:.1f}",
                names,
            )
        )
    return "\n".join(parts)


def run(args: argparse.Namespace) -> int:
    """Measure what is left, and draw and print what there is."""
    (seed,) = options.numbers_of(args, NUMBERS)
    scene = options.scene_of(args)
    mode: Mode = get_args(Mode)[args.full]
    folder = outputs.folder_to_write(args.output or f"{scene.name}.tradeoff", "--output")
    measured = TradeoffRun(scene, mode, seed, folder)
    complete = True
    try:
        measure_rest(measured)
    except KeyboardInterrupt:
        complete = False
    rows, costs = measured.settings.lines, measured.tables.lines
    if not rows:
        print("interrupted: nothing measured")
        return options.INTERRUPTED
    loads = [row.load_average for row in rows]
    load = f"load average {min(loads):.1f} to {max(loads):.1f}"
    about = f"scene {scene.name}, {measured.frames} frames each; {measured.origin.machine}"
    from uuv_optical_array.plots.studies.tradeoff import draw_table_cost, draw_tradeoff

    pictures = [folder / f"{PICTURE}{args.pictures}"]
    draw_tradeoff(rows, f"{about}, {load}", pictures[0])
    if costs:
        pictures.append(folder / f"{TABLES_PICTURE}{args.pictures}")
        draw_table_cost(costs, rows, f"{about}, {load}", pictures[1])
    if args.json:
        told = {"complete": complete, **vars(measured.origin), **as_object(rows)}
        print(json_text({**told, "pictures": [str(path) for path in pictures]}))
    else:
        print(f"{about}, {load}\n\nPareto-optimal settings in time and error:\n{report(rows)}\n")
        lost = sum(row.without_pose > MOST_WITHOUT_POSE for row in rows)
        print(f"{lost} of {len(rows)} settings left more than 1 % of frames without a pose")
        if mode == "quick":
            print(QUICK_LEAVES_OUT)
        print(f"files: {folder / SETTINGS_CSV}, {folder / TABLES_CSV}")
        print(f"pictures: {', '.join(map(str, pictures))}")
        if not complete:
            print(f"interrupted: {len(rows)} of {measured.count} settings; run it again to go on")
    return 0 if complete else options.INTERRUPTED
