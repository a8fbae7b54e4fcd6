"""``uuv_array paper``: the figures of Eren et al. (2016), and what their text says of them."""

import argparse
import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uuv_optical_array import files
from uuv_optical_array.commands.parser import (
    INTERRUPTED,
    Subparsers,
    add_command,
    add_json,
    add_scene,
    bar,
)
from uuv_optical_array.paper import (
    FAR,
    SIDES,
    STATEMENTS,
    STEPS,
    THRESHOLD_DEG,
    UNITS,
    Conditions,
    Motion,
    Statement,
    angles_deg,
    least_detected,
    panels,
)
from uuv_optical_array.paper_choices import alternatives
from uuv_optical_array.picture import SHAPE_COLOURS, save
from uuv_optical_array.pose import Array
from uuv_optical_array.quantity import Quantity, check
from uuv_optical_array.scene import Scene, load_scene

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
MOTIONS: tuple[Motion, ...] = ("shift", "yaw")
SPECIFIED: dict[Motion, float] = {"shift": 0.2, "yaw": 10.0}  # m and deg
AXES: dict[Motion, str] = {"shift": "shift to starboard (m)", "yaw": "yaw (deg)"}


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
    angles = functools.partial(angles_deg, scene)
    for statement in bar(STATEMENTS, "point"):
        found.points.append(statement.ours(angles))
    for side in bar(SIDES, "size"):
        found.sizes.append(size(scene, side))
    curves = [(panel, conditions) for panel, those in panels().items() for conditions in those]
    for panel, conditions in bar(curves, "curve"):
        found.curves.append((panel, conditions, angles(conditions, STEPS[conditions.motion])))
    draw_paper(found.curves, scene.name, output)
    found.picture = output
    for choice in bar(alternatives(np.random.default_rng(seed)), "choice"):
        chosen = functools.partial(angles_deg, scene, choice=choice)
        found.choices.append((choice.text, [statement.ours(chosen) for statement in STATEMENTS]))
    found.complete = True


def size(scene: Scene, side: int) -> dict[str, Any]:
    """Return what a curved array of one size detects at 4 m, as plain values."""
    row: dict[str, Any] = {"detectors_per_side": side}
    for motion in MOTIONS:
        steps = np.append(STEPS[motion], SPECIFIED[motion])
        angles = angles_deg(scene, Conditions("curved", side, 4.0, motion), steps)
        name = f"{SPECIFIED[motion]:g}_{UNITS[motion]}".replace(".", "_")
        row[f"angle_deg_at_{name}"] = float(angles[-1])
        row[f"least_{motion}_{UNITS[motion]}"] = least_detected(steps[:-1], angles[:-1])
    return row


def label(statement: Statement) -> str:
    """Return the paper's number as it is printed: ``12``, ``> 15``, or words."""
    if statement.paper is None:
        return statement.relation
    sign = {"is": "", "above": "> ", "below": "< "}[statement.relation]
    return f"{sign}{statement.paper:g}"


def verdict(statement: Statement, ours: float) -> str:
    """Return how our number compares with the paper's."""
    met = statement.met(ours)
    if met is not None:
        return "met" if met else "missed"
    return "" if statement.paper is None else f"{ours - statement.paper:+.1f}"


def report(found: Findings) -> str:
    """Return the tables, each with the rows that there are."""
    line = "{:<4}{:<4}{:<44}{:>16}{:>8}  {}"
    lines = [line.format("no.", "fig", "spectral angle (deg)", "paper", "ours", "")]
    for i, (statement, ours) in enumerate(zip(STATEMENTS, found.points, strict=False), 1):
        values = (label(statement), f"{ours:.1f}", verdict(statement, ours))
        lines.append(line.format(i, statement.figure, statement.text, *values))
    if found.sizes:
        lines += ["", f"Curved arrays at 4 m, and the least move that shows {THRESHOLD_DEG:g} deg:"]
        row = "{:<12}" + 4 * "{:>10}"
        lines.append(row.format("detectors", "at 0.2 m", "at 10 deg", "shift (m)", "yaw (deg)"))
        for sized in found.sizes:
            side, at_shift, shift, at_yaw, yaw = sized.values()
            least = ["none" if step is None else f"{step:g}" for step in (shift, yaw)]
            lines.append(row.format(f"{side} x {side}", f"{at_shift:.1f}", f"{at_yaw:.1f}", *least))
    if found.choices:
        lines += ["", "Other choices, one at a time, by no. of the first table; met: of nos. >, <:"]
        row = "{:<30}" + len(STATEMENTS) * "{:>6}" + "{:>5}"
        lines.append(row.format("", *range(1, len(STATEMENTS) + 1), "met"))
        stated = [label(s).replace(" ", "") if s.paper is not None else "" for s in STATEMENTS]
        lines.append(row.format("the paper", *stated, ""))
        for text, points in found.choices:
            met = sum(s.met(ours) is True for s, ours in zip(STATEMENTS, points, strict=True))
            lines.append(row.format(text, *(f"{ours:.1f}" for ours in points), met))
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
                "ours_deg": ours,
                "met": statement.met(ours),
            }
        )
    for panel, conditions, angles in found.curves:
        figures[panel]["curves"].append(
            {**conditions.as_object(STEPS[conditions.motion]), "angle_deg": angles.tolist()}
        )
    names = [f"{statement.figure} {statement.text}" for statement in STATEMENTS]
    return {
        "complete": found.complete,
        "picture": None if found.picture is None else str(found.picture),
        "figures": figures,
        "sizes": found.sizes,
        "choices": [
            {"choice": text, "ours_deg": dict(zip(names, points, strict=True))}
            for text, points in found.choices
        ],
    }


def draw_paper(
    curves: Sequence[tuple[str, Conditions, Array]], scene_name: str, path: Path
) -> None:
    """Draw the three figures, panel by panel as in the paper, with what its text states.

    Parameters
    ----------
    curves
        Panel, conditions and angles in deg at `STEPS`.
    scene_name
        For the title.
    path
        PNG file, written whole or not at all.
    """
    figure = Figure(figsize=(10.5, 12.8), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=[1, 0.95])
    fourth, fifth = upper.subfigures(1, 2)
    by_panel: dict[str, Axes] = {}
    for part, letters, number in ((fourth, "ab", "4"), (fifth, "ab", "5"), (lower, "abcdef", "6")):
        grid = part.subplots(2, len(letters) // 2, sharey="row", squeeze=False)
        by_panel |= {f"{number}{x}": a for x, a in zip(letters, grid.flat, strict=True)}
        for axes in grid[:, 0]:
            axes.set_ylabel("spectral angle (deg)")
    fourth.suptitle("Fig. 4: planar and curved, 21 x 21, 4 m")
    fifth.suptitle("Fig. 5: curved arrays by detectors in a row, 4 m")
    lower.suptitle("Fig. 6: curved arrays by range, coloured as in (a)")
    for panel, axes in by_panel.items():
        own = [(conditions, angles) for name, conditions, angles in curves if name == panel]
        motion = own[0][0].motion
        for (_, angles), (name, colour) in zip(own, _styles(panel, own), strict=True):
            axes.plot(STEPS[motion], angles, color=colour, lw=1.8, label=name)
        _stated(axes, panel, motion)
        side = own[0][0].side
        title = f"({panel[1]})" + (f" {side} x {side}" if panel[0] == "6" else "")
        axes.set_title(title, loc="left", fontsize=11)
        axes.set(xlabel=AXES[motion], xlim=(0, STEPS[motion][-1]))
        axes.set_ylim(0, 80 if motion == "shift" else 60)
        axes.grid(alpha=0.3)
    for panel in ("4a", "4b", "5a", "6a"):
        by_panel[panel].legend(loc="upper left", fontsize=9, ncols=2 if panel == "5a" else 1)
    figure.suptitle(
        f"Eren et al. (2016), Figs 4 to 6: our curves (scene {scene_name}); in black, what the "
        "text states",
        fontsize=13,
    )
    save(figure, path)


def _styles(panel: str, own: Sequence[tuple[Conditions, Array]]) -> list[tuple[str, Any]]:
    """Return label and colour of each curve of a panel."""
    if panel[0] == "4":
        return [(conditions.shape, SHAPE_COLOURS[conditions.shape]) for conditions, _ in own]
    colours = colormaps["turbo" if panel[0] == "5" else "plasma"](np.linspace(0.05, 0.9, len(own)))
    return [
        (f"{c.side} x {c.side}" if panel[0] == "5" else f"{c.range_m:g} m", colour)
        for (c, _), colour in zip(own, colours, strict=True)
    ]


def _stated(axes: Axes, panel: str, motion: Motion) -> None:
    """Mark what the paper's text states of a panel."""
    if panel == "4a":
        axes.axvspan(FAR[0], FAR[-1], color="0.9", zorder=0)
        axes.text(0.75, 4, "stated: curved\n2 deg better", ha="center", fontsize=10)
    if panel[0] == "5":
        axes.axhline(THRESHOLD_DEG, color="k", lw=1, ls="--")
    for statement in STATEMENTS:
        if statement.figure != panel or statement.paper is None or panel == "4a":
            continue
        step, angle = statement.conditions[f"{motion}_{UNITS[motion]}"], statement.paper
        if statement.relation == "is":
            axes.plot(step, angle, "o", color="k", ms=7, zorder=4)
            text, place = f"{angle:g}", (9, -11)
        else:
            up = statement.relation == "above"
            axes.plot(step, angle, "k_", ms=12, mew=2, zorder=4)
            side = statement.conditions["detectors_per_side"]
            text, place = f"{side} x {side}\n{label(statement)}", (0, 26 if up else -26)
        axes.annotate(
            text,
            (step, angle),
            place,
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=9,
            zorder=5,
            arrowprops=None
            if statement.relation == "is"
            else {"arrowstyle": "<-", "lw": 1.5, "shrinkA": 0, "shrinkB": 0},
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
        )


def run(options: argparse.Namespace) -> int:
    """Compute, print and draw."""
    check(Annotated[int, SEED], options.seed, "--seed")
    scene = load_scene(options.scene)
    found = Findings()
    try:
        compute(found, scene, options.seed, files.user_path(options.output))
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
