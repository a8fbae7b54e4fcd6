"""The options of commands that read tables of light, and the recording read by them."""

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.likelihood.likelihood import UNKNOWN_STD
from uuv_optical_array.cli import bag, options, progress
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.processes import spread
from uuv_optical_array.core.settings import Quantity, Setting, unknown
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.scene import Scene, scene_from_settings
from uuv_optical_array.layouts.detectors import (
    Layout,
    layout_of,
    number_in,
    of_scene,
    read_detectors,
)
from uuv_optical_array.layouts.poses import PoseFit
from uuv_optical_array.layouts.readings import (
    NAMES,
    TIME,
    Course,
    read_table,
    recording_of,
    told_of,
)
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.places import LEAST_STD, POSE

UNIT = Quantity("counts of one unit of a table's readings, such as a volt", "counts", 1e-9, 1e9)
LEAST_COUNTS = 10.0  # of the brightest reading; a lamp's reference is 1 at least
SETTINGS = {"counts_per_unit": Setting(float, UNIT, 1.0, optional=False)}


class Light(NamedTuple):
    """Readings with what is given of their places.

    - recording: with nan where a part of a pose is not known.
    - stds: of its poses, m and rad, ``(m, 5)``; nan as there.
    - layout: of the detectors; ``None``: they are those of the scene.
    - timed: whether its images have times; those of a table without are numbered.
    """

    recording: Recording
    stds: Array
    layout: Layout | None
    timed: bool


def add_tables(parser: argparse.ArgumentParser) -> None:
    """Add the options of tables of light."""
    about = "CSV of the detectors in place of the scene's, for a CSV of readings"
    parser.add_argument("--detectors", type=Path, metavar="TABLE", help=about)
    about = "CSV of poses by time_s, in place of the recorded ones"
    parser.add_argument("--trajectory", type=Path, metavar="TABLE", help=about)


def is_table(path: Path) -> bool:
    """Say whether a recording is a table of readings."""
    return path.suffix.lower() == ".csv"


def known_column(word: str) -> tuple[str, float | None]:
    """Read NAME=VALUE, or NAME alone, of a column of `NAMES`."""
    name, equals, text = word.partition("=")
    try:
        if name not in NAMES:
            raise unknown(name, NAMES, "")
        return name, number_in(text, name) if equals else None
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def kind_of(path: Path) -> str:
    """Return what a recording is called."""
    return "table" if is_table(path) else "bag"


def read_light(args: argparse.Namespace, scene: Scene, poses_needed: bool = True) -> Light:
    """Read a table of readings, or a bag, with the poses of its odometries or of --trajectory."""
    if not is_table(args.bag) and args.detectors:
        raise options.OptionError(
            f"--detectors: {args.bag} is not a table of readings; a bag has images of the scene's "
            "array, so give a .csv"
        )
    course = None
    if args.trajectory:
        course = Course(read_table(files.user_path(args.trajectory)), dict(args.set)["max_gap_s"])
    if not is_table(args.bag):
        needed = poses_needed and course is None
        recording, layout = bag.read_bag(args, scene, needed), None
        columns: dict[str, Array] = {}
        timed = True
    else:
        recording, layout, columns, timed = _read(args, scene)
    if course:
        recording, columns = dataclasses.replace(recording, poses_at=course.at), {}
        # A table without times counts its rows, which is no time of a course.
        if not timed:
            raise ValueError(f"{args.bag}: no column {TIME}, which --trajectory needs")
        poses, rolls = course.at(recording.stamps_ns)
        recording = dataclasses.replace(recording, poses=poses, rolls=rolls)
        told = ~np.isnan(rolls) & ~np.isnan(poses[:, course.parts]).any(axis=1)
        if not told.any():
            span = f"{recording.seconds.min():.3f} to {recording.seconds.max():.3f} s"
            raise ValueError(
                f"{args.trajectory}: it has no pose at the readings' times, {span}; both clocks "
                "have to agree within a second or so"
            )
        recording = recording.only(told, f"images outside of the times of {args.trajectory.name}")
    return Light(recording, told_of(columns, len(recording.images)).stds, layout, timed)


def with_known(light: Light, known: Mapping[str, float]) -> Light:
    """Return light of which columns of `NAMES` have a value, in m and deg, for every image."""
    recording, told = light.recording, told_of({k: np.array([v]) for k, v in known.items()}, 1)

    def known_at(poses: Array, rolls: Array) -> tuple[Array, Array]:
        return (
            np.where(np.isnan(told.poses), poses, told.poses),
            np.where(np.isnan(told.rolls), rolls, told.rolls),
        )

    poses, rolls = known_at(recording.poses, recording.rolls)
    if (inner := recording.poses_at) is not None:
        recording = dataclasses.replace(recording, poses_at=lambda at: known_at(*inner(at)))
    recording = dataclasses.replace(recording, poses=poses, rolls=rolls)
    return light._replace(
        recording=recording, stds=np.where(np.isnan(told.stds), light.stds, told.stds)
    )


def check_bright(args: argparse.Namespace, recording: Recording) -> None:
    """Raise ValueError for a table whose readings are too few counts for a lamp of a scene."""
    if is_table(args.bag) and (brightest := recording.images.max()) < LEAST_COUNTS:
        raise ValueError(
            f"{args.bag}: the brightest reading is {brightest:g} counts; a scene needs "
            f"{LEAST_COUNTS:g} at least: set counts_per_unit, and the scene's noise in the same "
            "counts"
        )


def filled(recording: Recording, stamps_ns: NDArray[np.int64], starts: Array) -> Recording:
    """Return a recording whose unknown parts are the starts, which were found for all stamps."""
    own = starts[np.searchsorted(stamps_ns, recording.stamps_ns)]
    poses = np.where(np.isnan(recording.poses), own, recording.poses)
    return dataclasses.replace(recording, poses=poses)


def read_known(args: argparse.Namespace, scene: Scene) -> tuple[Light, list[str]]:
    """Return what tables, or a bag, give, and the parts of poses that they must leave open."""
    known = dict(args.known)
    if missing := [name for name, value in known.items() if value is None]:
        raise options.OptionError(f"--known {missing[0]}: no value; give {missing[0]}=VALUE")
    told = with_known(read_light(args, scene), known)
    lacking = np.isnan(told.recording.poses)
    for i, name in enumerate(POSE):
        if lacking[:, i].any() and name not in args.unknown:
            rows = f"{lacking[:, i].sum()} of {len(lacking)} places"
            raise ValueError(
                f"{name}: no value for {rows}; add a column, or give --known {name}=VALUE if it is "
                f"constant, or --unknown {name} if the light determines it"
            )
    return told, [name for name in POSE if name in args.unknown]


def with_starts(light: Light, scene: Scene, parts: Sequence[str]) -> tuple[Light, Array]:
    """Return light, and poses with starts of the `parts` that are unknown, ``(m, 5)``.

    They are found by the scene as if it were as bought; images without one are left out, and
    counted. In the recording these parts stay nan.
    """
    settings = (light.layout.scene if light.layout else scene).settings()
    settings["prior"] = {"known": "as_bought"}
    loose = scene_from_settings(settings, scene.name)
    layout = layout_of(loose, of_scene(loose))
    if light.layout:
        layout = dataclasses.replace(light.layout, scene=loose)
    fit, recording = PoseFit(layout, 0.0), light.recording
    free = [POSE.index(name) for name in parts]
    poses, stds = recording.poses.copy(), light.stds.copy()
    poses[:, free] = np.nan
    given = np.where(np.isnan(stds), LEAST_STD, stds)
    found = list(
        progress.over(
            spread(
                lambda i: fit.one(recording.images[i], poses[i], given[i], recording.rolls[i]),
                len(poses),
            ),
            total=len(poses),
        )
    )
    reasons = [each.reason for each in found]
    starts = poses.copy()
    starts[:, free] = np.array([each.pose for each in found])[:, free]
    stds[:, free] = UNKNOWN_STD
    kept = np.array([not each.reason for each in found])
    if not kept.any():
        raise ValueError(
            f"--unknown {', '.join(parts)}: no image gives a pose: {found[0].reason}; make the "
            "scene's lamp more like yours, or give more parts by --known"
        )
    why = f"no initial {', '.join(parts)}, for example: {next(filter(None, reasons), '')}"
    recording = dataclasses.replace(recording, poses=poses).only(kept, why)
    return light._replace(recording=recording, stds=stds[kept]), starts[kept]


def _read(
    args: argparse.Namespace, scene: Scene
) -> tuple[Recording, Layout | None, dict[str, Array], bool]:
    path = files.user_path(args.bag)
    own = args.detectors is None
    detectors = of_scene(scene) if own else read_detectors(files.user_path(args.detectors))
    layout = layout_of(scene, detectors)
    table = read_table(path, detectors.names, scene.lamp_count)
    recording = recording_of(table, layout, dict(args.set)["counts_per_unit"])
    if own:
        side = scene.array.detectors_per_side
        images = layout.readings(recording.images).reshape(-1, scene.lamp_count * side, side)
        recording = dataclasses.replace(recording, images=images)
    return recording, None if own else layout, dict(table.told), table.timed
