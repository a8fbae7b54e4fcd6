"""``uuv_array study accuracy``: errors of estimates beside what one image allows."""

import argparse
from typing import Any

import numpy as np

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS
from uuv_optical_array.core.settings import Quantity, declared
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.estimation.estimator import Estimator, EstimatorSettings
from uuv_optical_array.forward.effects import MOVING
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.studies.accuracy import as_object, compare_known, exposed, measure

DESCRIPTION = """\
Estimate random poses of a scene, 4 to 8 m behind the lamp, +-0.9 m and +-20 deg, whose image peaks
above 20 counts, and compare the errors with the Cramer-Rao bound of one image and with the
covariances that the estimates claim. --known measures what it costs to know less of the sea: seas
are drawn from each of the priors exactly, calibrated and as_bought; a picture shows the errors.
--moving takes each image at a random moment: what flickers, fades or drifts in the scene then does,
and no estimator knows. --drawn lets what the scene's prior leaves open, such as the lamp's power,
be off by as much as the prior says. docs/results/accuracy.md explains every figure."""

EPILOG = """\
examples:
  uuv_array study accuracy                           20,000 poses of the reference scene
  uuv_array study accuracy --scene follow --json     the default scene, as one JSON object
  uuv_array study accuracy --method sam              the paper's method
  uuv_array study accuracy --shape planar            the same scene with a planar array
  uuv_array study accuracy --scene follow --known    what it costs to know less of the sea
  uuv_array study accuracy --scene harbour --drawn   K and power as uncertain as in its prior
  uuv_array study accuracy --scene night_plume --moving   with clouds, flicker and drift
Ctrl-C ends the study early and reports the frames it has."""

CANDIDATES = declared(EstimatorSettings)["candidates"]
NUMBERS = {
    "poses": options.Number(
        Quantity("how many random poses; 4000 with --known", "", 1, 1e7), 20_000
    ),
    "seed": options.Number(options.SEED, 1),
    "candidates": options.Number(CANDIDATES.quantity, CANDIDATES.default),
}
KNOWN_POSES = 4_000


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "accuracy",
        run,
        "measure errors of estimates beside the bound, and how honest covariances are",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "reference")
    options.add_shape(parser)
    options.add_method(parser)
    options.add_numbers(parser, NUMBERS)
    parser.set_defaults(poses=None)
    parser.add_argument(
        "--known", action="store_true", help="compare the priors of a sea known well and less well"
    )
    outputs.add_picture(parser, "known.png", about="picture, with --known")
    parser.add_argument(
        "--drawn",
        action="store_true",
        help="draw what the scene's prior leaves open for each image, in place of its mean",
    )
    parser.add_argument(
        "--moving", action="store_true", help="images of random moments, for what moves in a scene"
    )
    options.add_json(parser)


def _fixed(value: float | None) -> str:
    return "inf" if value is None else f"{value:.4f}"


def report(told: dict[str, Any]) -> str:
    """Return what `as_object` told in words."""
    rows = zip(
        DOF_NAMES,
        told["rms_error"].values(),
        told["rms_bound"].values(),
        DOF_UNITS,
        told["ratio_to_bound"].values(),
        strict=True,
    )
    line = "{:<8}{:>9.4f}{:>12} {:<4}{:>7.3f}"
    table = "\n".join(
        line.format(name, error, _fixed(bound), unit, ratio)
        for name, error, bound, unit, ratio in rows
    )
    of, (low, high) = f"of {told['poses']}", told["nees_band"]
    median_ms, slow_ms = told["frame_ms"].values()
    model_ms = told["model_ms"]
    return f"""\
{"":<8}RMS error   RMS bound       ratio
{table}

without a pose: {told["without_pose"]} {of}
off by more than 6 of its own standard deviations: {told["beyond_6_sigma"]} {of}
off by more than 6 of the bound at the truth: {told["beyond_6_bounds"]} {of}
  (no yardstick for one frame near the beam's axis: the beam is flat there, so the local bound
  on the range all but vanishes, while the angle off the axis stays uncertain)
mean NEES: {told["nees_mean"]:.3f} +- {told["nees_std_error"]:.3f}, 95 % band of chi-square(5) \
{low:.3f} to {high:.3f}
one frame: median {median_ms:.2f} ms, 99th percentile {slow_ms:.2f} ms; the median is
  {median_ms / model_ms:.1f} times a forward model with Jacobian for 4 poses, {model_ms:.2f} ms"""


def comparison(rows: list[dict[str, Any]]) -> str:
    """Return cases of `compare_known` as a table."""
    line = "{:<12}{:<7}" + 5 * "{:>8}" + "{:>9}{:>8}{:>9}"
    heads = ("known", "RMS", *DOF_NAMES, "NEES", "beyond", "no pose")
    lines = [line.format(*heads), line.format("", "", *DOF_UNITS, "", "6 sigma", "").rstrip()]
    for row in rows:
        errors, bounds = (map(_fixed, row[key].values()) for key in ("rms_error", "rms_bound"))
        nees, beyond, without = row["nees_mean"], row["beyond_6_sigma"], row["without_pose"]
        lines.append(line.format(row["known"], "error", *errors, f"{nees:.2f}", beyond, without))
        lines.append(line.format("", "bound", *bounds, "", "", "").rstrip())
    return "\n".join(lines)


def check_truth(args: argparse.Namespace, scene: Scene) -> None:
    """Refuse what the scene cannot do with the truth, in one line."""
    if args.known and args.method != "least_squares":
        raise options.OptionError(
            f"--known: {args.method} estimates no constants; use least_squares"
        )
    if args.known and (args.moving or args.drawn):
        option = "--moving" if args.moving else "--drawn"
        raise options.OptionError(f"--known: takes no {option}; leave one of them out")
    if args.moving and not MOVING & set(scene.effects):
        names = ", ".join(sorted(MOVING))
        raise options.OptionError(
            f"--moving: nothing moves in scene {scene.name}; name one of {names}"
        )
    if args.drawn and not scene.prior.nuisance_std():
        raise options.OptionError(
            f"--drawn: scene {scene.name} has no prior to draw from; give it one"
        )


def run(args: argparse.Namespace) -> int:
    """Run the study and print it."""
    if args.poses is None:
        args.poses = KNOWN_POSES if args.known else NUMBERS["poses"].default
    count, seed, candidates = options.numbers_of(args, NUMBERS)
    scene = options.scene_of(args)
    scene = scene.with_shape(args.shape or scene.array.shape)
    check_truth(args, scene)
    told = {
        "scene": scene.name,
        "shape": scene.array.shape,
        "method": args.method,
        "seed": seed,
        "drawn": args.drawn,
        "moving": args.moving,
    }
    try:
        if args.known:
            picture = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
            cases = compare_known(scene, count, seed, candidates, progress.over)
            rows = [{"known": known, **as_object(found)} for known, found in cases]
            answer = {"poses": count, "known": rows, "picture": str(picture)}
            text = f"{comparison(rows)}\n\npicture: {picture}"
            from uuv_optical_array.plots.studies.known import (
                draw_known,  # matplotlib takes a second
            )

            draw_known(rows, f"scene {scene.name}, {count} poses", picture)
        else:
            estimator = Estimator(scene, args.method, candidates=candidates).wait()
            rng, model = np.random.default_rng(seed), ForwardModel(scene)
            poses = lit_poses(model, count, rng)
            images = exposed(model, poses, seed, args.drawn, args.moving, rng)
            answer = as_object(measure(estimator, poses, images, progress.over))
            text = report(answer)
    except KeyboardInterrupt:
        print("interrupted: nothing measured")
        return options.INTERRUPTED
    about = (
        f"{args.method} in scene {scene.name}, {scene.array.shape} array, "
        f"{answer['poses']} random poses, "
        f"seed {seed}"
    )
    about += ", nuisances drawn" if args.drawn else ""
    about += ", at random moments" if args.moving else ""
    print(json_text({**told, **answer}) if args.json else f"{about}\n\n{text}")
    return 0
