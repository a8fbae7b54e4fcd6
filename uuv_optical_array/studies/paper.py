"""``uuv_array study paper``: compare the figures of Eren et al. (2016) with ours.

Repeat Figs 4, 5 and 6 of Eren et al. (2016): the spectral angle between the signatures of an
aligned array and of one that is shifted to starboard or turned, for planar and curved arrays of
3 x 3 to 101 x 101 detectors, 4 to 8 m behind the lamp. Every number that the paper's text states of
these figures is printed beside ours; and for each number of detectors the angles at 4 m, the least
move that shows 15 deg there, and the angle by noise.

  uuv_array study paper                        the tables, and the figures into paper.png
  uuv_array study paper --output eren2016.png  the picture where you want it
  uuv_array study paper --json                 one JSON object, including the curves
  uuv_array study paper --scene sea.yaml       your own lamp, water and sphere
docs/results/paper.md explains every figure.
"""

import argparse
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias, get_args

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.effects import check_effects
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import RANGES_M
from uuv_optical_array.plots.style import new_figure, save, shades
from uuv_optical_array.studies.shared.separation import (
    MOVES,
    THRESHOLD_DEG,
    UNITS,
    WANTED,
    Conditions,
    Motion,
    angles_deg,
)

NOISE_RANGES_M = (4.0, 8.0)
SEED = 1
MOTIONS: tuple[Motion, ...] = get_args(Motion)
# The steps of the paper's curves, in their units.
STEPS: dict[Motion, Array] = {"shift": np.arange(31) * 3 / 100, "yaw": np.arange(31) / 1}
FAR, NEAR = STEPS["shift"][STEPS["shift"] > 0.6], STEPS["shift"][STEPS["shift"] <= 0.6]
SIDES = (3, 5, 7, 9, 11, 15, 21, 51, 101)  # the paper says 3 to 101
SIGNS = {"is": "", "above": "> ", "below": "< "}

# Spectral angles of moves, once the scene is fixed.
Angles: TypeAlias = Callable[[Conditions, ArrayLike], Array]


@dataclass(frozen=True)
class Statement:
    """A statement of the paper's text about a figure, and the same number of ours."""

    figure: str  # with its panel: 4b
    text: str  # what is compared
    conditions: Mapping[str, Any]  # the same, as plain values
    relation: str  # the stated number `is` the angle, or that is `above` or `below`; or words
    ours: Callable[[Angles], float]  # computes our number, deg
    paper: float | None = None  # the stated number, deg

    @property
    def label(self) -> str:
        """The paper's number as it is printed: ``12``, ``> 15``, or its words."""
        return self.relation if self.paper is None else f"{SIGNS[self.relation]}{self.paper:g}"

    def met(self, ours: float) -> bool | None:
        """Whether our number lies on the stated side, as nan never does; ``None``: no side."""
        if self.paper is None or self.relation == "is":
            return None
        return ours > self.paper if self.relation == "above" else ours < self.paper

    def row(self, ours: float) -> dict[str, Any]:
        """Return the statement as plain values, with our number, deg."""
        stated = {"point": self.text, "conditions": self.conditions, "relation": self.relation}
        return {**stated, "paper_deg": self.paper, "ours_deg": ours, "met": self.met(ours)}

    def verdict(self, ours: float) -> str:
        """Return how our number compares with the paper's, in a word or as a difference."""
        met = self.met(ours)
        if met is not None:
            return "met" if met else "missed"
        return "" if self.paper is None or math.isnan(ours) else f"{ours - self.paper:+.1f}"


def _of(angles: Angles, at: Conditions, step: float) -> float:
    return float(angles(at, [step])[0])


def _at(figure: str, at: Conditions, step: float, relation: str, paper: float) -> Statement:
    move = f"{at.motion} {step:g} {UNITS[at.motion]}"
    text = f"{at.shape} {at.side} x {at.side}, {at.range_m:g} m, {move}"
    ours = partial(_of, at=at, step=step)
    return Statement(figure, text, at.as_object(step), relation, ours, paper)


def _curved_less_planar(angles: Angles, steps: Array) -> Array:
    curved, planar = (Conditions(shape, 21, 4.0, "shift") for shape in ("curved", "planar"))
    return angles(curved, steps) - angles(planar, steps)


def best_gain(motion: Motion, step: float, sides: Sequence[int] = (7, 9, 11, 15, 21)) -> Statement:
    """Compare the best array of more than 7 x 7 detectors of `sides` with that of 7 x 7, first."""
    every = [Conditions("curved", side, 4.0, motion) for side in sides]

    def ours(angles: Angles) -> float:
        at_7, *others = (_of(angles, array, step) for array in every)
        return max(others) - at_7

    figure = "5a" if motion == "shift" else "5b"
    text = f"best gain over 7 x 7, 4 m, {motion} {step:g} {UNITS[motion]}"
    plain = every[0].as_object(step) | {"compared_with_detectors_per_side": [*sides[1:]]}
    return Statement(figure, text, plain, "not significant", ours)


_BOTH = {"array": "curved less planar", "detectors_per_side": 21, "range_m": 4.0}
# fmt: off
STATEMENTS = (
    Statement("4a", "curved less planar, shift > 0.6 m, mean",
              {**_BOTH, "shift_m": FAR.tolist(), "statistic": "mean"}, "is",
              lambda angles: float(_curved_less_planar(angles, FAR).mean()), 2.0),
    Statement("4a", "curved less planar, shift <= 0.6 m, largest",
              {**_BOTH, "shift_m": NEAR.tolist(), "statistic": "largest in magnitude"}, "similar",
              lambda angles: float(max(_curved_less_planar(angles, NEAR), key=abs))),
    _at("4b", Conditions("planar", 21, 4.0, "yaw"), 5.0, "is", 5.0),
    _at("4b", Conditions("planar", 21, 4.0, "yaw"), 10.0, "is", 11.0),
    _at("4b", Conditions("curved", 21, 4.0, "yaw"), 5.0, "is", 12.0),
    _at("4b", Conditions("curved", 21, 4.0, "yaw"), 10.0, "is", 22.0),
    _at("5a", Conditions("curved", 3, 4.0, "shift"), 0.2, "below", THRESHOLD_DEG),
    _at("5a", Conditions("curved", 5, 4.0, "shift"), 0.2, "above", THRESHOLD_DEG),
    best_gain("shift", 0.2),
    _at("5b", Conditions("curved", 3, 4.0, "yaw"), 10.0, "below", THRESHOLD_DEG),
    _at("5b", Conditions("curved", 5, 4.0, "yaw"), 10.0, "above", THRESHOLD_DEG),
    best_gain("yaw", 10.0),
    _at("6b", Conditions("curved", 5, 8.0, "shift"), 0.2, "above", 6.0),
    _at("6e", Conditions("curved", 5, 8.0, "yaw"), 10.0, "above", 10.0),
)
# fmt: on


def panels() -> dict[str, list[Conditions]]:
    """Return the curves of each panel of the paper's figures, by its number and letter."""
    curves: dict[str, list[Conditions]] = {}
    for motion, letter, letters in zip(MOTIONS, "ab", ("abc", "def"), strict=True):
        curves[f"4{letter}"] = [Conditions(s, 21, 4.0, motion) for s in get_args(Shape)]
        curves[f"5{letter}"] = [Conditions("curved", side, 4.0, motion) for side in SIDES]
        for side, of_side in zip((3, 5, 101), letters, strict=True):
            curves[f"6{of_side}"] = [Conditions("curved", side, m, motion) for m in RANGES_M]
    return dict(sorted(curves.items()))


def least_detected(steps: Array, angles: Array) -> float | None:
    """Return the first step whose angle reaches the paper's threshold, or ``None``."""
    reached = angles >= THRESHOLD_DEG
    return float(steps[reached.argmax()]) if reached.any() else None


def noisy(scene: Scene) -> Scene:
    """Return the scene with readings of 10 bits and a noise of 1 count, and no other noise."""
    effects = {name: keys for name, keys in scene.effects.items() if name != "shot_noise"}
    effects |= {"adc": {"bits": 10}, "sensor_noise": {"sigma_counts": 1.0}}
    return dataclasses.replace(scene, effects=check_effects(effects))


def noise_deg(scene: Scene, at: Conditions, step: float, rng: Generator, draws: int = 25) -> float:
    """Return the angle of a move between `noisy` readings, deg, the mean of pairs of them."""

    def read(model: ForwardModel, poses: Array) -> Array:
        return model.expose(np.broadcast_to(poses, (draws, *poses.shape)), rng)

    return float(angles_deg(noisy(scene), at, [step], read)[0])


def size_row(scene: Scene, side: int, rng: Generator) -> dict[str, Any]:
    """Return the angles of a curved array at 4 m, the least detected moves and the noise."""
    row: dict[str, Any] = {"detectors_per_side": side}
    for motion in MOTIONS:
        steps = np.append(STEPS[motion], WANTED[motion])
        angles = angles_deg(scene, Conditions("curved", side, 4.0, motion), steps)
        name = f"{WANTED[motion]:g}_{UNITS[motion]}".replace(".", "_")
        row[f"angle_deg_at_{name}"] = float(angles[-1])
        row[f"least_{motion}_{UNITS[motion]}"] = least_detected(steps[:-1], angles[:-1])
    for range_m in NOISE_RANGES_M:
        at = Conditions("curved", side, range_m, "shift")
        row[f"noise_deg_at_{range_m:g}_m"] = noise_deg(scene, at, 0.0, rng)
    return row


def reproduce(scene: Scene, seed: int) -> dict[str, Any]:
    """Return statements and curves of each figure, and the sizes, as the JSON has them."""
    rng, curves = np.random.default_rng(seed), panels()
    figures: dict[str, Any] = {panel: {"points": [], "curves": []} for panel in curves}
    angles = partial(angles_deg, scene)
    for statement in progress.over(STATEMENTS, "point"):
        figures[statement.figure]["points"].append(statement.row(statement.ours(angles)))
    sizes = [size_row(scene, side, rng) for side in progress.over(SIDES, "size")]
    for panel, at in progress.over([(name, at) for name in curves for at in curves[name]], "curve"):
        steps = STEPS[at.motion]
        figures[panel]["curves"].append({**at.as_object(steps), "angle_deg": angles(at, steps)})
    return {"complete": True, "figures": figures, "sizes": sizes}


def _number(ours: float) -> str:
    return "flat" if math.isnan(ours) else f"{ours:.1f}"


def report(result: Mapping[str, Any]) -> str:
    """Return the tables of `reproduce`."""
    points = [point for figure in result["figures"].values() for point in figure["points"]]
    rows: list[tuple[object, ...]] = [("no.", "fig", "spectral angle (deg)", "paper", "ours", "")]
    for i, (said, point) in enumerate(zip(STATEMENTS, points, strict=True), 1):
        ours, verdict = _number(point["ours_deg"]), f"{said.verdict(point['ours_deg']):4}"
        rows.append((i, said.figure, said.text, said.label, ours, verdict))
    heads = (*MOVES, "shift (m)", "yaw (deg)", "noise 4 m", "noise 8 m")
    by_size: list[tuple[object, ...]] = [("detectors", *heads)]
    for size in result["sizes"]:
        side, at_shift, shift, at_yaw, yaw, *noisy_deg = size.values()
        least = ["none" if step is None else f"{step:g}" for step in (shift, yaw)]
        angles = _number(at_shift), _number(at_yaw)
        by_size.append((f"{side} x {side}", *angles, *least, *map(_number, noisy_deg)))
    return f"""\
{columns(rows, 3)}

Curved arrays: angles at 4 m; the least move that shows {THRESHOLD_DEG:g} deg there;
and the angle between two readings of one pose, with 10 bits and 1 count of noise.
{columns(by_size)}"""


BESIDE: Any = {"loc": "upper left", "bbox_to_anchor": (1, 1), "fontsize": 9, "frameon": False}
AXES: dict[Motion, str] = {"shift": "shift to starboard (m)", "yaw": "yaw (deg)"}


def draw(figures: Mapping[str, Any], scene_name: str) -> Any:
    """Draw the figures of `reproduce`, panel by panel, with the statements of the paper's text."""
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
        # Dark for many detectors and for far, so that it shows in grey, too.
        told: dict[str, Any] = {}  # colours of the curves, by their names
        for curve, shade in zip(curves, shades("viridis", 0.85, 0, len(curves)), strict=True):
            names = {"4": curve["array"], "5": f"{curve['detectors_per_side']}"}
            dashed = "--" if curve["array"] == "planar" else "-"
            name = names.get(panel[0], f"{curve['range_m']:g} m")
            axes.plot(STEPS[motion], curve["angle_deg"], dashed, color=shade, lw=1.8, label=name)
            told[name] = shade
        _draw_statements(axes, panel, motion, told)
        axes.legend(**BESIDE)
    ours = f"our curves (scene {scene_name}); marks, what the text states"
    picture.suptitle(f"Eren et al. (2016), Figs 4 to 6: {ours}", fontsize=13)
    return picture


def _draw_statements(axes: Any, panel: str, motion: Motion, colours: Mapping[str, Any]) -> None:
    """Mark what the text states of curves, each in its curve's colour, with the number beside."""
    if panel == "4a":
        axes.axvspan(FAR[0], FAR[-1], color="0.9", zorder=0, label="text: curved\n2 deg more")
        return
    if panel[0] == "5":
        axes.axhline(THRESHOLD_DEG, color="k", lw=1, ls="--", label=f"{THRESHOLD_DEG:g} deg")
    for statement in STATEMENTS:
        if statement.figure == panel and statement.paper is not None:
            about, angle = statement.conditions, statement.paper
            which = {"4": about["array"], "6": f"{about['range_m']:g} m"}
            name = which.get(panel[0], f"{about['detectors_per_side']}")
            step = about[f"{motion}_{UNITS[motion]}"]
            # A triangle's tip is at the number, its body where the curve is not to be.
            marker, low = {"is": ("o", -4), "above": (6, -11), "below": (7, 6)}[statement.relation]
            look: Any = {"marker": marker, "ms": 9, "mec": "k", "mfc": colours[name], "zorder": 4}
            axes.plot(step, angle, ls="", **look)
            words: Any = {"textcoords": "offset points", "fontsize": 9, "fontweight": "bold"}
            words["bbox"] = {"fc": "w", "ec": "none", "pad": 0.5, "alpha": 0.8}
            text = statement.label if panel[0] == "4" else f"{name}: {statement.label}"
            axes.annotate(text, (step, angle), (9, low), zorder=5, **words)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "eren2016")
    outputs.add_picture(parser, "paper.png")
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Compute, print and draw."""
    scene = options.scene_of(args)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    about = {"scene": scene.name, "seed": SEED, "picture": str(output)}
    result = {**about, **reproduce(scene, SEED)}
    save(draw(result["figures"], scene.name), output)
    text = f"Eren et al. (2016) and scene {scene.name}\n\n{report(result)}\n\npicture: {output}"
    return outputs.finish(args, result, text)
