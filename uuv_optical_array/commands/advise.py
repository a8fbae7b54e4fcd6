"""``uuv_array advise``: name the cheapest setting for a rate and an accuracy.

Choose array, size of the table and method of the estimator: the fewest detectors, then the smallest
table, then the least time. A setting meets the rate if the 99th percentile of its time per frame is
within the period, and the accuracy if the RMS errors of random poses 4 to 8 m behind the lamp are;
99 % of the frames must get a pose.

The command reads the measurements of `uuv_array study tradeoff` in this scene on this machine, from
SCENE.tradeoff here or the folder of --output. If there are none, it makes those of the quick mode,
and keeps them in the user's cache. Exit code 1 means that no setting meets the need.

  uuv_array advise --rate 10                                the paper's 0.2 m and 10 deg
  uuv_array advise --rate 100 --position 0.1 --angle 2      faster and better
  uuv_array advise --rate 5 --scene sea.yaml --json         your own scene, as one JSON object
Ctrl-C ends the measurement, and the command chooses from what there is.
"""

import argparse
import dataclasses
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage import files
from uuv_optical_array.estimation.estimator import METHODS
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import PriorSettings
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import SPECIFIED, lit_poses
from uuv_optical_array.studies import tradeoff
from uuv_optical_array.studies.shared.errors import position_and_angle
from uuv_optical_array.studies.shared.results import read, write
from uuv_optical_array.studies.tradeoff import SETTINGS_CSV, Measurement

POSITION_M, ANGLE_DEG = SPECIFIED
BOUNDED = 200  # poses whose bound is shown
NEEDS = {
    "rate": (Quantity("rate of the frames", "Hz", 0.001, 1e6), 10.0),
    "position": (Quantity("largest RMS error of the position", "m", 1e-6, 1e3), POSITION_M),
    "angle": (Quantity("largest RMS error of pitch and yaw together", "deg", 1e-6, 360), ANGLE_DEG),
}
UNITS = {
    "position_m": ("position", "m"),
    "angle_deg": ("angle", "deg"),
    "p99_ms": ("99th percentile", "ms"),
    "without_pose": ("frames without a pose", "of all"),
}


class Need(NamedTuple):
    """The rate, which 99 of 100 frames have to meet, and the largest RMS errors."""

    rate_hz: float
    position_m: float
    angle_deg: float

    def limits(self) -> dict[str, float]:
        """Return the largest allowed value of each column of a `Measurement`."""
        values = self.position_m, self.angle_deg, 1e3 / self.rate_hz, tradeoff.MOST_WITHOUT_POSE
        return dict(zip(UNITS, values, strict=True))


def advise(rows: Sequence[Measurement], need: Need) -> tuple[Measurement, dict[str, float]]:
    """Choose the cheapest setting that meets a need, or the nearest to it, and what that exceeds.

    The nearest is the one whose worst value is the least multiple of its limit. Published methods
    are no choice, because the estimator's node does not have them.
    """
    limits = need.limits()

    def worst(row: Measurement) -> float:
        # An unknown value is infinitely far off.
        shares = [getattr(row, name) / limit for name, limit in limits.items()]
        return float(np.nan_to_num(shares, nan=math.inf).max(initial=1.0))

    choices = [row for row in rows if row.method in METHODS]
    if not choices:
        raise ValueError(f"no setting of {', '.join(METHODS)} was measured; measure again")
    row = min(choices, key=lambda row: (worst(row), row.effort))
    beyond = {name: getattr(row, name) - limit for name, limit in limits.items()}
    return row, {name: by for name, by in beyond.items() if not by <= 0}


def settings_of(scene: Scene, row: Measurement) -> dict[str, Any]:
    """Return what to change for a setting: groups of the scene, and the node's parameter."""
    settings = row.scene(scene).settings()
    changed = {group: settings[group] for group in ("array", "table")}
    return {"scene": changed, "estimator_node": {"method": row.method}}


def calibrating(scene: Scene, row: Measurement) -> str:
    """Return what knowing the scene exactly would gain a setting, or gains it already."""
    believed = row.scene(scene)
    if not believed.prior.nuisance_std():
        return (
            "lamp, water and array are taken as known exactly; where they are not, errors are "
            "larger: choose by a scene with a prior, such as --scene follow"
        )
    exact = dataclasses.replace(believed, prior=PriorSettings())
    poses = lit_poses(ForwardModel(believed), BOUNDED, np.random.default_rng(1))
    bounds = (cramer_rao_bound(ForwardModel(one), poses).std for one in (believed, exact))
    now, then = (position_and_angle(std)[0] for std in bounds)
    return (
        f"of its error {now:.2g} m is the least with the scene's prior, and {then:.2g} m if the "
        "scene were known exactly: a calibration (uuv_array calibrate) comes before more detectors"
    )


def report(scene: Scene, need: Need, row: Measurement, excess: dict[str, float]) -> str:
    """Return the advice in words."""
    needed = f"{need.rate_hz:g} Hz, {need.position_m:g} m, {need.angle_deg:g} deg"
    lines = [f"{needed}: {row.label}"]
    if excess:
        lines = [f"no setting meets {needed}; the nearest: {row.label}"]
        for name, by in excess.items():
            (what, unit), limit = UNITS[name], need.limits()[name]
            beyond = f"{by:.2g} more than {limit:.3g} ({by / limit:+.0%})"
            lines.append(f"  {what} is {getattr(row, name):.3g} {unit}, {beyond}")
    lines += [
        "",
        f"errors: {row.position_m:.3g} m, {row.angle_deg:.3g} deg RMS; "
        f"{row.without_pose:.1%} of frames without a pose",
        f"time: {row.median_ms:.3g} ms, 99th percentile {row.p99_ms:.3g} ms "
        f"of {1e3 / need.rate_hz:.4g} ms; {row.models:.3g} forward models; without ROS",
        *filter(None, [calibrating(scene, row)]),
        "",
        f"in the scene ({scene.name}):",
    ]
    for group, values in settings_of(scene, row)["scene"].items():
        lines += [f"  {group}:", *(f"    {key}: {value}" for key, value in values.items())]
    return "\n".join([*lines, "parameter of the estimator_node:", f"  method: {row.method}"])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "reference")
    for name, (quantity, default) in NEEDS.items():
        options.add_number(parser, name, quantity, default)
    options.add_json(parser)
    about = "folder of `uuv_array study tradeoff` (default: SCENE.tradeoff here, else the cache)"
    outputs.add_folder(parser, about)


def _measured(scene: Scene, folder: Path) -> tuple[Path | None, Any, list[Measurement]]:
    """Return file, frames and lines of this scene and machine; after Ctrl-C there is no file."""
    here = tradeoff.origin_of(scene, "quick")
    machine = "".join(letter if letter.isalnum() else "-" for letter in here["machine"])
    name = f"{scene.name}-{scene.fingerprint[:16]}-{machine}"
    kept = files.cache_dir() / "tradeoff" / name / SETTINGS_CSV
    for path in (folder / SETTINGS_CSV, kept):
        there, rows = read(path, Measurement)
        if there and all(there.get(name) == here[name] for name in ("fingerprint", "machine")):
            return path, there["frames"], rows
        if there:
            print(f"{path} is of another scene or machine, so it is not used", file=sys.stderr)
    rows, complete = tradeoff.measure_all(scene, "quick")
    if not complete:
        return None, here["frames"], rows
    kept.parent.mkdir(parents=True, exist_ok=True)
    write(kept, here, [vars(row) for row in rows])
    return kept, here["frames"], rows


def run(args: argparse.Namespace) -> int:
    """Read the measurements or make them, and choose."""
    need = Need(args.rate, args.position, args.angle)
    scene = options.scene_of(args)
    given = files.user_path(args.output or f"{scene.name}.tradeoff")
    if args.output and not (given / SETTINGS_CSV).is_file():
        made_by = f"uuv_array study tradeoff --scene {scene.name} --output {args.output}"
        raise options.OptionError(f"--output {args.output}: no {SETTINGS_CSV} in it; {made_by}")
    path, frames, rows = _measured(scene, given)
    row, excess = advise(rows, need)
    load, count = max(row.load_average for row in rows), len(rows)
    result = {"scene": scene.name, "asked": need._asdict(), "met": not excess, "lacks": excess}
    complete, whence = path is not None, str(path or "not kept")
    result |= {"found": vars(row), "change": settings_of(scene, row), "measured": whence}
    result |= {"settings": count, "load_average": load, "complete": complete}
    whence = f"of {count} settings, {frames} frames each, load average up to {load:.1f}: {whence}"
    text = f"{report(scene, need, row, excess)}\n\n{whence}"
    missing = "some settings are not measured yet"
    return outputs.finish(args, result, text, complete, missing) or bool(excess)
