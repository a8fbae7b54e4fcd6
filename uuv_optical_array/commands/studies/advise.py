"""``uuv_array advise``: the cheapest setting that meets a rate and an accuracy here."""

import argparse
import dataclasses
import sys
from pathlib import Path

from uuv_optical_array.cli import options
from uuv_optical_array.commands.studies.tradeoff import measure_rest
from uuv_optical_array.core.geometry import YAW, X
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage import files
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import SPECIFICATION
from uuv_optical_array.studies.results import read
from uuv_optical_array.studies.tradeoff.advice import (
    Advice,
    Need,
    advise,
    cache_folder,
    settings_of,
)
from uuv_optical_array.studies.tradeoff.results import SETTINGS_CSV, Measurement, Origin
from uuv_optical_array.studies.tradeoff.run import TradeoffRun

DESCRIPTION = """\
Name the cheapest setting that keeps a rate and an accuracy: array, size of the table, and method of
the estimator. Cheapest is fewest detectors, then the smallest table, then the least time. A rate is
kept if the 99th percentile of a frame's time fits its period, an accuracy if the RMS errors of
random poses 4 to 8 m behind the lamp do, and 99 % of frames must get a pose.

It reads what `uuv_array study tradeoff` measured in this scene on this machine, in SCENE.tradeoff
here or in the folder that --output names. Where that is not there it measures as the quick mode
does, and keeps it in the user's cache. Exit code 1 says that no setting does."""

EPILOG = """\
examples:
  uuv_array advise --rate 10                                the paper's 0.2 m and 10 deg
  uuv_array advise --rate 100 --position 0.1 --angle 2      faster and better
  uuv_array advise --rate 5 --scene sea.yaml --json         your own scene, as one JSON object
Ctrl-C while it measures keeps what there is; the next call goes on."""

# The fields of `Need`.
NEEDS = {
    "rate": options.Number(Quantity("frames a second", "Hz", 0.001, 1e6), 10.0),
    "position": options.Number(
        Quantity("largest RMS distance from the truth", "m", 1e-6, 1e3), float(SPECIFICATION[X])
    ),
    "angle": options.Number(
        Quantity("largest RMS of pitch and yaw together", "deg", 1e-6, 360),
        float(SPECIFICATION[YAW]),
    ),
}
SEED = 1
UNITS = {
    "position_m": ("position", "m"),
    "angle_deg": ("angle", "deg"),
    "p99_ms": ("99th percentile", "ms"),
    "without_pose": ("frames without a pose", "of all"),
}


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "advise",
        run,
        "name the cheapest setting that keeps a rate and an accuracy",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "reference")
    options.add_numbers(parser, NEEDS)
    options.add_json(parser)
    parser.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="folder written by uuv_array study tradeoff (default: SCENE.tradeoff, else the cache)",
    )


def report(scene: Scene, need: Need, found: Advice) -> str:
    """Return the advice in words."""
    row = found.row
    asked = f"{need.rate_hz:g} Hz, {need.position_m:g} m, {need.angle_deg:g} deg"
    if found.lacks:
        parts = [f"no setting keeps {asked}; the nearest: {row.label}"]
        for name, by in found.lacks.items():
            what, unit = UNITS[name]
            limit = need.limits[name]
            parts.append(
                f"  {what} is {getattr(row, name):.3g} {unit}, "
                f"{by:.2g} more than {limit:.3g} ({by / limit:+.0%})"
            )
    else:
        parts = [f"{asked}: {row.label}"]
    scene_lines = []
    for group, values in settings_of(scene, row)["scene"].items():
        scene_lines += [f"  {group}:", *(f"    {key}: {value}" for key, value in values.items())]
    parts += [
        "",
        f"errors: {row.position_m:.3g} m, {row.angle_deg:.3g} deg RMS; "
        f"{row.without_pose:.1%} of frames without a pose",
        f"time: {row.median_ms:.3g} ms, 99th percentile {row.p99_ms:.3g} ms "
        f"of {1e3 / need.rate_hz:.4g} ms; {row.models:.3g} forward models; without ROS",
        "",
        f"in the scene ({scene.name}):",
        *scene_lines,
        "parameter of the estimator_node:",
        f"  method: {row.method}",
    ]
    return "\n".join(parts)


def run(args: argparse.Namespace) -> int:
    """Find measurements or make them, and choose."""
    need = Need(*options.numbers_of(args, NEEDS))
    scene = options.scene_of(args)
    folder = files.user_path(args.output or f"{scene.name}.tradeoff")
    origin, rows = read(folder / SETTINGS_CSV, Origin, Measurement)
    if origin is not None and not origin.same_place(scene):
        print(
            f"{folder / SETTINGS_CSV} is of another scene or machine, so it does not count",
            file=sys.stderr,
        )
        origin = None
    complete = True
    if origin is None:
        folder = cache_folder(scene)
        measured = TradeoffRun(scene, "quick", SEED, folder)
        try:
            measure_rest(measured)
        except KeyboardInterrupt:
            complete = False
        origin, rows = measured.origin, measured.settings.lines
    if not rows:
        print("interrupted: nothing measured")
        return options.INTERRUPTED
    found = advise(rows, need)
    about = {
        "measured": str(folder / SETTINGS_CSV),
        "settings": len(rows),
        "load_average": max(row.load_average for row in rows),
        "complete": complete,
    }
    if args.json:
        told = {
            "scene": scene.name,
            "asked": dataclasses.asdict(need),
            "met": not found.lacks,
            "lacks": found.lacks,
            "found": found.row.columns(),
            "change": settings_of(scene, found.row),
            **about,
        }
        print(json_text(told))
    else:
        print(report(scene, need, found))
        print(
            f"\nof {len(rows)} settings, {origin.frames} frames each, load average up to "
            f"{about['load_average']:.1f}: {about['measured']}"
        )
        if not complete:
            print("interrupted: some settings are not measured yet")
    if not complete:
        return options.INTERRUPTED
    return 1 if found.lacks else 0
