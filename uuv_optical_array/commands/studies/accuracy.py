"""``uuv_array accuracy``: how far estimates are from the truth, beside what one image allows."""

import argparse
import json
from collections.abc import Iterable
from typing import Annotated, Any

import numpy as np

from uuv_optical_array.commands.parser import (
    INTERRUPTED,
    Subparsers,
    add_command,
    add_json,
    add_scene,
    add_shape,
    bar,
)
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array
from uuv_optical_array.core.settings import Quantity, check
from uuv_optical_array.estimation.estimator import METHODS, Estimator
from uuv_optical_array.estimation.table.signature_table import cached_table
from uuv_optical_array.forward.effects import MOVING
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import PriorSettings, Scene, load_scene
from uuv_optical_array.studies.accuracy import Accuracy, measure, with_prior
from uuv_optical_array.studies.shared.working_volume import lit_poses

DESCRIPTION = """\
Estimate random poses of a scene, 4 to 8 m behind the lamp, +-0.9 m and +-20 deg, whose image peaks
above 20 counts, and compare the errors with the Cramer-Rao bound of one image and with the
covariances that the estimates claim. --nuisances compares an estimator that takes attenuation and
lamp power for known with one that estimates them along, where they are off and where they are not.
--moving takes each image at a random moment: what flickers, fades or drifts in the scene then does,
and no estimator knows. --drawn lets what the scene's prior leaves open, such as the lamp's power,
be off by as much as the prior says. docs/accuracy.md explains every figure."""

EPILOG = """\
examples:
  uuv_array accuracy                           20,000 poses of the reference scene
  uuv_array accuracy --scene follow --json     the default scene, as one JSON object
  uuv_array accuracy --method sam              the paper's method
  uuv_array accuracy --shape planar            the same scene with a planar array
  uuv_array accuracy --nuisances               what estimating K and the lamp's power buys
  uuv_array accuracy --scene harbour --drawn   K and the lamp's power as uncertain as its prior says
  uuv_array accuracy --scene night_plume --moving   with clouds, flicker and drift
Ctrl-C ends the study early and reports the frames it has."""

NUMBERS = {
    "poses": Quantity("how many random poses", "", 1, 1e7),
    "seed": Quantity("seed of poses and noise", "", 0, 2**32 - 1),
    "candidates": Quantity("table entries from which least_squares starts", "", 1, 1000),
}
POSES, NUISANCE_POSES = 20_000, 4_000
SIGMAS = 6.0
COLUMNS = ("x_m", "y_m", "z_m", "pitch_deg", "yaw_deg")
DAY_S = 86_400.0  # from which the moments of --moving are drawn
PRIOR = PriorSettings(lamp_power_std=0.05, k_std_per_m=0.015)
# What is off by how much: the attenuation in 1/m and the lamp's power as a share.
OFF = {
    "nothing": (0.0, 0.0),
    "power +5 %": (0.0, 0.05),
    "K +0.015 /m": (0.015, 0.0),
    "K +0.015 /m, power +5 %": (0.015, 0.05),
    "K +0.015 /m, power -5 %": (0.015, -0.05),
}


def add_parser(subparsers: Subparsers) -> None:
    """Add the subcommand."""
    parser = add_command(
        subparsers,
        "accuracy",
        run,
        "measure errors of estimates beside the bound, and how honest covariances are",
        DESCRIPTION,
        EPILOG,
    )
    add_scene(parser, "reference")
    add_shape(parser)
    parser.add_argument(
        "--method", choices=METHODS, default="least_squares", help="default: %(default)s"
    )
    defaults = {"poses": f"{POSES}, with --nuisances {NUISANCE_POSES}", "seed": 1, "candidates": 4}
    for name, quantity in NUMBERS.items():
        default = defaults[name]
        parser.add_argument(
            f"--{name}",
            type=int,
            default=default if isinstance(default, int) else None,
            metavar="N",
            help=f"{quantity.text} (default: {default})",
        )
    parser.add_argument(
        "--nuisances", action="store_true", help="compare, with K and lamp power known or estimated"
    )
    parser.add_argument(
        "--drawn",
        action="store_true",
        help="draw what the scene's prior leaves open for each image, in place of its mean",
    )
    parser.add_argument(
        "--moving", action="store_true", help="images of random moments, for what moves in a scene"
    )
    add_json(parser)


def by_dof(values: Array, names: Iterable[str] = DOF_NAMES) -> dict[str, float]:
    """Name the values of the five degrees of freedom."""
    return dict(zip(names, values.tolist(), strict=True))


def figures(found: Accuracy) -> dict[str, Any]:
    """Return the honesty of a study's covariances, as plain values."""
    return {
        "beyond_6_sigma": found.beyond_sigma(SIGMAS),
        "nees_mean": float(found.nees.mean()),
        "nees_band": list(found.nees_band),
        "without_pose": int((~found.posed).sum()),
    }


def as_object(found: Accuracy) -> dict[str, Any]:
    """Return a study as plain values, times in ms."""
    return {
        "poses": len(found.errors),
        "ratio_to_bound": by_dof(found.ratio_to_bound),
        **figures(found),
        "beyond_6_bounds": found.beyond_bound(SIGMAS),
        "frame_ms": {
            "median": 1e3 * float(np.median(found.frame_s)),
            "99th_percentile": 1e3 * float(np.percentile(found.frame_s, 99)),
        },
        "model_ms": 1e3 * float(np.median(found.model_s)),
    }


def report(found: Accuracy) -> str:
    """Return a study in words."""
    error, bound = found.rms_error * IN_DEGREES, found.rms_bound * IN_DEGREES
    rows = zip(DOF_NAMES, error, bound, DOF_UNITS, found.ratio_to_bound, strict=True)
    table = "\n".join("{:<8}{:>9.4f}{:>12.4f} {:<4}{:>7.3f}".format(*row) for row in rows)
    nees, (low, high), of = found.nees, found.nees_band, f"of {len(found.errors)}"
    spread = nees.std() / np.sqrt(len(nees))
    median_ms, slow_ms = 1e3 * np.percentile(found.frame_s, [50, 99])
    model_ms = 1e3 * np.median(found.model_s)
    return f"""\
{"":<8}RMS error   RMS bound       ratio
{table}

without a pose: {(~found.posed).sum()} {of}
off by more than 6 of its own standard deviations: {found.beyond_sigma(SIGMAS)} {of}
off by more than 6 of the bound at the truth: {found.beyond_bound(SIGMAS)} {of}
  (no yardstick for one frame near the beam's axis: the beam is flat there, so the local bound
  on the range all but vanishes, while the angle off the axis stays uncertain)
mean NEES: {nees.mean():.3f} +- {spread:.3f}, 95 % band of chi-square(5) {low:.3f} to {high:.3f}
one frame: median {median_ms:.2f} ms, 99th percentile {slow_ms:.2f} ms; the median is
  {median_ms / model_ms:.1f} times a forward model with Jacobian for 4 poses, {model_ms:.2f} ms"""


def compare(options: argparse.Namespace, scene: Scene) -> list[dict[str, Any]]:
    """Study every case of `OFF`, with K and lamp power known and estimated along.

    An interrupt ends it with the rows it has, the last one perhaps of fewer frames.
    """
    if options.method != "least_squares":
        raise ValueError(f"--nuisances: {options.method} estimates none; use least_squares")
    table = cached_table(scene)
    estimators = {
        name: Estimator(with_prior(table, prior), "least_squares", candidates=options.candidates)
        for name, prior in (("known", PriorSettings()), ("estimated", PRIOR))
    }
    sea = ForwardModel(scene)
    poses = lit_poses(sea, options.poses, np.random.default_rng(options.seed))
    rows: list[dict[str, Any]] = []
    for off, (k_off_per_m, power_off) in OFF.items():
        off_by = {"lamp.power": np.array(np.log1p(power_off))}
        if k_off_per_m:
            off_by["attenuation.k_per_m"] = np.array(k_off_per_m)
        # The same noise for every row.
        images = sea.expose(poses, np.random.default_rng((options.seed, 1)), 0.0, off_by)
        for nuisances, estimator in estimators.items():
            try:
                found = measure(estimator, poses, images, bar)
            except KeyboardInterrupt:
                if not rows:
                    raise
                return rows
            rows.append(
                {
                    "off": off,
                    "nuisances": nuisances,
                    "poses": len(found.errors),
                    "rms_error": by_dof(found.rms_error * IN_DEGREES, COLUMNS),
                    "rms_bound": by_dof(found.rms_bound * IN_DEGREES, COLUMNS),
                    **figures(found),
                }
            )
            if len(found.errors) < len(poses):
                return rows
    return rows


def comparison(rows: list[dict[str, Any]]) -> str:
    """Return the rows of `compare` as a table."""
    line = "{:<25}{:<11}" + 5 * "{:>8}" + "{:>9}{:>8}{:>9}"
    heads = ("off", "nuisances", *DOF_NAMES, "NEES", "beyond", "no pose")
    lines = [line.format(*heads), line.format("", "", *DOF_UNITS, "", "6 sigma", "").rstrip()]
    for row in rows:
        start = (row["off"], row["nuisances"])
        errors, bounds = (
            [f"{value:.4f}" for value in row[key].values()] for key in ("rms_error", "rms_bound")
        )
        if row["off"] == "nothing":
            lines.append(line.format("nothing: the bound", start[1], *bounds, "", "", "").rstrip())
        nees, beyond, without = row["nees_mean"], row["beyond_6_sigma"], row["without_pose"]
        lines.append(line.format(*start, *errors, f"{nees:.2f}", beyond, without))
    return "\n".join(lines)


def check_truth(options: argparse.Namespace, scene: Scene) -> None:
    """Refuse what the scene cannot do with the truth, in one line."""
    if options.nuisances and (options.moving or options.drawn):
        option = "--moving" if options.moving else "--drawn"
        raise ValueError(f"--nuisances: takes no {option}; leave one of them out")
    if options.moving and not MOVING & set(scene.effects):
        names = ", ".join(sorted(MOVING))
        raise ValueError(f"--moving: nothing moves in scene {scene.name}; name one of {names}")
    if options.drawn and not scene.prior.nuisance_std():
        raise ValueError(f"--drawn: scene {scene.name} has no prior to draw from; give it one")


def exposed(
    options: argparse.Namespace, sea: ForwardModel, poses: Array, rng: np.random.Generator
) -> Array:
    """Return what the array reads at `poses`; poses and noise are the same for every option."""
    apart = np.random.default_rng((options.seed, 1))
    moments = apart.uniform(0, DAY_S, len(poses)) if options.moving else None
    stds = sea.scene.prior.nuisance_std() if options.drawn else {}
    offsets = {name: std * apart.standard_normal(len(poses)) for name, std in stds.items()}
    return sea.expose(poses, rng, 0.0, offsets, moments)


def run(options: argparse.Namespace) -> int:
    """Run the study and print it."""
    if options.poses is None:
        options.poses = NUISANCE_POSES if options.nuisances else POSES
    for name, quantity in NUMBERS.items():
        check(Annotated[int, quantity], getattr(options, name), f"--{name}")
    scene = load_scene(options.scene)
    scene = scene.with_shape(options.shape or scene.array.shape)
    check_truth(options, scene)
    told = {
        "scene": scene.name,
        "shape": scene.array.shape,
        "method": options.method,
        "seed": options.seed,
        "drawn": options.drawn,
        "moving": options.moving,
    }
    try:
        if options.nuisances:
            rows = compare(options, scene)
            answer, text = {"poses": options.poses, "nuisances": rows}, comparison(rows)
        else:
            estimator = Estimator(
                cached_table(scene), options.method, candidates=options.candidates
            )
            rng, sea = np.random.default_rng(options.seed), ForwardModel(scene)
            poses = lit_poses(sea, options.poses, rng)
            found = measure(estimator, poses, exposed(options, sea, poses, rng), bar)
            answer, text = as_object(found), report(found)
    except KeyboardInterrupt:
        print("interrupted: nothing measured")
        return INTERRUPTED
    about = (
        f"{options.method} in scene {scene.name}, {scene.array.shape} array, "
        f"{answer['poses']} random poses, "
        f"seed {options.seed}"
    )
    about += ", nuisances drawn" if options.drawn else ""
    about += ", at random moments" if options.moving else ""
    print(json.dumps({**told, **answer}) if options.json else f"{about}\n\n{text}")
    return 0
