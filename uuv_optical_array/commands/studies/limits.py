"""``uuv_array limits``: how well one image can fix the pose at all, whoever estimates it."""

import argparse

import numpy as np

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import SPECIFICATION
from uuv_optical_array.studies.limits.bound_map import bound_map

DESCRIPTION = """\
The Cramer-Rao bound of a scene: the smallest standard deviation that any unbiased estimator can
reach from one image, given array, lamp, water and noise. It is printed for one pose, and drawn over
the working volume for a planar and for a curved array. What the scene's `prior` leaves uncertain,
such as the lamp's power, is estimated along with the pose and raises the bound."""

EPILOG = """\
examples:
  uuv_array limits                           6 m behind the lamp, in the default scene
  uuv_array limits --x -8 --y 0.5 --yaw-deg 10
  uuv_array limits --shape planar            the same scene with a planar array
  uuv_array limits --scene sea.yaml --output sea.png

A large condition number means that the image knows one mixture of metres and radians far better
than another: the planar array can hardly tell being aside from being turned. An angle whose bound
exceeds 180 deg is not known at all. Averaging n independent images divides a bound by sqrt(n)."""

POSE = {
    "x": options.Number(
        Quantity("ahead of the lamp; negative is behind it", "m", -1000, 1000), -6.0
    ),
    "y": options.Number(Quantity("to port", "m", -1000, 1000), 0.0),
    "z": options.Number(Quantity("up", "m", -1000, 1000), 0.0),
    "pitch-deg": options.Number(Quantity("bow down", "deg", -90, 90), 0.0),
    "yaw-deg": options.Number(Quantity("bow to port", "deg", -180, 180), 0.0),
}


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "limits",
        run,
        "print and draw how well one image can fix the pose at all",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "follow")
    options.add_numbers(parser, POSE)
    options.add_shape(parser)
    outputs.add_picture(parser, "limits.png")


def report(model: ForwardModel, pose: Array) -> str:
    """Return the bound at one pose ``(5,)``, m and rad, in words."""
    scene = model.scene
    bound = cramer_rao_bound(model, pose)
    x, y, z, pitch, yaw = pose * IN_DEGREES
    side = scene.array.detectors_per_side
    lines = [
        f"scene {scene.name}, {scene.array.shape} {side} x {side} array",
        f"pose: x {x:g}, y {y:g}, z {z:g} m; pitch {pitch:g}, yaw {yaw:g} deg",
        f"brightest reading: {model.expected(pose).max():.3g} counts",
        "",
        "least standard deviation from one image, and the specification:",
    ]
    for name, unit, std, wanted, seen in zip(
        DOF_NAMES, DOF_UNITS, bound.std * IN_DEGREES, SPECIFICATION, bound.observable, strict=True
    ):
        verdict = "within" if std <= wanted else "beyond"
        found = f"{std:10.3g} {unit:<4} {verdict} {wanted:g} {unit}" if seen else "unobservable"
        lines.append(f"  {name:<6}{found if seen else found.rjust(15)}")
    seen_names = [name for name, seen in zip(DOF_NAMES, bound.observable, strict=True) if seen]
    lines += [
        "",
        f"observable: {', '.join(seen_names) or 'nothing'}",
        f"condition number of the information, in m and rad: {bound.condition:.2g}",
    ]
    stds = scene.prior.nuisance_std()
    if stds:
        along = ", ".join(f"{name} +-{std:g}" for name, std in stds.items())
        lines.append(f"estimated along with the pose: {along}")
    return "\n".join(lines)


def run(args: argparse.Namespace) -> int:
    """Print the bound at one pose and draw it over the working volume."""
    pose = np.array(options.numbers_of(args, POSE))
    scene = options.scene_of(args)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    model = ForwardModel(scene.with_shape(args.shape or scene.array.shape))
    print(report(model, pose / IN_DEGREES))
    from uuv_optical_array.plots.studies.bound_map import draw_bound_map

    draw_bound_map(bound_map(scene), scene.name, output)
    print(f"picture: {output}")
    return 0
