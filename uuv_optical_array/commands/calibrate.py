"""``uuv_array calibrate``: fit lamp, water, background and gains to a recorded bag.

Fit the scene to a recorded bag, and write it. Fitted are the lamp (power and beam width; of several
lamps the power, place and axis of each), the water (absorption and scattering, or K), the array
(response, radius of the sphere, gains), the aim of lamp and array, and the background, except with
demodulation. Poses are known from both odometries, or from a table of places measured on a rail or
of poses by time. The offset between their clock and that of the images is fitted, too. A table of
readings, of any detectors, can replace the bag. Each value is printed with its standard error. A
value that the images do not determine stays as it is and is named, with what to record for it.
Images determine only the product of power and gains: the geometric mean of the gains is set to 1,
and that of several lamps' powers is kept. The shape of a beam of several Gaussians is fitted, too,
and that of one Gaussian if ``prior.beam_shape_std`` is given; so are ``lamp.behind_m`` and the
floors of modulated lamps if ``prior.lamp_behind_std_m``, ``lamp_floor_std_counts`` or
``lamps_floor_std_counts`` is. If the residuals show that model or beam are wrong, or if a value
ends at its bound, no scene is written, and the exit code is 1.

  ros2 bag record -o sea /array/image /leader/odometry /follower/odometry
  uuv_array calibrate sea --scene follow -o sea.yaml --picture residuals.png
  uuv_array calibrate sea --set image_topic=/bow/array/image --set beacon_position_m=-0.7,0,0.2
  uuv_array calibrate sea --set position_std_m=0.02 --set attitude_std_deg=0.5
  uuv_array calibrate sea --noise                  fit both parts of the noise, too
  uuv_array calibrate tank --places places.csv     measured places instead of odometry
  uuv_array calibrate rail.csv --detectors one.csv --known z_m=0      one detector on a rail, as a
                                                   table; its other columns are known, too
  uuv_array calibrate sea.csv --trajectory mocap.csv   readings, and poses by time
The table of places has the columns image (from 0 on) or time_s (after the first image); x_m, y_m,
z_m, pitch_deg, yaw_deg of base_link in beacon; x_std_m, y_std_m, z_std_m, pitch_std_deg,
yaw_std_deg; and perhaps roll_deg, and last_image or until_s: the images up to there share the place
and its error. docs/tutorials/own_light.md describes the other tables.
Needs rosbags and mcap (pip install rosbags mcap), but no ROS.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.calibration.calibrate import calibrate, what_is_fitted
from uuv_optical_array.calibration.clock import synchronised
from uuv_optical_array.calibration.report import as_json, report
from uuv_optical_array.calibration.result import Calibration
from uuv_optical_array.cli import bag, light, options, outputs, progress
from uuv_optical_array.core.geometry import IN_DEGREES
from uuv_optical_array.core.settings import Quantity, Setting
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.scene import save_scene
from uuv_optical_array.forward.scene_files import own_text
from uuv_optical_array.layouts.detectors import on_array_of, write_detectors
from uuv_optical_array.plots.calibration import draw_calibration
from uuv_optical_array.plots.style import save
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.places import LEAST_STD, POSE, read_places, with_places

POSITION = Quantity("standard deviation of the poses' x, y and z; 0: exact", "m", 0, 10)
ATTITUDE = Quantity("standard deviation of the poses' pitch and yaw; 0: exact", "deg", 0, 90)
STDS = {
    "position_std_m": Setting(float, POSITION, 0.0, optional=False),
    "attitude_std_deg": Setting(float, ATTITUDE, 0.0, optional=False),
}
# The fit makes no use of commands.
NO_USE = "commands_topic", "states_topic"
READING = {name: how for name, how in bag.READING.items() if name not in NO_USE}
SETTINGS = READING | light.SETTINGS | STDS


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
    about = "constant value of a part of the poses, or of its error; may be repeated"
    known: dict[str, Any] = {"action": "append", "default": [], "type": light.known_column}
    parser.add_argument("--known", help=about, metavar="NAME=VALUE", **known)
    about = "part of the poses that is estimated from the light; may be repeated"
    open_parts: dict[str, Any] = {"action": "append", "default": [], "choices": POSE}
    parser.add_argument("--unknown", help=about, metavar="NAME", **open_parts)
    about = "parameter that keeps the scene's value: its printed name, or gains; "
    words: dict[str, Any] = {"action": "append", "default": [], "metavar": "NAME"}
    parser.add_argument("--hold", help=about + "may be repeated", **words)
    about = "fit both parts of sensor_noise, too"
    parser.add_argument("--noise", action="store_true", help=about)
    about = "write the scene even if it is refused"
    parser.add_argument("--force", action="store_true", help=about)


def run(args: argparse.Namespace) -> int:
    """Read bag or tables, fit, print and write."""
    settings = dict(args.set)
    stds = np.repeat([settings[name] for name in STDS], [3, 2]) / IN_DEGREES
    scene = options.scene_of(args)
    if args.noise and "sensor_noise" not in scene.effects:
        raise options.OptionError(f"--noise: no effects.sensor_noise in {scene.name}; add it")
    with options.checking_options():
        what_is_fitted(scene, args.hold)
    table = args.places and files.user_path(args.places)
    if table is not None and stds.any():
        raise options.OptionError(
            f"--set {next(name for name in STDS if settings[name])}: the table of --places has "
            "these errors; leave one of them out"
        )
    if table is not None and (args.known or args.unknown or args.trajectory):
        raise options.OptionError(
            "--places: its table has complete poses; leave out --known, --unknown and --trajectory"
        )
    rail = read_places(table) if table else None
    path, text = files.user_path(args.bag), own_text(args.scene)
    output = outputs.file_to_write(args.output, "--output", outputs.SCENE)
    picture = args.picture and outputs.file_to_write(args.picture, "--picture", outputs.PICTURE)
    try:
        if rail is not None:
            told = light.read_light(args, scene, poses_needed=False)
            recording, pose_std, places = with_places(told.recording, rail)
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
    lines = [
        report(
            result,
            recording,
            f"{light.kind_of(path)} {path}",
            scene.name,
            measured,
            names,
            told.timed,
        )
    ]
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
