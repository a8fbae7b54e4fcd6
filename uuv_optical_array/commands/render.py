"""``uuv_array render``: what the array sees in a scene, as a sheet of images and profiles."""

import argparse

import numpy as np

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import RANGES_M

DESCRIPTION = """\
Draw what the array reads in a scene: images from 4 to 8 m behind the lamp, aligned, shifted to
port, turned to port and pitched down; below them the profiles through the peak and their gradients,
which the key parameters are taken from. Noise is drawn once for each image."""

EPILOG = """\
examples:
  uuv_array render                               the default scene, into render.png
  uuv_array render --scene harbour --output harbour.png
  uuv_array render --scene sea.yaml --seed 2     your own scene, another draw of its noise"""

NUMBERS = {
    "seed": options.Number(options.SEED, 0),
    "time-s": options.Number(
        Quantity("moment of the images, for a flicker, a drift or a plume", "s", 0, 1e10), 0.0
    ),
}


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "render",
        run,
        "draw what the array reads in a scene",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "follow")
    options.add_numbers(parser, NUMBERS)
    outputs.add_picture(parser, "render.png")


def run(args: argparse.Namespace) -> int:
    """Draw the scene and print what its plan holds."""
    seed, time_s = options.numbers_of(args, NUMBERS)
    scene = options.scene_of(args)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    from uuv_optical_array.plots.scene import draw_scene, sheet_poses

    model, rng = ForwardModel(scene), np.random.default_rng(seed)
    images = model.expose(sheet_poses(), rng, time_s=time_s)
    draw_scene(scene, images, output)
    print(f"scene {scene.name}: {', '.join(scene.effects) or 'the light alone'}")
    for range_m, image in zip(RANGES_M, images[:, 0], strict=True):
        print(f"  aligned at {range_m:g} m: {image.min():.4g} to {image.max():.4g} counts")
    print(f"picture: {output}")
    return 0
