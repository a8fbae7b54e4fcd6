"""``uuv_array calibrate``: lamp, water, background and gains from a recorded bag."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.calibration.calibrate import Calibration, FittedParameter, calibrate
from uuv_optical_array.calibration.parameters import NAMES
from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.cli.bag import add_bag, read_bag
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage import files
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.forward.scene import save_scene
from uuv_optical_array.forward.scene_files import own_text
from uuv_optical_array.recording.images import Recording

DESCRIPTION = """\
Fit the lamp (power, width of the beam), the water (K), the background and each detector's gain to a
recorded bag whose poses are known by both odometries, and write the scene that they make. Each is
printed with its standard error; what the bag does not tell is named, with what to drive for it, and
stays as it was. Power and mean gain are one product: the geometric mean of the gains is 1.
Where the residuals say that the model is wrong, no scene is written and the exit code is 1."""

EPILOG = """\
examples:
  ros2 bag record -o sea /array/image /leader/odometry /follower/odometry
  uuv_array calibrate sea --scene follow -o sea.yaml --picture residuals.png
  uuv_array calibrate sea --remap array/image:=/bow/array/image --beacon-position -0.7 0 0.2
  uuv_array calibrate sea --position-std 0.02 --attitude-std-deg 0.5     odometry has errors
  uuv_array calibrate sea --noise                                       fit the noise too
Needs the extra `bags` (pip install 'uuv_optical_array[bags]'), but no ROS."""

NUMBERS = {
    "position-std": options.Number(
        Quantity("standard deviation of each position, x, y and z; 0: exact", "m", 0, 10), 0.0
    ),
    "attitude-std-deg": options.Number(
        Quantity("standard deviation of each pitch and yaw; 0: exact", "deg", 0, 90), 0.0
    ),
}
LEAST = 1e-6  # m and rad: exact, where only the other has an error
SHOWN_IMAGES = 5


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "calibrate",
        run,
        "fit lamp, water, background and gains to a recorded bag",
        DESCRIPTION,
        EPILOG,
    )
    add_bag(parser)
    options.add_scene(parser, "follow")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("calibrated.yaml"),
        help="scene to write (default: %(default)s)",
    )
    outputs.add_picture(parser, None, "--picture", "draw the residuals")
    options.add_json(parser)
    options.add_numbers(parser, NUMBERS)
    parser.add_argument(
        "--hold",
        action="append",
        default=[],
        choices=(*NAMES, "gains"),
        help="what is known and stays as the scene has it; may be given again",
    )
    parser.add_argument(
        "--force", action="store_true", help="write the scene even where the model is wrong"
    )
    parser.add_argument(
        "--noise", action="store_true", help="fit sensor_noise.sigma_counts to the residuals too"
    )


def _digits(std: float) -> int:
    """Return the decimals that show two digits of a standard error."""
    return int(np.clip(1 - np.floor(np.log10(std)), 0, 9)) if 0 < std < np.inf else 4


def _row(parameter: FittedParameter) -> str:
    digits = _digits(parameter.std)
    error = "-" if np.isnan(parameter.std) else f"{parameter.std:.{digits}f}"
    line = (
        f"{parameter.name:<27}{parameter.start:>12.6g}{parameter.value:>14.{digits}f}{error:>12}  "
        f"{parameter.unit:<11}{parameter.note}"
    )
    return line.rstrip()


def _gains(found: Calibration) -> list[str]:
    """Return the gains as a grid, or, of a large array, their spread."""
    known = found.gain_std[np.isfinite(found.gain_std)]
    if not known.size:
        return ["gains: as they were"]
    digits = _digits(float(known.min()))
    errors = f"std errors {known.min():.{digits}f} to {known.max():.{digits}f}"
    head = f"gains, geometric mean 1, rows from the top, columns from port ({errors}):"
    if len(found.gains) > 9:
        spread = f"{found.gains.min():.{digits}f} to {found.gains.max():.{digits}f}"
        return [head, f"  {found.gains.size} from {spread}, spread {found.gains.std():.{digits}f}"]
    rows = []
    for row, errors_of_row in zip(found.gains, found.gain_std, strict=True):
        cells = [
            f"{gain:>{digits + 5}.{digits}f}" if np.isfinite(error) else "-".rjust(digits + 5)
            for gain, error in zip(row, errors_of_row, strict=True)
        ]
        rows.append("".join(cells))
    return [head, *rows]


def _seconds(recording: Recording) -> Array:
    return recording.stamps_ns.astype(float) * 1e-9


def report(found: Calibration, recording: Recording, bag: Path, start: str) -> str:
    """Return what was found in words."""
    seconds, poses = _seconds(recording), recording.poses
    ranges = np.linalg.norm(poses[:, :3], axis=1)
    off = np.degrees(np.arctan2(np.linalg.norm(poses[:, 1:3], axis=1), -poses[:, 0]))
    lines = [
        f"bag {bag}: {len(seconds)} images in {np.ptp(seconds):.1f} s, base_link "
        f"{ranges.min():.2f} to {ranges.max():.2f} m from the lamp, up to {off.max():.1f} deg off "
        "its axis",
        *(f"  left out: {count} x {reason}" for reason, count in recording.refused.most_common()),
        "",
        f"{'parameter':<27}{'start: ' + start:>12}{'fitted':>14}{'std error':>12}  unit",
        *map(_row, found.parameters),
        "",
        *_gains(found),
        "",
    ]
    pairs = [
        (abs(found.correlation[i, j]), f"{NAMES[i]} with {NAMES[j]} {found.correlation[i, j]:+.2f}")
        for i in range(len(NAMES))
        for j in range(i)
        if np.isfinite(found.correlation[i, j])
    ]
    if pairs:
        lines.append(f"strongest correlation: {max(pairs)[1]}")
    lines.append(
        f"mean squared residual {found.misfit:.3f} of {int(found.uncensored.sum())} readings "
        "(1: the model explains them)"
    )
    if found.outliers or found.outlying_images:
        where = [f"{seconds[i]:.3f} s" for i in found.outlying_images[:SHOWN_IMAGES]]
        more = ", ..." if len(found.outlying_images) > SHOWN_IMAGES else ""
        at = f" (at {', '.join(where)}{more})" if where else ""
        lines.append(
            f"outliers left out: {found.outliers} single readings, "
            f"{len(found.outlying_images)} whole images{at}"
        )
    return "\n".join([*lines, *(f"note: {note}" for note in found.notes)])


def as_json(found: Calibration, recording: Recording) -> dict[str, Any]:
    """Return what was found; what is not known is nan."""
    return {
        "images": len(recording.images),
        "left_out": dict(recording.refused),
        "parameters": {
            p.name: {
                "unit": p.unit,
                "start": p.start,
                "fitted": p.value,
                "std_error": p.std,
                "note": p.note,
            }
            for p in found.parameters
        },
        "gains": found.gains,
        "gain_std_errors": found.gain_std,
        "correlation": found.correlation,
        "mean_squared_residual": found.misfit,
        "outlying_readings": found.outliers,
        "outlying_images_s": [float(_seconds(recording)[i]) for i in found.outlying_images],
        "notes": list(found.notes),
        "refusal": found.refusal,
        "scene": found.scene.settings(),
    }


def run(args: argparse.Namespace) -> int:
    """Read the bag, fit, print and write."""
    position, attitude = options.numbers_of(args, NUMBERS)
    pose_std = None
    if position or attitude:
        pose_std = np.maximum([*[position] * 3, *[np.radians(attitude)] * 2], LEAST)
    scene, bag = options.scene_of(args), files.user_path(args.bag)
    if args.noise and "sensor_noise" not in scene.effects:
        raise options.OptionError(f"--noise: no effects.sensor_noise in {scene.name}; add it")
    like = own_text(args.scene)
    output = outputs.file_to_write(args.output, "--output", outputs.SCENE)
    picture = args.picture
    if picture is not None:
        picture = outputs.file_to_write(picture, "--picture", outputs.PICTURE)
    try:
        recording = read_bag(args, scene)
        with progress.counter(unit="step") as steps:
            found = calibrate(
                scene,
                recording.images,
                recording.poses,
                recording.rolls,
                args.hold,
                pose_std,
                args.noise,
                steps.update,
            )
    except KeyboardInterrupt:
        print("interrupted: nothing was written")
        return options.INTERRUPTED
    written = args.force or not found.refusal
    if written:
        comment = f"Calibrated by uuv_array calibrate from {bag.name}, starting from {scene.name}."
        save_scene(found.scene, output, comment, like)
    if args.json:
        print(json_text(as_json(found, recording)))
    else:
        print(report(found, recording, bag, scene.name))
        if written:
            print(f"scene: {output}")
    if picture is not None:
        from uuv_optical_array.plots.calibration import draw_calibration

        draw_calibration(
            found,
            recording.poses,
            recording.rolls,
            _seconds(recording),
            picture,
            f"Calibration from {bag.name}: residuals of {int(found.uncensored.sum())} readings",
        )
        if not args.json:
            print(f"picture: {picture}")
    if not written:
        raise ValueError(f"{bag}: no scene written: {found.refusal}; --force writes it")
    return 0
