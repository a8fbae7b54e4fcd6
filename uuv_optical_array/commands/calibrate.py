"""``uuv_array calibrate``: fit lamp, water, background and gains to a recorded bag.

Fit lamp (power and beam width; of several lamps the power, place and axis of each), water
(absorption and scattering, or K), array (response, radius of the sphere, gains), aim of lamp and
array, and background, which demodulation removes, to a recorded bag, and write the scene. Poses are
known from both odometries, or from tables: of places measured on a rail, or of poses by time. How
far the clock of odometries or poses is off that of the images is fitted. In place of a bag a table
of readings of any detectors will do. Each value is printed with its standard error. What is not
determined keeps its value and is named, with what to record for it. Power and mean gain are one
product, so the geometric mean of the gains is 1; that of several lamps' powers stays. The
shape of a beam of several Gaussians is fitted, too, and that of one Gaussian if
``prior.beam_shape_std`` is given. Where residuals show that model or beam are wrong, or where a
value ends at its bound, no scene is written; the exit code is 1.

  ros2 bag record -o sea /array/image /leader/odometry /follower/odometry
  uuv_array calibrate sea --scene follow -o sea.yaml --picture residuals.png
  uuv_array calibrate sea --set image_topic=/bow/array/image --set beacon_position_m=-0.7,0,0.2
  uuv_array calibrate sea --set position_std_m=0.02 --set attitude_std_deg=0.5
  uuv_array calibrate sea --noise                  fit the noise too
  uuv_array calibrate tank --places places.csv     measured places instead of odometry
  uuv_array calibrate rail.csv --detectors one.csv --known z_m=0      one detector on a rail, as a
                                                   table; its other columns are known, too
  uuv_array calibrate sea.csv --trajectory mocap.csv   readings, and poses by time
The table of places has the columns image (from 0 on) or time_s (after the first image); x_m, y_m,
z_m, pitch_deg, yaw_deg of base_link in beacon; x_std_m, y_std_m, z_std_m, pitch_std_deg,
yaw_std_deg; and perhaps last_image or until_s, whose images share a place and its error, and
roll_deg. docs/tutorials/own_light.md tells of the other tables.
Needs rosbags and mcap (pip install rosbags mcap), but no ROS.
"""

import argparse
import dataclasses
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.calibrate import Calibration, FittedParameter, calibrate
from uuv_optical_array.calibration.clock import Clock, synchronised
from uuv_optical_array.cli import bag, light, options, outputs, progress
from uuv_optical_array.core.geometry import IN_DEGREES, Array
from uuv_optical_array.core.settings import Quantity, Setting
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.scene import save_scene
from uuv_optical_array.forward.scene_files import own_text
from uuv_optical_array.layouts.detectors import on_array_of, write_detectors
from uuv_optical_array.plots.style import array_image, new_figure, save
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.places import LEAST_STD, POSE, with_places

POSITION = Quantity("standard deviation of x, y and z; 0: exact", "m", 0, 10)
ATTITUDE = Quantity("of pitch and yaw; 0: exact", "deg", 0, 90)
STDS = {
    "position_std_m": Setting(float, POSITION, 0.0, optional=False),
    "attitude_std_deg": Setting(float, ATTITUDE, 0.0, optional=False),
}
# The fit makes no use of commands.
NO_USE = "commands_topic", "states_topic"
READING = {name: how for name, how in bag.READING.items() if name not in NO_USE}
SETTINGS = READING | light.SETTINGS | STDS
SHOWN_IMAGES = 5
EDGE = 4.0  # standard deviations; residuals beyond are drawn there


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    bag.add_bag(parser, SETTINGS)
    options.add_scene(parser, "follow")
    outputs.add_scene_file(parser, "calibrated.yaml")
    outputs.add_picture(parser, None, "--picture", "draw the residuals")
    options.add_json(parser)
    about = "CSV of measured places and errors, in place of odometries and their errors"
    parser.add_argument("--places", type=Path, metavar="TABLE", help=about)
    light.add_tables(parser)
    about = "column of poses, or of their errors, that has this value throughout; may be repeated"
    known: dict[str, Any] = {"action": "append", "default": [], "type": light.known_column}
    parser.add_argument("--known", help=about, metavar="NAME=VALUE", **known)
    about = "part of the poses that the light has to tell; may be repeated"
    open_parts: dict[str, Any] = {"action": "append", "default": [], "choices": POSE}
    parser.add_argument("--unknown", help=about, metavar="NAME", **open_parts)
    about = "parameter that keeps the scene's value, by its printed name, or gains; "
    words: dict[str, Any] = {"action": "append", "default": [], "metavar": "NAME"}
    parser.add_argument("--hold", help=about + "may be repeated", **words)
    about = "fit sensor_noise.sigma_counts, too"
    parser.add_argument("--noise", action="store_true", help=about)
    about = "write the scene even if the model is wrong"
    parser.add_argument("--force", action="store_true", help=about)


def _digits(std: float) -> int:
    """Return the decimals that show two digits of a standard error."""
    return int(np.clip(1 - np.floor(np.log10(std)), 0, 9)) if 0 < std < np.inf else 4


def _row(parameter: FittedParameter) -> str:
    name, unit, start, value, std, note = dataclasses.astuple(parameter)
    digits = _digits(std)
    error = "-" if np.isnan(std) else f"{std:.{digits}f}"
    values = f"{name:<27}{start:>12.6g}{value:>14.{digits}f}{error:>12}"
    return f"{values}  {unit:<11}{note}".rstrip()


def _gains(result: Calibration, names: Sequence[str] = ()) -> list[str]:
    """Return the gains as a grid, or by the names of detectors, or, of many, their spread."""
    if len(names) == 1:
        return ["gain: part of the power"]
    known = result.gain_std[np.isfinite(result.gain_std)]
    if not known.size:
        return ["gains: as they were"]
    digits = _digits(float(known.min()))
    errors = f"std errors {known.min():.{digits}f} to {known.max():.{digits}f}"
    head = f"gains, geometric mean 1, rows from the top, columns from port ({errors}):"
    gains = result.gains
    if names:
        values = zip(names, gains.ravel(), result.gain_std.ravel(), strict=False)
        each = (f"{name} {'-' if np.isnan(s) else f'{g:.{digits}f}'}" for name, g, s in values)
        named = f"gains of detectors, geometric mean 1 ({errors}): "
        return textwrap.wrap(named + ", ".join(each), 100, subsequent_indent="  ")
    if len(gains) > 9:
        low, high, std = (f"{x:.{digits}f}" for x in (gains.min(), gains.max(), gains.std()))
        return [head, f"  {gains.size} from {low} to {high}, spread {std}"]
    shown = np.where(np.isfinite(result.gain_std), gains, np.nan)
    wide = [[f"{x:.{digits}f}".replace("nan", "-").rjust(digits + 5) for x in row] for row in shown]
    return [head, *map("".join, wide)]


def report(
    result: Calibration,
    recording: Recording,
    path: Path,
    start: str,
    at: str = "",
    names: Sequence[str] = (),
    timed: bool = True,
) -> str:
    """Return the fitted values and how well the model agrees, as text.

    `at` says at which places, if they were measured; `names` are those of detectors in a layout;
    `timed` whether the images have times.
    """
    seconds, poses = recording.seconds, recording.poses
    ranges = np.linalg.norm(poses[:, :3], axis=1)
    off = np.degrees(np.arctan2(np.linalg.norm(poses[:, 1:3], axis=1), -poses[:, 0]))
    lines = [
        f"{light.kind_of(path)} {path}: {len(seconds)} images"
        f"{f' in {np.ptp(seconds):.1f} s' * timed}{at}, "
        f"base_link {ranges.min():.2f} to {ranges.max():.2f} m from the lamp, up to "
        f"{off.max():.1f} deg off its axis",
        *(f"  {line}" for line in recording.left_out),
        "",
        f"{'parameter':<27}{'start: ' + start:>12}{'fitted':>14}{'std error':>12}  unit",
        *map(_row, result.parameters),
        "",
        *_gains(result, names),
        "",
    ]
    correlations = np.tril(np.nan_to_num(result.correlation), -1)
    i, j = np.unravel_index(np.argmax(np.abs(correlations)), correlations.shape)
    if correlations[i, j]:
        first, second = result.parameters[i].name, result.parameters[j].name
        lines.append(f"strongest correlation: {first} with {second} {correlations[i, j]:+.2f}")
    count, images = int(result.uncensored.sum()), result.outlying_images
    explained = "(1: the model explains them)"
    lines.append(f"mean squared residual {result.misfit:.3f} of {count} readings {explained}")
    if result.outliers or images:
        where = [f"{seconds[i]:.3f} s" for i in images[:SHOWN_IMAGES]]
        where += ["..."] * (len(images) > SHOWN_IMAGES)
        whole = f"{len(images)} whole images" + f" (at {', '.join(where)})" * bool(where)
        lines.append(f"outliers left out: {result.outliers} single readings, {whole}")
    return "\n".join([*lines, *(f"note: {note}" for note in result.notes)])


def as_json(
    result: Calibration, recording: Recording, clock: Clock | None = None
) -> dict[str, Any]:
    """Return the result as plain values and arrays; what is not known is nan."""
    return {
        "images": len(recording.images),
        "left_out": dict(recording.refused),
        "parameters": {
            name: {"unit": unit, "start": start, "fitted": value, "std_error": std, "note": note}
            for name, unit, start, value, std, note in map(dataclasses.astuple, result.parameters)
        },
        "residuals_off_axis": result.by_angle._asdict(),
        "gains": result.gains,
        "gain_std_errors": result.gain_std,
        "correlation": result.correlation,
        "mean_squared_residual": result.misfit,
        "outlying_readings": result.outliers,
        "outlying_images_s": recording.seconds[list(result.outlying_images)],
        "clock": clock and dataclasses.asdict(clock),
        "notes": list(result.notes),
        "refusal": result.refusal,
        "scene": result.scene.settings(),
    }


def _mean(values: Array, where: NDArray[np.bool_], axis: int) -> Array:
    """Return means of what counts; nan where nothing does."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(where, values, 0).sum(axis) / where.sum(axis))


def draw_calibration(result: Calibration, recording: Recording, title: str) -> Any:
    """Draw residuals by detector, along the drive, by range, and off the beam's axis."""
    figure = new_figure(19, 5.6)
    by_detector, *along, off_axis = figure.subplots(1, 4)
    residuals, fitted = np.clip(result.residuals, -EDGE, EDGE), result.uncensored
    left_out = ~result.used & result.used.any(axis=0)
    shape = -1, *result.gains.shape  # with detectors that never read right
    squares = _mean(residuals.reshape(shape) ** 2, (fitted | ~result.used).reshape(shape), 0)
    mesh = array_image(by_detector, np.sqrt(squares), vmin=0, vmax=EDGE / 2)
    figure.colorbar(mesh, ax=by_detector, label="RMS residual; 1 where the model explains it")
    by_detector.set(xlabel="column, to starboard", ylabel="row, downwards")
    of_images = (
        ("RMS of an image", "o", "#1f6fb4", np.sqrt(_mean(residuals**2, fitted, 1))),
        ("its mean", "o", "#c8401e", _mean(residuals, fitted, 1)),
        ("RMS of what was left out", "x", "k", np.sqrt(_mean(residuals**2, left_out, 1))),
    )
    seconds = recording.seconds - recording.seconds.min()
    ranges = np.linalg.norm(recording.poses[:, :3], axis=1)
    places = (seconds, "time in the bag (s)"), (ranges, "range from lamp to base_link (m)")
    for axes, (across, label) in zip(along, places, strict=True):
        for name, marker, colour, values in of_images:
            axes.plot(across, values, marker, color=colour, ms=3.5, label=name)
        for level in (0, 1):
            axes.axhline(level, color="k", lw=0.8)
        axes.set(xlabel=label, ylim=(-2, EDGE + 0.2))
        axes.grid(alpha=0.3)
    along[0].set_ylabel("residual (std of a reading)")
    along[0].legend(loc="upper left", fontsize=9)
    angles, relative, std, share = result.by_angle
    off_axis.errorbar(angles, 100 * relative, 100 * std, fmt="o-", color="#1f6fb4", ms=3.5)
    off_axis.axhline(0, color="k", lw=0.8)
    off_axis.grid(alpha=0.3)
    off_axis.set(
        xlabel="off the beam's axis (deg)",
        ylabel="mean residual (% of the light)",
        title=f"by this angle alone: {share:.0%} of the misfit",
    )
    figure.suptitle(title)
    return figure


def run(args: argparse.Namespace) -> int:
    """Read bag or tables, fit, print and write."""
    settings = dict(args.set)
    stds = np.repeat([settings[name] for name in STDS], [3, 2]) / IN_DEGREES
    scene = options.scene_of(args)
    if args.noise and "sensor_noise" not in scene.effects:
        raise options.OptionError(f"--noise: no effects.sensor_noise in {scene.name}; add it")
    table = args.places and files.user_path(args.places)
    if table is not None and stds.any():
        raise options.OptionError(
            f"--set {next(iter(STDS))}: the table of --places says it; leave one out"
        )
    if table is not None and (args.known or args.unknown or args.trajectory):
        raise options.OptionError(
            "--places: its table tells whole poses; leave out --known, --unknown and --trajectory"
        )
    path, text = files.user_path(args.bag), own_text(args.scene)
    output = outputs.file_to_write(args.output, "--output", outputs.SCENE)
    picture = args.picture and outputs.file_to_write(args.picture, "--picture", outputs.PICTURE)
    try:
        if table is not None:
            told = light.read_light(args, scene, poses_needed=False)
            recording, pose_std, places = with_places(told.recording, table)
            starts = recording.poses
        else:
            (told, open_parts), places = light.read_known(args, scene), None
            starts = told.recording.poses
            if open_parts:
                told, starts = light.with_starts(told, scene, open_parts)
            recording = told.recording
            pose_std = np.where(np.isnan(told.stds), np.maximum(stds, LEAST_STD), told.stds)
        light.check_bright(args, recording)
        layout = told.layout
        start = layout.scene if layout else scene
        exact = places is None and (pose_std <= LEAST_STD).all()
        stamps = recording.stamps_ns

        def fitted(moved: Recording) -> Calibration:
            here = light.filled(moved, stamps, starts)
            own = pose_std[np.searchsorted(stamps, here.stamps_ns)]
            return calibrate(
                start,
                here.images,
                here.poses,
                here.rolls,
                args.hold,
                None if exact else own,
                args.noise,
                steps.update,
                places,
                here.rates,
                layout.array if layout else None,
            )

        with progress.counter(None, "step") as steps:
            if recording.poses_at is None:
                result, clock = fitted(recording), None
            else:
                recording, result, clock = synchronised(recording, fitted)
                recording = light.filled(recording, stamps, starts)
    except KeyboardInterrupt:
        print("interrupted: nothing was written")
        return options.INTERRUPTED
    found = on_array_of(scene, result.scene) if layout else result.scene
    written = [output] if args.force or not result.refusal else []
    if written:
        source = f"from {files.shown(path)}, starting from {scene.name}"
        comment = f"Calibrated by uuv_array calibrate {source}."
        save_scene(found, output, comment, text)
        if layout and len(layout.detectors.names) > 1:
            gains = output.with_name(f"{output.stem}_detectors.csv")
            write_detectors(gains, layout.with_gains(result.gains), comment)
            written.append(gains)
    measured = "" if places is None else f" at {int(places.max()) + 1} places"
    names = layout.detectors.names if layout else ()
    lines = [report(result, recording, path, scene.name, measured, names, told.timed)]
    if clock:
        lines.append(clock.text())
    lines += [
        f"{name}: {file}" for name, file in zip(("scene", "detectors"), written, strict=False)
    ]
    answer = as_json(result, recording, clock) | {"scene": found.settings()}
    outputs.finish(args, answer, "\n".join(lines))
    if picture is not None:
        count = int(result.uncensored.sum())
        title = f"Calibration from {files.shown(path)}: residuals of {count} readings"
        save(draw_calibration(result, recording, title), picture)
        if not args.json:
            print(f"picture: {picture}")
    if not written:
        raise ValueError(f"{path}: no scene written: {result.refusal}; --force writes it")
    return 0
