"""``uuv_array approach``: the published Monte Carlo of approaches to a lamp, beside ours."""

import argparse
import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tqdm import tqdm

from uuv_optical_array.commands.parser import (
    INTERRUPTED,
    Subparsers,
    add_command,
    add_json,
    add_scene,
)
from uuv_optical_array.core import files
from uuv_optical_array.core.geometry import DOF_NAMES, Array
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.forward.scene import Scene, load_scene
from uuv_optical_array.plots.follow import save
from uuv_optical_array.studies.approach import (
    CASES,
    FRAMES,
    METHODS,
    RANGES_M,
    Case,
    Choices,
    Noise,
    Result,
    simulate,
)

DESCRIPTION = """\
Repeat the Monte Carlo of Eren et al. (Sensors 2017): a follower closes from 8.5 m to 4.5 m behind a
lamp at 0.5 m/s and sees 41 images, in a dive and in a zigzag, in tank water and in murkier water.
In every run temperature and attenuation are off by constants that nobody knows. Its errors as
published stand beside those of its method built again (moments), of single images
(least_squares), of these tracked (tracker), and of a smoother that takes lamp and water for
constant (docking). docs/baselines.md explains every choice."""

EPILOG = """\
examples:
  uuv_array approach                       100 runs a case: about a minute
  uuv_array approach --runs 2000           as many as the paper: about 20 minutes
  uuv_array approach --noise gaussian      1 % as a standard deviation
  uuv_array approach --choices --runs 60   what each choice changes, at the end of a run
Ctrl-C ends it early and reports the runs it has."""

NUMBERS = {
    "runs": Quantity("runs of each case", "", 1, 1e6),
    "seed": Quantity("seed of offsets and noise", "", 0, 2**32 - 1),
}
RUNS = 100
OFFSETS = {"whole": 1.0, "half": 0.5}
IN_DEGREES = np.array([1, 1, 1, *np.degrees([1, 1])])
COLUMNS = ("x_m", "y_m", "z_m", "pitch_deg", "yaw_deg")
WIDE_BEAM_DEG = 15.0
COLOURS = dict(zip(METHODS, ("#c8401e", "#8a8a8a", "#2c9c5a", "#1f4fb4"), strict=True))
PUBLISHED = "#e08a00"
ROWS = {
    "x, along the beam (m)": [0],
    "worse of y, z (m)": [1, 2],
    "worse of pitch, yaw (deg)": [3, 4],
}
SIGMA_95 = 1.96
AIM = (5, 5, 5, 1, 1)  # shares of the published errors at the end


def add_parser(subparsers: Subparsers) -> None:
    """Add the subcommand."""
    parser = add_command(
        subparsers,
        "approach",
        run,
        "repeat the published Monte Carlo of approaches, with the published and our estimators",
        DESCRIPTION,
        EPILOG,
    )
    add_scene(parser, "eren2017_tank")
    for name, default in (("runs", RUNS), ("seed", 1)):
        parser.add_argument(
            f"--{name}",
            type=int,
            default=default,
            metavar="N",
            help=f"{NUMBERS[name].text} (default: %(default)s)",
        )
    parser.add_argument(
        "--noise",
        choices=get_args(Noise),
        default="uniform",
        help="what 1 %% of noise is: uniform from 0 to 1 %%, Gaussian with that standard "
        "deviation, or the mean of 10 uniform readings (default: %(default)s)",
    )
    parser.add_argument(
        "--offsets",
        choices=OFFSETS,
        default="whole",
        help="standard deviation of temperature and attenuation: 3 C and 0.015 /m, or half of "
        "that (default: %(default)s)",
    )
    parser.add_argument(
        "--choices", action="store_true", help="compare what the paper leaves open, at the end"
    )
    add_json(parser)
    parser.add_argument(
        "--output", type=Path, default=Path("approach.png"), help="picture (default: approach.png)"
    )


def by_column(values: Iterable[float]) -> dict[str, float | None]:
    """Name the values of the five degrees of freedom; None is not known."""
    known = (None if np.isnan(value) else float(value) for value in values)
    return dict(zip(COLUMNS, known, strict=True))


def as_object(case: Case, found: Result) -> dict[str, Any]:
    """Return a case as plain values, in m and deg."""
    methods = {}
    for method in METHODS:
        ends = found.percentile_95(method) * IN_DEGREES
        about_mean = found.percentile_95(method, about_mean=True) * IN_DEGREES
        ratio = found.ratio(method)
        methods[method] = {
            "mean_end": by_column(found.mean(method)[-1] * IN_DEGREES),
            "start_95": by_column(ends[0]),
            "end_95": by_column(ends[-1]),
            "start_95_about_mean": by_column(about_mean[0]),
            "end_95_about_mean": by_column(about_mean[-1]),
            "ratio_to_bound": {
                f"{metres:g} m": by_column(ratio[frame])
                for frame, metres in list(enumerate(RANGES_M.round(1)))[::5]
            },
            "without_pose": found.without_pose(method),
        }
    published = {
        field.name: by_column(getattr(case.published, field.name))
        for field in dataclasses.fields(case.published)
    }
    bounds = {
        name: by_column(SIGMA_95 * bound[-1] * IN_DEGREES)
        for name, bound in (("bound_end_95", found.bound), ("run_bound_end_95", found.run_bound))
    }
    return {"runs": found.runs, "published": published, "methods": methods, **bounds}


def _numbers(values: dict[str, float | None]) -> str:
    shown = ("-" if value is None else f"{value:.3f}" for value in values.values())
    return "".join(f"{text:>8}" for text in shown)


def report(name: str, told: dict[str, Any]) -> str:
    """Return a case in words."""
    heads = "".join(f"{head:>8}" for head in DOF_NAMES)
    units = "".join(f"{unit:>8}" for unit in ("m", "m", "m", "deg", "deg"))
    parts = [f"{name}, runs: {told['runs']}"]
    for key, title in (
        ("mean_end", "mean error at the end"),
        ("start_95", "95 % of errors at the start"),
        ("end_95", "95 % of errors at the end"),
    ):
        parts += [f"{title:<32}{heads}", f"{'':<32}{units}"]
        parts.append(f"  {'published':<30}{_numbers(told['published'][key])}")
        for method, values in told["methods"].items():
            parts.append(f"  {method:<30}{_numbers(values[key])}")
            if method == "moments" and key != "mean_end":
                parts.append(f"  {'  about their mean':<30}{_numbers(values[f'{key}_about_mean'])}")
    published = told["published"]["end_95"].values()
    # Position is to be five times as good, angles no worse.
    wanted = [value / share for value, share in zip(published, AIM, strict=True)]
    parts.append(f"  {'the aim':<30}{_numbers(by_column(wanted))}")
    parts.append(f"  {'bound of one image':<30}{_numbers(told['bound_end_95'])}")
    parts.append(f"  {'bound of all, with the motion':<30}{_numbers(told['run_bound_end_95'])}")
    parts.append(f"{'least_squares, RMS over bound at':<32}{heads}")
    for metres, ratio in told["methods"]["least_squares"]["ratio_to_bound"].items():
        parts.append(f"  {metres:<30}{_numbers(ratio)}")
    without = {key: values["without_pose"] for key, values in told["methods"].items()}
    counts = ", ".join(f"{method} {count}" for method, count in without.items())
    parts.append(f"frames without a pose, of {told['runs'] * FRAMES}: {counts}")
    return "\n".join(parts)


def _panel(axes: Axes, case: Case, found: Result, dofs: list[int]) -> None:
    def worst(values: Array) -> Array:
        return np.asarray((values * IN_DEGREES)[..., dofs].max(axis=-1))

    for method, colour in COLOURS.items():
        axes.plot(RANGES_M, worst(found.percentile_95(method)), color=colour, lw=2, label=method)
    axes.plot(RANGES_M, SIGMA_95 * worst(found.bound), "k--", lw=1.2, label="bound of one image")
    axes.plot(
        RANGES_M, SIGMA_95 * worst(found.run_bound), "k:", lw=1.5, label="bound of all so far"
    )
    for metres, told in (
        (RANGES_M[0], case.published.start_95),
        (RANGES_M[-1], case.published.end_95),
    ):
        # fmax passes over what the paper does not give.
        value = float(np.fmax.reduce(np.array(told)[dofs]))
        axes.plot(metres, value, "D", color=PUBLISHED, ms=9, mec="k", clip_on=False, zorder=5)
    aim = float(np.max((np.array(case.published.end_95) / AIM)[dofs]))
    axes.plot(RANGES_M[-1], aim, "D", mfc="w", mec=PUBLISHED, mew=2, ms=8, clip_on=False, zorder=6)
    axes.plot([], [], "D", color=PUBLISHED, ms=9, mec="k", label="published")
    axes.plot([], [], "D", mfc="w", mec=PUBLISHED, mew=2, ms=8, label="the aim")
    axes.set(yscale="log", xlim=(RANGES_M[0], RANGES_M[-1]))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.grid(alpha=0.4, which="both", lw=0.4)


def draw_approach(results: dict[str, Result], about: str, path: Path) -> None:
    """Draw 95 % errors against range, a column a case.

    Parameters
    ----------
    results
        Of at least one case, by its name.
    about
        For the title.
    path
        PNG file, written whole or not at all.
    """
    figure = Figure(figsize=(4.6 * len(results), 10.5), layout="constrained")
    grid = figure.subplots(3, len(results), sharex=True, sharey="row", squeeze=False)
    for column, (name, found) in enumerate(results.items()):
        for axes, (title, dofs) in zip(grid[:, column], ROWS.items(), strict=True):
            _panel(axes, CASES[name], found, dofs)
            if column == 0:
                axes.set_ylabel(title, fontsize=12)
        grid[0, column].set_title(f"{name}, K {CASES[name].k_per_m:g} /m", fontsize=12)
        grid[-1, column].set_xlabel("behind the lamp (m)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=11)
    figure.suptitle(f"95 % of errors during an approach; {about}", fontsize=14)
    save(figure, path)


def choice_rows(scene: Scene) -> dict[str, tuple[Scene, Choices]]:
    """Return what `--choices` compares, by name."""
    wide = dataclasses.replace(
        scene, lamp=dataclasses.replace(scene.lamp, beam_sigma_deg=WIDE_BEAM_DEG)
    )
    return {
        "as by default": (scene, Choices()),
        "noise gaussian": (scene, Choices("gaussian")),
        "noise averaged": (scene, Choices("averaged")),
        "offsets half": (scene, Choices(offset_share=0.5)),
        f"beam {WIDE_BEAM_DEG:g} deg": (wide, Choices()),
    }


def compare(options: argparse.Namespace, scene: Scene) -> list[dict[str, Any]]:
    """Run every choice in every case; an interrupt ends it with the rows it has."""
    rows: list[dict[str, Any]] = []
    plans = choice_rows(scene)
    with tqdm(total=options.runs * len(plans) * len(CASES), unit="run") as bar:
        for choice, (tank, choices) in plans.items():
            for name, case in CASES.items():
                rng = np.random.default_rng(options.seed)
                try:
                    found = simulate(tank, case, choices, options.runs, rng, bar.update)
                except KeyboardInterrupt:
                    return rows
                rows.append({"choice": choice, "case": name, **as_object(case, found)})
                if found.runs < options.runs:
                    return rows
    return rows


def comparison(rows: list[dict[str, Any]]) -> str:
    """Return the rows of `compare` as a table of the 95 % errors at the end."""
    line = "{:<15}{:<17}{:<15}"
    heads = "".join(f"{head:>8}" for head in DOF_NAMES)
    lines = [line.format("case", "choice", "method") + heads]
    for name in CASES:
        mine = [row for row in rows if row["case"] == name]
        if not mine:
            continue
        lines.append(line.format(name, "", "published") + _numbers(mine[0]["published"]["end_95"]))
        for row in mine:
            for method, values in row["methods"].items():
                start = line.format("", row["choice"] if method == METHODS[0] else "", method)
                lines.append(start + _numbers(values["end_95"]))
    return "\n".join(lines)


def run(options: argparse.Namespace) -> int:
    """Run the cases, print them and draw them."""
    for name, quantity in NUMBERS.items():
        check(Annotated[int, quantity], getattr(options, name), f"--{name}")
    scene = load_scene(options.scene)
    told: dict[str, Any] = {"scene": scene.name, "seed": options.seed, "asked_runs": options.runs}
    if options.choices:
        rows = compare(options, scene)
        if not rows:
            print("interrupted: nothing measured")
            return INTERRUPTED
        print(json.dumps({**told, "rows": rows}) if options.json else comparison(rows))
        return 0
    choices = Choices(options.noise, OFFSETS[options.offsets])
    results: dict[str, Result] = {}
    with tqdm(total=options.runs * len(CASES), unit="run") as bar:
        for name, case in CASES.items():
            rng = np.random.default_rng(options.seed)
            try:
                results[name] = simulate(scene, case, choices, options.runs, rng, bar.update)
            except KeyboardInterrupt:
                break
            if results[name].runs < options.runs:
                break
    if not results:
        print("interrupted: nothing measured")
        return INTERRUPTED
    cases = {name: as_object(CASES[name], found) for name, found in results.items()}
    told |= {"noise": options.noise, "offsets": options.offsets, "cases": cases}
    about = f"noise {options.noise}, offsets {options.offsets}, seed {options.seed}"
    output = files.user_path(options.output)
    draw_approach(results, about, output)
    if options.json:
        print(json.dumps({**told, "picture": str(output)}))
    else:
        print(f"scene {scene.name}; {about}\n")
        print("\n\n".join(report(name, case) for name, case in cases.items()))
        print(f"picture: {output}")
    return 0
