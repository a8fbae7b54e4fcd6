"""``uuv_array study approach``: the published Monte Carlo of approaches to a lamp, beside ours."""

import argparse
from typing import Any, get_args

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.eren2017.approach import CASES, FRAMES, Choices, Noise
from uuv_optical_array.studies.eren2017.monte_carlo import (
    METHODS,
    all_cases,
    alternatives,
    as_object,
)

DESCRIPTION = """\
Repeat the Monte Carlo of Eren et al. (Sensors 2017): a follower closes from 8.5 m to 4.5 m behind a
lamp at 0.5 m/s and sees 41 images, in a dive and in a zigzag, in tank water and in murkier water.
In every run temperature and attenuation are off by constants that nobody knows. Its errors as
published stand beside those of its method built again (moments), of single images
(least_squares), of these tracked (tracker), and of a smoother that takes lamp and water for
constant (docking). docs/results/approach.md explains every choice."""

EPILOG = """\
examples:
  uuv_array study approach                       100 runs a case: about a minute
  uuv_array study approach --runs 2000           as many as the paper: about 20 minutes
  uuv_array study approach --noise gaussian      1 % as a standard deviation
  uuv_array study approach --choices --runs 60   what each choice changes, at the end of a run
Ctrl-C ends it early and reports the runs it has."""

NUMBERS = {
    "runs": options.Number(Quantity("runs of each case", "", 1, 1e6), 100),
    "seed": options.Number(options.SEED, 1),
}
OFFSETS = {"whole": 1.0, "half": 0.5}


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "approach",
        run,
        "repeat the published Monte Carlo of approaches, with the published and our estimators",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "eren2017_tank")
    options.add_numbers(parser, NUMBERS)
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
    options.add_json(parser)
    outputs.add_picture(parser, "approach.png")


def _numbers(values: dict[str, float | None]) -> str:
    shown = ("-" if value is None else f"{value:.3f}" for value in values.values())
    return "".join(f"{text:>8}" for text in shown)


def report(name: str, told: dict[str, Any]) -> str:
    """Return a case in words."""
    heads = "".join(f"{head:>8}" for head in DOF_NAMES)
    units = "".join(f"{unit:>8}" for unit in DOF_UNITS)
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
    parts.append(f"  {'the aim':<30}{_numbers(told['aim_end_95'])}")
    parts.append(f"  {'bound of one image':<30}{_numbers(told['bound_end_95'])}")
    parts.append(f"  {'bound of all, with the motion':<30}{_numbers(told['run_bound_end_95'])}")
    parts.append(f"{'least_squares, RMS over bound at':<32}{heads}")
    for metres, ratio in told["methods"]["least_squares"]["ratio_to_bound"].items():
        parts.append(f"  {metres:<30}{_numbers(ratio)}")
    without = {key: values["without_pose"] for key, values in told["methods"].items()}
    counts = ", ".join(f"{method} {count}" for method, count in without.items())
    parts.append(f"frames without a pose, of {told['runs'] * FRAMES}: {counts}")
    return "\n".join(parts)


def compare(scene: Scene, runs: int, seed: int) -> list[dict[str, Any]]:
    """Run every choice in every case; an interrupt ends it with the rows it has."""
    rows: list[dict[str, Any]] = []
    plans = alternatives(scene)
    with progress.counter(total=runs * len(plans) * len(CASES), unit="run") as bar:
        for choice, (tank, choices) in plans.items():
            found = dict(all_cases(tank, choices, runs, seed, bar.update))
            rows += [
                {"choice": choice, "case": name, **as_object(CASES[name], errors)}
                for name, errors in found.items()
            ]
            if len(found) < len(CASES) or rows[-1]["runs"] < runs:
                break
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


def run(args: argparse.Namespace) -> int:
    """Run the cases, print them and draw them."""
    runs, seed = options.numbers_of(args, NUMBERS)
    scene = options.scene_of(args)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    told: dict[str, Any] = {"scene": scene.name, "seed": seed, "asked_runs": runs}
    if args.choices:
        rows = compare(scene, runs, seed)
        if not rows:
            print("interrupted: nothing measured")
            return options.INTERRUPTED
        print(json_text({**told, "rows": rows}) if args.json else comparison(rows))
        return 0
    choices = Choices(args.noise, OFFSETS[args.offsets])
    with progress.counter(total=runs * len(CASES), unit="run") as bar:
        found = dict(all_cases(scene, choices, runs, seed, bar.update))
    if not found:
        print("interrupted: nothing measured")
        return options.INTERRUPTED
    cases = {name: as_object(CASES[name], errors) for name, errors in found.items()}
    about = f"noise {args.noise}, offsets {args.offsets}, seed {seed}"
    from uuv_optical_array.plots.studies.eren2017 import draw_approach

    draw_approach(found, about, output)
    if args.json:
        told |= {"noise": args.noise, "offsets": args.offsets, "cases": cases}
        print(json_text({**told, "picture": str(output)}))
    else:
        print(f"scene {scene.name}; {about}\n")
        print("\n\n".join(report(name, case) for name, case in cases.items()))
        print(f"picture: {output}")
    return 0
