"""``uuv_array paper``: the figures of Eren et al. (2016), and what their text says of them."""

import argparse
import functools
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from uuv_optical_array.commands.parser import (
    INTERRUPTED,
    Subparsers,
    add_command,
    add_json,
    add_scene,
    bar,
)
from uuv_optical_array.core import files
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.forward.scene import Scene, load_scene
from uuv_optical_array.plots.eren2016 import draw_paper
from uuv_optical_array.studies.eren2016.choices import alternatives, noisy
from uuv_optical_array.studies.eren2016.figures import (
    MOTIONS,
    SIDES,
    STATEMENTS,
    STEPS,
    Statement,
    least_detected,
    panels,
    score,
)
from uuv_optical_array.studies.shared.separation import (
    THRESHOLD_DEG,
    UNITS,
    WANTED,
    Choice,
    Conditions,
    angles_deg,
)

DESCRIPTION = """\
Repeat Figs 4, 5 and 6 of Eren et al. (2016): the spectral angle between the signatures of an
aligned array and of one that is shifted to starboard or turned, for planar and curved arrays of
3 x 3 to 101 x 101 detectors, 4 to 8 m behind the lamp. Every number that the paper's text states of
these figures is printed beside ours, and again for other choices where the paper leaves one open:
the beam's width, the blur, the scaling of the five key parameters, the noise."""

EPILOG = """\
examples:
  uuv_array paper                              the tables, and the figures into paper.png
  uuv_array paper --output eren2016.png        the picture where you want it
  uuv_array paper --json                       one JSON object, the curves with it
  uuv_array paper --scene sea.yaml             your own lamp, water and sphere
Ctrl-C ends it early and reports what there is. docs/paper.md explains every figure."""

SEED = Quantity("seed of the noise, where a choice has some", "", 0, 2**32 - 1)
NOISE_RANGES_M = (4.0, 8.0)


@dataclass
class Findings:
    """What has been computed so far.

    Parameters
    ----------
    points
        Our number of each of `STATEMENTS`, deg.
    curves
        Panel, conditions and angles in deg at `STEPS`.
    sizes
        One row an array size.
    choices
        Name of each choice, and its numbers of `STATEMENTS`, deg.
    picture
        Where it was written.
    complete
        Whether nothing is missing.
    """

    points: list[float] = field(default_factory=list)
    curves: list[tuple[str, Conditions, Array]] = field(default_factory=list)
    sizes: list[dict[str, Any]] = field(default_factory=list)
    choices: list[tuple[str, list[float]]] = field(default_factory=list)
    picture: Path | None = None
    complete: bool = False


def add_parser(subparsers: Subparsers) -> None:
    """Add the subcommand."""
    parser = add_command(
        subparsers,
        "paper",
        run,
        "repeat the figures of Eren et al. (2016), their numbers beside ours",
        DESCRIPTION,
        EPILOG,
    )
    add_scene(parser, "eren2016")
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help=f"{SEED.text} (default: %(default)s)"
    )
    parser.add_argument(
        "--output", type=Path, default=Path("paper.png"), help="picture (default: paper.png)"
    )
    add_json(parser)


def compute(found: Findings, scene: Scene, seed: int, output: Path) -> None:
    """Fill in the findings, the most wanted ones first, and draw the picture."""
    rng = np.random.default_rng(seed)
    angles = functools.partial(angles_deg, scene)
    for statement in bar(STATEMENTS, "point"):
        found.points.append(statement.ours(angles))
    for side in bar(SIDES, "size"):
        found.sizes.append(size(scene, side, noisy(rng)))
    curves = [(panel, conditions) for panel, those in panels().items() for conditions in those]
    for panel, conditions in bar(curves, "curve"):
        found.curves.append((panel, conditions, angles(conditions, STEPS[conditions.motion])))
    draw_paper(found.curves, scene.name, output)
    found.picture = output
    for choice in bar(alternatives(rng), "choice"):
        chosen = functools.partial(angles_deg, scene, choice=choice)
        found.choices.append((choice.text, [statement.ours(chosen) for statement in STATEMENTS]))
    found.complete = True


def size(scene: Scene, side: int, noise: Choice) -> dict[str, Any]:
    """Return what a curved array of one size detects at 4 m and takes for a move, plain values."""
    row: dict[str, Any] = {"detectors_per_side": side}
    for motion in MOTIONS:
        steps = np.append(STEPS[motion], WANTED[motion])
        angles = angles_deg(scene, Conditions("curved", side, 4.0, motion), steps)
        name = f"{WANTED[motion]:g}_{UNITS[motion]}".replace(".", "_")
        row[f"angle_deg_at_{name}"] = float(angles[-1])
        row[f"least_{motion}_{UNITS[motion]}"] = least_detected(steps[:-1], angles[:-1])
    for range_m in NOISE_RANGES_M:
        still = angles_deg(scene, Conditions("curved", side, range_m, "shift"), [0.0], noise)
        row[f"noise_deg_at_{range_m:g}_m"] = float(still[0])
    return row


def number(ours: float) -> str:
    """Return one of our numbers as it is printed."""
    return "flat" if np.isnan(ours) else f"{ours:.1f}"


def known(ours: float) -> float | None:
    """Return one of our numbers for JSON, which has no nan."""
    return None if np.isnan(ours) else ours


def verdict(statement: Statement, ours: float) -> str:
    """Return how our number compares with the paper's."""
    met = statement.met(ours)
    if met is not None:
        return "met" if met else "missed"
    return "" if statement.paper is None or np.isnan(ours) else f"{ours - statement.paper:+.1f}"


def report(found: Findings) -> str:
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
            met, rms_deg = score(points)
            lines.append(row.format(text, *map(number, points), met, number(rms_deg)))
    return "\n".join(line.rstrip() for line in lines)


def as_object(found: Findings) -> dict[str, Any]:
    """Return the findings as plain values, by figure."""
    figures: dict[str, dict[str, list[Any]]] = {
        panel: {"points": [], "curves": []} for panel in panels()
    }
    for statement, ours in zip(STATEMENTS, found.points, strict=False):
        figures[statement.figure]["points"].append(
            {
                "point": statement.text,
                "conditions": dict(statement.conditions),
                "relation": statement.relation,
                "paper_deg": statement.paper,
                "ours_deg": known(ours),
                "met": statement.met(ours),
            }
        )
    for panel, conditions, angles in found.curves:
        figures[panel]["curves"].append(
            {
                **conditions.as_object(STEPS[conditions.motion]),
                "angle_deg": [*map(known, angles.tolist())],
            }
        )
    names = [f"{statement.figure} {statement.text}" for statement in STATEMENTS]
    return {
        "complete": found.complete,
        "picture": None if found.picture is None else str(found.picture),
        "figures": figures,
        "sizes": [
            {key: value if value is None else known(value) for key, value in row.items()}
            for row in found.sizes
        ],
        "choices": [
            {
                "choice": text,
                "ours_deg": dict(zip(names, map(known, points), strict=True)),
                "met": score(points)[0],
                "rms_deg": known(score(points)[1]),
            }
            for text, points in found.choices
        ],
    }


def run(options: argparse.Namespace) -> int:
    """Compute, print and draw."""
    check(Annotated[int, SEED], options.seed, "--seed")
    scene = load_scene(options.scene)
    output = files.user_path(options.output)
    if not output.parent.is_dir():
        raise ValueError(f"--output {output}: no folder {output.parent}; make it first")
    found = Findings()
    try:
        compute(found, scene, options.seed, output)
    except KeyboardInterrupt:
        if not found.points:
            print("interrupted: nothing computed")
            return INTERRUPTED
    if options.json:
        print(json.dumps({"scene": scene.name, "seed": options.seed, **as_object(found)}))
    else:
        print(f"Eren et al. (2016) and scene {scene.name}\n\n{report(found)}\n")
        print(f"picture: {found.picture}" if found.picture else "no picture")
        if not found.complete:
            print("interrupted: the tables end where the work ended")
    return 0 if found.complete else INTERRUPTED
