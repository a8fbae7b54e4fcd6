"""``uuv_array tradeoff``: what accuracy costs in time, by method, array and table."""

import argparse
import dataclasses
import json
import math
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, get_args

from tqdm import tqdm

from uuv_optical_array.commands.parser import (
    INTERRUPTED,
    Subparsers,
    add_command,
    add_json,
    add_scene,
)
from uuv_optical_array.core import files
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.estimation.table.signature_table import Progress, SignatureTable
from uuv_optical_array.forward.scene import Scene, load_scene
from uuv_optical_array.plots.tradeoff import draw_table_cost, draw_tradeoff
from uuv_optical_array.studies.pareto import MOST_WITHOUT_POSE, fronts, numbered
from uuv_optical_array.studies.tradeoff.measurement import (
    FRAMES,
    QUICK_LEAVES_OUT,
    Group,
    expected_s,
    measure,
    plan,
)
from uuv_optical_array.studies.tradeoff.results import (
    SETTINGS_CSV,
    TABLES_CSV,
    Ledger,
    Mode,
    Origin,
    Row,
    TableCost,
    at_one_speed,
)
from uuv_optical_array.studies.tradeoff.table_cost import table_cost

DESCRIPTION = """\
Measure error and time per frame of every method (sam, sam_interpolated, least_squares, and the
published look-up and moments) on arrays of 3, 5, 7 and 21 detectors a side, planar and curved, with
tables of 1e3 to 1e7 poses. Errors are of random poses 4 to 8 m behind the lamp, +-0.9 m and
+-20 deg; times are from an image to its pose. Two CSV files grow in the output folder, and two
pictures show them. A stopped run goes on where it was. docs/tradeoff.md tells the story."""

EPILOG = """\
examples:
  uuv_array tradeoff                         some settings of the reference scene: a few minutes
  uuv_array tradeoff --full                  all of them; says first how long that takes
  uuv_array tradeoff --scene sea.yaml        your own scene, into sea.tradeoff/
Ctrl-C ends it early and draws what there is."""

SEED = Quantity("seed of poses and noise", "", 0, 2**32 - 1)
PICTURE, TABLES_PICTURE = "tradeoff.png", "table_cost.png"


def add_parser(subparsers: Subparsers) -> None:
    """Add the subcommand."""
    parser = add_command(
        subparsers,
        "tradeoff",
        run,
        "measure and draw what accuracy costs in time, by method, array and table",
        DESCRIPTION,
        EPILOG,
    )
    add_scene(parser, "reference")
    parser.add_argument(
        "--full", action="store_true", help="every method, array and table, and more frames"
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help=f"{SEED.text} (default: %(default)s)"
    )
    add_json(parser)
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="folder of CSV files and pictures (default: SCENE.tradeoff here)",
    )


@dataclasses.dataclass
class Measurement:
    """A run of measurements in a folder, or what is there of it.

    Parameters
    ----------
    scene, mode, seed
        What is measured.
    folder
        Where its CSV files lie; made where it is missing.

    Raises
    ------
    ValueError
        Where the folder holds those of another run.
    """

    scene: Scene
    mode: Mode
    seed: int
    folder: Path

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        origin = Origin.here(self.scene, self.mode, FRAMES[self.mode], self.seed)
        self.settings = Ledger(self.folder / SETTINGS_CSV, Row, origin)
        self.tables = Ledger(self.folder / TABLES_CSV, TableCost, origin)
        self.groups = plan(self.scene, self.mode)

    @property
    def count(self) -> int:
        """How many settings there are to measure."""
        return sum(len(group.methods) for group in self.groups)

    def left(self) -> list[Group]:
        """Return what is not measured yet."""
        done = {
            (row.method, row.shape, row.detectors_per_side, row.steps) for row in self.settings.rows
        }
        return [
            group
            for group in self.groups
            if any(
                (method, group.shape, group.detectors_per_side, group.steps) not in done
                for method in group.methods
            )
        ]

    def go_on(self) -> None:
        """Measure what is left; an interrupt leaves whole files."""
        groups, frames = self.left(), FRAMES[self.mode]
        if not groups:
            return
        expected = expected_s(self.scene, groups, frames)
        minutes = math.ceil(sum(expected) / 60)
        already = f", {len(self.settings.rows)} are there" if self.settings.rows else ""
        tqdm.write(
            f"{self.count} settings{already}; about {minutes} min; into {self.folder}",
            file=sys.stderr,
        )
        own = self.scene.array

        def rounds_of(seconds: float) -> Progress:
            return lambda rounds: _advance(bar, seconds, rounds)

        total = sum(expected) * (1 + 1e-9)  # rounding must not take the bar beyond its end
        with tqdm(total=total, bar_format="{l_bar}{bar}| {elapsed}<{remaining}") as bar:
            for group, seconds in zip(groups, expected, strict=True):
                side, table = group.detectors_per_side, f" {group.steps}^5" if group.steps else ""
                bar.set_description(f"{group.methods[-1]} {group.shape} {side} x {side}{table}")
                is_own = (group.shape, side) == (own.shape, own.detectors_per_side)
                self.settings.append(
                    measure(
                        self.scene,
                        group,
                        frames,
                        self.seed,
                        rounds_of(seconds / 2),  # the other half is for the table
                        self._keep_cost if is_own else None,
                    )
                )
                bar.update(seconds / 2)

    def _keep_cost(self, table: SignatureTable, build_s: float) -> None:
        steps = table.scene.table.x_m.number
        if steps not in [cost.steps for cost in self.tables.rows]:
            self.tables.append([table_cost(table, steps, build_s, self.folder)])


def _advance(bar: Any, seconds: float, rounds: Iterable[int]) -> Iterator[int]:
    """Go through rounds that take `seconds` together."""
    rounds = list(rounds)
    for i in rounds:
        yield i
        bar.update(seconds / len(rounds))


def report(rows: list[Row]) -> str:
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


def as_object(rows: list[Row]) -> dict[str, Any]:
    """Return rows as plain values, and which are on a front."""
    told = [row.as_object() for row in rows]
    on = {name: [rows[i].label for i in front.nonzero()[0]] for name, front in fronts(rows).items()}
    return {"settings": told, "fronts": on}


def run(options: argparse.Namespace) -> int:
    """Measure what is left, and draw and print what there is."""
    check(Annotated[int, SEED], options.seed, "--seed")
    scene = load_scene(options.scene)
    mode: Mode = get_args(Mode)[options.full]
    folder = files.user_path(options.output or f"{scene.name}.tradeoff")
    measurement = Measurement(scene, mode, options.seed, folder)
    complete = True
    try:
        measurement.go_on()
    except KeyboardInterrupt:
        complete = False
    rows, costs = measurement.settings.rows, measurement.tables.rows
    if not rows:
        print("interrupted: nothing measured")
        return INTERRUPTED
    loads = [row.load_average for row in rows]
    load = f"load average {min(loads):.1f} to {max(loads):.1f}"
    about = f"scene {scene.name}, {FRAMES[mode]} frames each; {measurement.settings.origin.machine}"
    pictures = [folder / PICTURE]
    draw_tradeoff(rows, f"{about}, {load}", pictures[0])
    if costs:
        pictures.append(folder / TABLES_PICTURE)
        draw_table_cost(costs, rows, f"{about}, {load}", pictures[1])
    if options.json:
        told = {"complete": complete, **vars(measurement.settings.origin), **as_object(rows)}
        print(json.dumps({**told, "pictures": [str(path) for path in pictures]}))
    else:
        print(f"{about}, {load}\n\nsettings that none beats in time and error:\n{report(rows)}\n")
        lost = sum(row.without_pose > MOST_WITHOUT_POSE for row in rows)
        print(f"{lost} of {len(rows)} settings left more than 1 % of frames without a pose")
        if mode == "quick":
            print(QUICK_LEAVES_OUT)
        print(f"files: {folder / SETTINGS_CSV}, {folder / TABLES_CSV}")
        print(f"pictures: {', '.join(map(str, pictures))}")
        if not complete:
            print(
                f"interrupted: {len(rows)} of {measurement.count} settings; run it again to go on"
            )
    return 0 if complete else INTERRUPTED
