"""``uuv_array study paper``: repeat the figures of Eren et al. (2016), their numbers beside ours.

What the paper leaves open is a choice: ours are the scene `eren2016` and `paper_signature`, others
are in `paper_choices`.
"""

import argparse
import functools
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.plots.style import label_ends, new_figure, save, shades
from uuv_optical_array.studies.paper_choices import alternatives, noisy
from uuv_optical_array.studies.paper_statements import (
    FAR,
    MOTIONS,
    SIDES,
    STATEMENTS,
    STEPS,
    agreement,
    least_detected,
    panels,
)
from uuv_optical_array.studies.shared.separation import (
    THRESHOLD_DEG,
    UNITS,
    WANTED,
    Choice,
    Conditions,
    Motion,
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
  uuv_array study paper                        the tables, and the figures into paper.png
  uuv_array study paper --output eren2016.png  the picture where you want it
  uuv_array study paper --json                 one JSON object, including the curves
  uuv_array study paper --scene sea.yaml       your own lamp, water and sphere
Ctrl-C ends it early and reports what is complete. docs/results/paper.md explains every figure."""

NOISE_RANGES_M = (4.0, 8.0)
SEED = 1


def size_row(scene: Scene, side: int, noise: Choice) -> dict[str, Any]:
    """Return the angles of a curved array at 4 m, the least detected moves and the noise."""
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


def reproduce(
    scene: Scene,
    seed: int,
    progress: Callable[[Iterable[Any], str], Iterable[Any]],
    result: dict[str, Any],
) -> None:
    """Write the results into a mapping, the most important first, as the JSON has them.

    An interrupt leaves those before it; `progress` wraps each loop, whose rounds it names.
    """
    rng, curves = np.random.default_rng(seed), panels()
    figures: dict[str, Any] = {panel: {"points": [], "curves": []} for panel in curves}
    result |= {"complete": False, "figures": figures, "sizes": [], "choices": []}
    angles = functools.partial(angles_deg, scene)
    for statement in progress(STATEMENTS, "point"):
        figures[statement.figure]["points"].append(statement.row(statement.ours(angles)))
    for side in progress(SIDES, "size"):
        result["sizes"].append(size_row(scene, side, noisy(rng)))
    for panel, at in progress([(name, at) for name in curves for at in curves[name]], "curve"):
        steps = STEPS[at.motion]
        curve = {**at.as_object(steps), "angle_deg": angles(at, steps)}
        figures[panel]["curves"].append(curve)
    names = [f"{statement.figure} {statement.text}" for statement in STATEMENTS]
    for choice in progress(alternatives(rng), "choice"):
        chosen = functools.partial(angles_deg, scene, choice=choice)
        ours = [statement.ours(chosen) for statement in STATEMENTS]
        met, rms_deg = agreement(ours)
        points = {"choice": choice.text, "ours_deg": dict(zip(names, ours, strict=True))}
        result["choices"].append({**points, "met": met, "rms_deg": rms_deg})
    result["complete"] = True


def _number(ours: float) -> str:
    return "flat" if math.isnan(ours) else f"{ours:.1f}"


def report(result: Mapping[str, Any]) -> str:
    """Return the tables of `reproduce`, as far as they are complete."""
    points = [point for figure in result["figures"].values() for point in figure["points"]]
    rows: list[tuple[object, ...]] = [("no.", "fig", "spectral angle (deg)", "paper", "ours", "")]
    for i, (statement, point) in enumerate(zip(STATEMENTS, points, strict=False), 1):
        ours, verdict = point["ours_deg"], statement.verdict(point["ours_deg"])
        rows.append(
            (i, statement.figure, statement.text, statement.label, _number(ours), f"{verdict:4}")
        )
    lines = [columns(rows, 3)]
    if result["sizes"]:
        lines += [
            "",
            f"Curved arrays: angles at 4 m; the least move that shows {THRESHOLD_DEG:g} deg there;",
            "and the angle between two readings of one pose, with 10 bits and 1 count of noise.",
        ]
        heads = ("0.2 m", "10 deg", "shift (m)", "yaw (deg)", "noise 4 m", "noise 8 m")
        rows = [("detectors", *heads)]
        for size in result["sizes"]:
            side, at_shift, shift, at_yaw, yaw, *noise = size.values()
            least = ["none" if step is None else f"{step:g}" for step in (shift, yaw)]
            angles = _number(at_shift), _number(at_yaw)
            rows.append((f"{side} x {side}", *angles, *least, *map(_number, noise)))
        lines.append(columns(rows))
    if result["choices"]:
        lines += [
            "",
            "Other choices, one at a time. met: how many of the six < and >;",
            "rms: of the differences from the five stated angles.",
        ]
        rows = [("choice", "met", "rms (deg)")]
        for row in result["choices"]:
            rows.append((row["choice"], row["met"], f"{row['rms_deg']:.1f}"))
        lines.append(columns(rows))
    return "\n".join(lines)


# Free areas of the panels for the statements, in fractions of the axes.
FREE = {
    ("5a", "above"): (0.02, 0.72),
    ("5a", "below"): (0.6, 0.1),
    ("5b", "above"): (0.02, 0.72),
    ("5b", "below"): (0.6, 0.08),
    ("6b", "above"): (0.6, 0.08),
    ("6e", "above"): (0.6, 0.08),
}
AXES: dict[Motion, str] = {"shift": "shift to starboard (m)", "yaw": "yaw (deg)"}


def draw(figures: Mapping[str, Any], scene_name: str) -> Any:
    """Draw the three figures, panel by panel as in the paper, with the statements of its text.

    `figures` are those of `reproduce`. Returns the picture.
    """
    picture = new_figure(11.4, 12.4)
    upper, lower = picture.subfigures(2, 1, height_ratios=[1, 0.95])
    fourth, fifth = upper.subfigures(1, 2)
    by_panel: dict[str, Any] = {}
    for part, letters, number in ((fourth, "ab", "4"), (fifth, "ab", "5"), (lower, "abcdef", "6")):
        grid = part.subplots(2, len(letters) // 2, sharey="row", squeeze=False)
        by_panel |= {f"{number}{x}": axes for x, axes in zip(letters, grid.flat, strict=True)}
        for axes in grid[:, 0]:
            axes.set_ylabel("spectral angle (deg)")
    fourth.suptitle("Fig. 4: planar and curved, 21 x 21, 4 m")
    fifth.suptitle("Fig. 5: curved arrays by detectors in a row, 4 m")
    lower.suptitle("Fig. 6: curved arrays by range")
    for panel, axes in by_panel.items():
        curves = figures[panel]["curves"]
        motion: Motion = "shift" if "shift_m" in curves[0] else "yaw"
        side = curves[0]["detectors_per_side"]
        title = f"({panel[1]})" + (f" {side} x {side}" if panel[0] == "6" else "")
        axes.set_title(title, loc="left", fontsize=11)
        axes.set(xlabel=AXES[motion], xlim=(0, STEPS[motion][-1]))
        axes.set_ylim(0, 80 if motion == "shift" else 60)
        axes.grid(alpha=0.3)
        # Dark for many detectors and for far, so that grey tells it, too; names at the ends.
        ends = []
        for curve, shade in zip(curves, shades("viridis", 0.85, 0, len(curves)), strict=True):
            names = {"4": curve["array"], "5": f"{curve['detectors_per_side']}"}
            dashed = "--" if curve["array"] == "planar" else "-"
            axes.plot(STEPS[motion], curve["angle_deg"], color=shade, lw=1.8, ls=dashed)
            ends.append(
                (names.get(panel[0], f"{curve['range_m']:g} m"), float(curve["angle_deg"][-1]))
            )
        label_ends(axes, ends)
        _draw_statements(axes, panel, motion)
    picture.suptitle(
        f"Eren et al. (2016), Figs 4 to 6: our curves (scene {scene_name}); in black, what the "
        "text states",
        fontsize=13,
    )
    return picture


def _draw_statements(axes: Any, panel: str, motion: Motion) -> None:
    """Mark the paper's statements about a panel."""
    if panel == "4a":
        axes.axvspan(FAR[0], FAR[-1], color="0.9", zorder=0)
        axes.text(0.765, 4, "stated: curved\n2 deg better", ha="center", fontsize=10)
        return
    if panel[0] == "5":
        axes.axhline(THRESHOLD_DEG, color="k", lw=1, ls="--")
    for statement in STATEMENTS:
        if statement.figure != panel or statement.paper is None:
            continue
        step, angle = statement.conditions[f"{motion}_{UNITS[motion]}"], statement.paper
        if statement.relation == "is":
            axes.plot(step, angle, "o", color="k", ms=6, zorder=4)
            # The curved array's angles are above the planar one's here.
            off = (-9, 7) if statement.conditions["array"] == "curved" else (9, -9)
            axes.annotate(
                f"{angle:g}", (step, angle), off, textcoords="offset points", ha="center",
                va="center", fontsize=9,
            )  # fmt: skip
            continue
        up = statement.relation == "above"
        # A bar with an arrowhead to the side on which the curve should be.
        axes.plot(step, angle, "k_", ms=12, mew=2, zorder=4)
        axes.plot(step, angle + (3 if up else -3), "^" if up else "v", color="k", ms=5, zorder=4)
        side, range_m = (statement.conditions[key] for key in ("detectors_per_side", "range_m"))
        which = f"{side} x {side}" if panel[0] == "5" else f"{range_m:g} m"
        line = {"arrowstyle": "-", "lw": 0.7, "color": "0.3", "shrinkB": 4}
        axes.annotate(
            f"{which}: {statement.label}", (step, angle), FREE[panel, statement.relation],
            textcoords="axes fraction", va="center", fontsize=9, zorder=5, arrowprops=line,
        )  # fmt: skip


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "eren2016")
    outputs.add_picture(parser, "paper.png")
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Compute, print and draw."""
    scene = options.scene_of(args)
    output: Path = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    result: dict[str, Any] = {"scene": scene.name, "seed": SEED, "picture": None}
    try:
        reproduce(scene, SEED, progress.over, result)
    except KeyboardInterrupt:
        if not result["figures"]["4a"]["points"]:
            raise
    if result["choices"]:  # which follow all curves
        result["picture"] = str(output)
        save(draw(result["figures"], scene.name), output)
    picture = f"picture: {output}" if result["picture"] else "no picture"
    text = f"Eren et al. (2016) and scene {scene.name}\n\n{report(result)}\n\n{picture}"
    missing = "" if result["complete"] else "the tables end where the work ended"
    return outputs.finish(args, result, text, missing)
