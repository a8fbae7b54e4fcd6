"""``uuv_array study tradeoff``: measure accuracy against computing time.

Measure error and time per frame of every method (sam, sam_interpolated, least_squares, and the
published look-up and moments) on arrays of 3, 5, 7 and 21 detectors a side, planar and curved, with
tables of 1e3 to 1e7 poses. Errors are of random poses 4 to 8 m behind the lamp, +-0.9 m and
+-20 deg; times are from an image to its pose. The results, with the time to build each table, go
into a CSV file and a picture in the output folder. See docs/results/tradeoff.md.

  uuv_array study tradeoff                   some settings of the reference scene
  uuv_array study tradeoff --full            all of them
  uuv_array study tradeoff --scene sea.yaml  your own scene, into sea.tradeoff/
Ctrl-C ends it early and writes the settings that are measured.
"""

import argparse
import dataclasses
import math
import os
import platform
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.estimation.estimator import METHODS, Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward import working_volume
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import GUESSED, SPECIFIED
from uuv_optical_array.plots import style
from uuv_optical_array.studies.shared import errors, published
from uuv_optical_array.studies.shared.results import STEP, until_interrupted, write

SETTINGS_CSV = "tradeoff.csv"
SEED = 1
Mode = Literal["quick", "full"]

# Our methods have a table of any size, the published ones that of their publication.
LOOK_UP, MOMENTS = "look_up", "moments"
PUBLISHED: tuple[str, ...] = (LOOK_UP, MOMENTS)
SIDES = (3, 5, 7, 21)
SHAPES: tuple[Shape, ...] = ("curved", "planar")
# Values along each of the five axes: 1e3, 8e3, 1e5, 1e6 and 1e7 poses.
STEPS: tuple[int, ...] = (4, 6, 10, 16, 25)
FRAMES: dict[Mode, int] = {"quick": 300, "full": 1000}
QUICK_LOOK_UP_SIDE = 7
# A setting that leaves more frames than this without a pose has no fair error, and is no choice.
MOST_WITHOUT_POSE = 0.01
QUICK_LEAVES_OUT = (
    "left out but for --full: tables of 1e7 poses, of 1e6 but on the scene's own array, of 1e3 and "
    "8e3 on arrays of the other shape, and the look-up but on planar arrays up to 7 x 7"
)
ERRORS = {
    "position": ("position_m", "RMS position error (m)", 0),
    "angle": ("angle_deg", "RMS angle error (deg)", 1),
}


@dataclass(frozen=True)
class Setting:
    """A method with an array and a table."""

    method: str
    shape: Shape
    detectors_per_side: int
    steps: int  # values along each axis of the table; 0: a published method has its own

    def scene(self, scene: Scene) -> Scene:
        """Return the scene with this array, and with a table of the working volume."""
        array = scene.array.with_shape(self.shape)
        array = dataclasses.replace(array, detectors_per_side=self.detectors_per_side, wiring=None)
        table = working_volume.volume_table(self.steps) if self.steps else scene.table
        return dataclasses.replace(scene, array=array, table=table)


def plan(scene: Scene, mode: Mode) -> list[Setting]:
    """List the settings of a run, those of the scene's own array first."""
    own = scene.array
    sides = sorted({*SIDES, own.detectors_per_side}, key=lambda n: (n != own.detectors_per_side, n))
    settings = []
    for shape in sorted(SHAPES, key=lambda shape: shape != own.shape):
        for side in sides:
            steps, published_ones = STEPS, PUBLISHED
            if mode == "quick":
                steps = STEPS[2:3]
                if shape == own.shape:
                    steps = STEPS[:4] if side == own.detectors_per_side else STEPS[:3]
                if shape != "planar" or side > QUICK_LOOK_UP_SIDE:
                    published_ones = (MOMENTS,)
            settings += [Setting(method, shape, side, n) for n in steps for method in METHODS]
            settings += [Setting(method, shape, side, 0) for method in published_ones]
    return settings


def this_machine() -> str:
    """Name the processor and the number of its cores: times hold for one machine."""
    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            name = next(line.partition(":")[2] for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return f"{' '.join(name.split())}, {os.cpu_count()} cores"


def origin_of(scene: Scene, mode: Mode) -> dict[str, Any]:
    """Return what a measurement made now depends on beside its setting."""
    about = {"scene": scene.name, "fingerprint": scene.fingerprint, "machine": this_machine()}
    return {**about, "mode": mode, "frames": FRAMES[mode], "seed": SEED}


@dataclass(frozen=True)
class Measurement(Setting):
    """The measured error and time of a setting.

    Errors and bounds are RMS distances, and angles of pitch and yaw together: nan where no frame
    got a pose, inf where a pose is unobservable.
    """

    table_rows: int
    without_pose: float  # share of the frames
    position_m: float
    angle_deg: float
    bound_position_m: float  # by Cramer and Rao, of the image alone
    bound_angle_deg: float
    floor_position_m: float  # with the volume known, as `known_volume_std`
    floor_angle_deg: float
    median_ms: float  # from image to pose
    p99_ms: float
    model_ms: float  # of a forward model of the scene's own array, timed between the frames
    models: float  # `median_ms` over it, which hardly depends on how busy the machine is
    build_s: float  # of table or calibration
    load_average: float

    @property
    def label(self) -> str:
        """The setting in words."""
        side = self.detectors_per_side
        table = f", table {self.table_rows:.0e}".replace("e+0", "e") if self.table_rows else ""
        return f"{self.method}, {self.shape} {side} x {side}{table}"

    @property
    def effort(self) -> tuple[float, ...]:
        """The order of settings: fewest detectors, smallest table, least time."""
        return self.detectors_per_side, self.table_rows, self.median_ms


def _published(scene: Scene, method: str, rng: np.random.Generator) -> tuple[errors.Answer, int]:
    """Return how a published method answers, and the rows of its table, if any."""
    pose, rows = _no_calibration, 0
    if method == LOOK_UP:
        table = build_table(published.lookup_scene(scene))
        pose, rows = published.LookUp(table).pose, len(table.poses)
    else:
        with suppress(np.linalg.LinAlgError, ValueError):
            pose = published.calibrate(ForwardModel(scene), rng).pose
    return lambda image: (pose(image), math.nan), rows


def _no_calibration(image: ArrayLike) -> Array:
    raise NoPose("no calibration: the array cannot be calibrated at the paper's poses")


def measure(
    scene: Scene, settings: Sequence[Setting], frames: int, seed: int
) -> Iterator[Measurement]:
    """Measure settings of one array and one table, which all see the same images."""
    yardstick, first, table, build_s = ForwardModel(scene), settings[0], None, math.nan
    scene = first.scene(scene)
    model = ForwardModel(scene)
    rng = np.random.default_rng([seed, first.detectors_per_side, SHAPES.index(first.shape)])
    poses = working_volume.lit_poses(model, frames, rng)
    images, bound = model.expose(poses, rng), cramer_rao_bound(model, poses)
    floor, rms = working_volume.known_volume_std(bound.information), errors.position_and_angle
    for setting in settings:
        began = time.perf_counter()
        if setting.method not in METHODS:
            answer, rows = _published(scene, setting.method, rng)
            build_s = time.perf_counter() - began
        else:
            if table is None:
                table = build_table(scene)
                build_s = time.perf_counter() - began
            answer = errors.answer_of(Estimator(table, setting.method).wait())
            rows = len(table.poses)
        result = errors.frame_errors(answer, yardstick, poses, images, range(frames))
        if len(result.errors) < frames:
            raise KeyboardInterrupt  # cut short, so no measurement
        values: list[Any] = [*vars(setting).values(), rows, float((~result.posed).mean())]
        values += [*rms(result.errors[result.posed]), *rms(bound.std), *rms(floor)]
        values += [*result.frame_ms, result.model_ms, result.frame_ms[0] / result.model_ms]
        values += [build_s, os.getloadavg()[0]]
        yield Measurement(*values)


def measure_all(scene: Scene, mode: Mode) -> tuple[list[Measurement], bool]:
    """Measure the settings of a mode, and say whether all are there, or Ctrl-C ended it early."""
    settings = plan(scene, mode)
    groups = groupby(settings, lambda one: (one.shape, one.detectors_per_side, one.steps))
    rows = (row for _, group in groups for row in measure(scene, [*group], FRAMES[mode], SEED))
    return until_interrupted(progress.over(rows, "setting", total=len(settings)))


def fronts(rows: Sequence[Measurement]) -> dict[str, list[Measurement]]:
    """Return the rows on each Pareto front, by ``position`` and ``angle``, the fastest first.

    The costs are the median time, in forward models, and one of the two errors, rounded to steps of
    10 %; of equal settings the one of least effort counts. A setting has to pose nearly all frames,
    and be better than the middle of the volume, which is an estimate without any measurement.
    """

    def step(cost: float) -> float:
        return float(np.round(np.log(cost) / np.log(STEP)))

    on_front: dict[str, list[Measurement]] = {name: [] for name in ERRORS}
    posed = [row for row in rows if row.without_pose <= MOST_WITHOUT_POSE]
    for name, (column, _, which) in ERRORS.items():
        costs = {row: (step(row.models), step(getattr(row, column))) for row in posed}
        least = step(GUESSED[which])
        for row in sorted(posed, key=lambda row: (costs[row], row.effort)):
            if costs[row][1] < least:  # of those that are as fast or faster
                on_front[name].append(row)
                least = costs[row][1]
    return on_front


def numbered(rows: Sequence[Measurement]) -> list[Measurement]:
    """Return the settings on any front, the fastest first."""
    on_front = {row for front in fronts(rows).values() for row in front}
    return sorted(on_front, key=lambda row: row.models)


def report(rows: Sequence[Measurement]) -> str:
    """Return the table of the settings on a front."""
    heads = ("no", "setting", "position", "angle", "median", "99 %", "models", "front")
    lines: list[tuple[object, ...]] = [heads, ("", "", "m", "deg", "ms", "ms")]
    on_front = fronts(rows)
    for number, row in enumerate(numbered(rows), start=1):
        off = f"{row.position_m:.3f}", f"{row.angle_deg:.2f}"
        times = f"{row.median_ms:.2f}", f"{row.p99_ms:.2f}", f"{row.models:.1f}"
        names = " and ".join(name for name, front in on_front.items() if row in front)
        lines.append((number, row.label, *off, *times, names))
    return columns(lines, 2)


PALE = 0.5  # how opaque the mark of a setting on no front is
LINE_IN = 0.19  # height of a line of the table


def draw(rows: Sequence[Measurement], about: str) -> Any:
    """Draw errors against time, every setting a mark; return the figure."""
    table, mark = report(rows), style.mark
    panels_in, table_in = 6.6, LINE_IN * (1 + len(table.splitlines()))
    figure = style.new_figure(14, panels_in + table_in + 1.4)  # and title and legend
    grid = figure.add_gridspec(2, 1, height_ratios=[panels_in, table_in])
    above = grid[0].subgridspec(1, 2)
    for i, name in enumerate(ERRORS):
        _draw_panel(figure.add_subplot(above[0, i]), rows, name)
    style.write_table(figure.add_subplot(grid[1]), table, 10, 1.35)
    marks = {m: at for m, at in style.METHOD_MARKS.items() if any(row.method == m for row in rows)}
    handles = [
        *(mark(m, at, color=style.METHOD_COLOURS[m], ms=8) for m, at in marks.items()),
        mark("filled: curved array", "h", ms=8),
        mark("hollow: planar array", "h", mfc="none", ms=8),
        mark("pale: another setting is better", "h", alpha=PALE, ms=8),
        mark("front, numbered as below", "", color="k", lw=1.5),
        mark(f"over {MOST_WITHOUT_POSE:.0%} without a pose", "x", color="0.5"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=10, frameon=False)
    figure.suptitle(f"What accuracy costs in time\n{about}", fontsize=12)
    return figure


def _draw_panel(axes: Any, rows: Sequence[Measurement], name: str) -> None:
    column, title, which = ERRORS[name]
    front = fronts(rows)[name]
    for row in rows:
        colour = style.METHOD_COLOURS[row.method]
        size = 90 if row in front else 45
        look = {"marker": style.METHOD_MARKS[row.method], "fc": colour, "ec": colour, "s": size}
        if row.without_pose > MOST_WITHOUT_POSE:
            look = {"marker": "x", "color": "0.5", "s": 30}
        elif row.shape == "planar":
            look["fc"] = "none"
        alpha = 1.0 if row in front else PALE
        axes.scatter(row.median_ms, getattr(row, column), alpha=alpha, zorder=3, **look)
    axes.set(xscale="log", yscale="log", xlabel="median time of a frame (ms)", ylabel=title)
    best = min(rows, key=lambda row: getattr(row, f"floor_{column}"))
    side, unit = best.detectors_per_side, column.rpartition("_")[2]
    wanted = SPECIFIED[which]
    for value, text, line, colour in (
        (wanted, f"{wanted:g} {unit}, wanted by the paper", "--", style.SPECIFIED),
        (GUESSED[which], "no measurement at all", ":", "0.4"),
        (getattr(best, f"floor_{column}"), f"bound, {best.shape} {side} x {side}", "-.", "0.4"),
    ):
        axes.axhline(value, color=colour, ls=line, lw=1.5, zorder=1)
        words = {"textcoords": "offset points", "fontsize": 9, "ha": "right"}
        axes.annotate(text, (0.99, value), (0, 3), axes.get_yaxis_transform(), **words)
    points = {
        number: (row.median_ms, float(getattr(row, column)))
        for number, row in enumerate(numbered(rows), 1)
        if row in front
    }
    axes.step(*zip(*points.values(), strict=True), where="post", color="k", lw=1.5, zorder=2.5)
    style.number_points(axes, points)
    axes.grid(alpha=0.3, which="both", lw=0.4)
    for axis in (axes.xaxis, axes.yaxis):
        style.plain_log_ticks(axis)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "reference")
    about = "all methods, arrays and tables, more frames"
    parser.add_argument("--full", action="store_true", help=about)
    options.add_json(parser)
    about = "folder of CSV file and picture, .png and .pdf (default: SCENE.tradeoff here)"
    outputs.add_folder(parser, about)


def run(args: argparse.Namespace) -> int:
    """Measure, and write, draw and print the results."""
    scene = options.scene_of(args)
    mode: Mode = get_args(Mode)[args.full]
    folder = outputs.folder_to_write(args.output or f"{scene.name}.tradeoff", "--output")
    origin = origin_of(scene, mode)
    rows, complete = measure_all(scene, mode)
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / SETTINGS_CSV, origin, [vars(row) for row in rows])
    loads = [row.load_average for row in rows]
    load = f"load average {min(loads):.1f} to {max(loads):.1f}"
    about = f"scene {scene.name}, {origin['frames']} frames each; {origin['machine']}, {load}"
    pictures = [str(folder / f"tradeoff{suffix}") for suffix in (".png", ".pdf")]
    figure = draw(rows, about)
    for picture in pictures:
        style.save(figure, Path(picture))
    without = sum(row.without_pose > MOST_WITHOUT_POSE for row in rows)
    lines = [
        f"{about}\n\nPareto-optimal settings in time and error:\n{report(rows)}\n",
        f"{without} of {len(rows)} settings left more than 1 % of frames without a pose",
        *([QUICK_LEAVES_OUT] if mode == "quick" else []),
        f"file: {folder / SETTINGS_CSV}",
        f"pictures: {', '.join(pictures)}",
    ]
    labels = {name: [row.label for row in front] for name, front in fronts(rows).items()}
    result = {"complete": complete, **origin, "settings": [vars(row) for row in rows]}
    result |= {"fronts": labels, "pictures": pictures}
    missing = f"{len(rows)} of {len(plan(scene, mode))} settings"
    return outputs.finish(args, result, "\n".join(lines), complete, missing)
