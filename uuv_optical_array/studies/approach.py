"""``uuv_array study approach``: repeat the Monte Carlo of Eren et al. (2017), and by our method."""

import argparse
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage.formats import columns, plain
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.plots.style import METHOD_COLOURS, new_figure, save
from uuv_optical_array.studies.approach_runs import (
    AIM,
    CASES,
    FRAMES,
    METHODS,
    RANGES_M,
    ApproachErrors,
    Case,
    Choices,
    Noise,
    simulate,
)
from uuv_optical_array.studies.shared.errors import by_column
from uuv_optical_array.studies.shared.results import until_interrupted

DESCRIPTION = """\
Repeat the Monte Carlo of Eren et al. (Sensors 2017): a follower closes from 8.5 m to 4.5 m behind a
lamp at 0.5 m/s and takes 41 images, in a dive and in a zigzag, in tank water and in murkier water.
In every run temperature and attenuation are off by unknown constants. The published errors stand
beside those of the published method built again (moments), of single images (least_squares), of
these tracked (tracker), and of a smoother that takes lamp and water for constant (docking).
docs/results/approach.md explains every choice."""

EPILOG = """\
examples:
  uuv_array study approach                      100 runs of each case
  uuv_array study approach --runs 2000          as many as the paper
  uuv_array study approach --choices gaussian   1 % as a standard deviation
  uuv_array study approach --choices --runs 60  what each choice changes, at the end of a run
Ctrl-C ends it early and reports the complete runs."""

PUBLISHED = "mean_end", "start_95", "end_95"  # errors, as of a `Case`
PRINTED = {"mean_end": "mean error at the end", "end_95": "95 % of errors at the end"}
HALF, SEED = 0.5, 1
CUT_SHORT = "only complete runs count"
SIGMA_95 = 1.96
WIDE_BEAM_DEG = 15.0


def choices_named(names: Sequence[str]) -> Choices:
    """Return the choices of names, a kind of `Noise` and ``half``; ValueError for two kinds."""
    kinds = [name for name in get_args(Noise) if name in names] or [Choices().noise]
    if len(kinds) > 1:
        raise ValueError(f"--choices: {' and '.join(kinds)} exclude each other; leave one out")
    return Choices(kinds[0], HALF if "half" in names else 1.0)


def alternatives(scene: Scene) -> dict[str, tuple[Scene, Choices]]:
    """Return the choices that are compared where the paper leaves one open, by name."""
    lamp = dataclasses.replace(scene.lamp, beam_sigma_deg=WIDE_BEAM_DEG)
    return {
        "as by default": (scene, Choices()),
        "noise gaussian": (scene, Choices("gaussian")),
        "noise averaged": (scene, Choices("averaged")),
        "offsets half": (scene, Choices(offset_share=HALF)),
        f"beam {WIDE_BEAM_DEG:g} deg": (dataclasses.replace(scene, lamp=lamp), Choices()),
    }


def all_cases(
    scene: Scene,
    choices: Choices,
    runs: int,
    seed: int,
    done: Callable[[int], object] = lambda runs: None,
) -> Iterator[tuple[str, ApproachErrors]]:
    """Yield the errors of case after case, each from the same seed.

    After Ctrl-C the last one is of fewer runs; Ctrl-C before its first is raised.
    """
    for name, case in CASES.items():
        result = simulate(scene, case, choices, runs, np.random.default_rng(seed), done)
        yield name, result
        if result.runs < runs:
            return


def as_object(case: Case, result: ApproachErrors) -> dict[str, Any]:
    """Return a case as plain values, in m and deg; None where the paper gives none."""

    def of_method(method: str) -> dict[str, Any]:
        mean, errors = result.mean(method), result.percentile_95(method)
        about_mean, ratio = result.percentile_95(method, about_mean=True), result.ratio(method)
        values = {"mean_end": mean[-1], "start_95": errors[0], "end_95": errors[-1]}
        values |= {"start_95_about_mean": about_mean[0], "end_95_about_mean": about_mean[-1]}
        ratios = zip(RANGES_M.round(1)[::5], ratio[::5], strict=True)
        return {
            **{name: by_column(value * IN_DEGREES) for name, value in values.items()},
            "ratio_to_bound": {f"{metres:g} m": by_column(values) for metres, values in ratios},
            "without_pose": result.without_pose(method),
        }

    figures = {
        "runs": result.runs,
        "published": {name: by_column(getattr(case, name)) for name in PUBLISHED},
        "aim_end_95": by_column(case.end_95 / AIM),
        "methods": {method: of_method(method) for method in METHODS},
        "bound_end_95": by_column(SIGMA_95 * result.bound[-1] * IN_DEGREES),
        "run_bound_end_95": by_column(SIGMA_95 * result.run_bound[-1] * IN_DEGREES),
    }
    return plain(figures)


def _row(label: str, values: Mapping[str, float | None]) -> list[str]:
    return [label, *("-" if value is None else f"{value:.3f}" for value in values.values())]


def report(name: str, case: Mapping[str, Any]) -> str:
    """Return the table of a case, from `as_object`."""
    rows: list[Sequence[str]] = [(f"{name}, runs: {case['runs']}", *DOF_NAMES), ("", *DOF_UNITS)]
    for key, title in PRINTED.items():
        rows += [(title,), _row("  published", case["published"][key])]
        for method, values in case["methods"].items():
            rows.append(_row(f"  {method}", values[key]))
            if method == "moments" and key != "mean_end":
                rows.append(_row("    about their mean", values[f"{key}_about_mean"]))
    rows.append(_row("  the aim", case["aim_end_95"]))
    rows.append(_row("  bound of one image", case["bound_end_95"]))
    rows.append(_row("  bound of all, with the motion", case["run_bound_end_95"]))
    counts = (f"{method} {values['without_pose']}" for method, values in case["methods"].items())
    without = f"frames without a pose, of {case['runs'] * FRAMES}: {', '.join(counts)}"
    return f"{columns(rows)}\n{without}"


def compare(scene: Scene, runs: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield every choice in every case, as `as_object`; Ctrl-C ends it as it ends `all_cases`."""
    plans = alternatives(scene)
    with progress.counter(total=runs * len(plans) * len(CASES), unit="run") as bar:
        for choice, (tank, choices) in plans.items():
            for name, result in all_cases(tank, choices, runs, seed, bar.update):
                yield {"choice": choice, "case": name, **as_object(CASES[name], result)}
                if result.runs < runs:
                    return


def comparison(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rows of `compare` as a table of the 95 % errors at the end."""
    lines: list[Sequence[str]] = [("case", "choice", "method", *DOF_NAMES)]
    for name in CASES:
        of_case = [row for row in rows if row["case"] == name]
        for row in of_case[:1]:
            lines.append((name, "", *_row("published", row["published"]["end_95"])))
        for row in of_case:
            for method, values in row["methods"].items():
                choice = row["choice"] if method == METHODS[0] else ""
                lines.append(("", choice, *_row(method, values["end_95"])))
    return columns(lines, 3)


PUBLISHED_COLOUR = "#e08a00"
ROWS = {
    "x, along the beam (m)": [0],
    "worse of y, z (m)": [1, 2],
    "worse of pitch, yaw (deg)": [3, 4],
}


def draw(results: Mapping[str, ApproachErrors], about: str) -> Any:
    """Draw 95 % errors against range, a column a case; return the figure."""
    figure = new_figure(max(9.2, 4.6 * len(results)), 10.5)
    grid = figure.subplots(3, len(results), sharex=True, sharey="row", squeeze=False)
    for column, (name, result) in zip(grid.T, results.items(), strict=True):
        for axes, dofs in zip(column, ROWS.values(), strict=True):
            _draw_panel(axes, CASES[name], result, dofs)
        column[0].set_title(f"{name}, K {CASES[name].k_per_m:g} /m", fontsize=12)
        column[-1].set_xlabel("behind the lamp (m)")
    for axes, title in zip(grid[:, 0], ROWS, strict=True):
        axes.set_ylabel(title, fontsize=12)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=11)
    figure.suptitle(f"95 % of errors during an approach; {about}", fontsize=14)
    return figure


def _draw_panel(axes: Any, case: Case, result: ApproachErrors, dofs: list[int]) -> None:
    """Draw the worst of some degrees of freedom."""

    def worst(values: Array) -> Array:
        return np.asarray((values * IN_DEGREES)[..., dofs].max(axis=-1))

    for method in METHODS:
        errors = worst(result.percentile_95(method))
        axes.plot(RANGES_M, errors, color=METHOD_COLOURS[method], lw=2, label=method)
    axes.plot(RANGES_M, SIGMA_95 * worst(result.bound), "k--", lw=1.2, label="bound of one image")
    all_so_far = SIGMA_95 * worst(result.run_bound)
    axes.plot(RANGES_M, all_so_far, "k:", lw=1.5, label="bound of all so far")
    filled = {"color": PUBLISHED_COLOUR, "ms": 9, "mec": "k"}
    hollow = {"mfc": "w", "mec": PUBLISHED_COLOUR, "mew": 2, "ms": 8}
    for metres, errors in ((RANGES_M[0], case.start_95), (RANGES_M[-1], case.end_95)):
        # fmax passes over what the paper does not give.
        axes.plot(metres, np.fmax.reduce(errors[dofs]), "D", **filled, clip_on=False, zorder=5)
    aim = (case.end_95 / AIM)[dofs].max()
    axes.plot(RANGES_M[-1], aim, "D", **hollow, clip_on=False, zorder=6)
    axes.plot([], [], "D", **filled, label="published")
    axes.plot([], [], "D", **hollow, label="the aim")
    axes.set(yscale="log", xlim=(RANGES_M[0], RANGES_M[-1]))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.grid(alpha=0.4, which="both", lw=0.4)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "eren2017_tank")
    options.add_number(parser, "runs", Quantity("runs of each case", "", 1, 1e6), 100)
    parser.add_argument(
        "--choices",
        nargs="*",
        choices=(*get_args(Noise), "half"),
        help="noise of 1 %%: uniform from 0 to 1 %% (default), Gaussian with that standard "
        "deviation, or averaged over 10 uniform readings; half: half the offsets of temperature "
        "and attenuation; nothing named: compare all at the end of a run",
    )
    options.add_json(parser)
    outputs.add_picture(parser, "approach.png")


def run(args: argparse.Namespace) -> int:
    """Run the cases, print them and draw them."""
    runs = args.runs
    with options.checking_options():
        choices = choices_named(args.choices or ())
    scene = options.scene_of(args)
    output: Path = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    origin: dict[str, Any] = {"scene": scene.name, "seed": SEED, "asked_runs": runs}
    if args.choices == []:
        rows = until_interrupted(compare(scene, runs, SEED))
        whole = len(rows) == len(alternatives(scene)) * len(CASES) and rows[-1]["runs"] == runs
        missing = "" if whole else CUT_SHORT
        return outputs.finish(args, {**origin, "rows": rows}, comparison(rows), missing)
    with progress.counter(total=runs * len(CASES), unit="run") as bar:
        results = dict(until_interrupted(all_cases(scene, choices, runs, SEED, bar.update)))
    cases = {name: as_object(CASES[name], result) for name, result in results.items()}
    offsets = "half" if choices.offset_share == HALF else "whole"
    about = f"noise {choices.noise}, offsets {offsets}, seed {SEED}"
    save(draw(results, about), output)
    origin |= {"noise": choices.noise, "offsets": offsets, "cases": cases, "picture": str(output)}
    tables = "\n\n".join(report(name, case) for name, case in cases.items())
    text = f"scene {scene.name}; {about}\n\n{tables}\npicture: {output}"
    whole = len(cases) == len(CASES) and all(case["runs"] == runs for case in cases.values())
    return outputs.finish(args, origin, text, "" if whole else CUT_SHORT)
