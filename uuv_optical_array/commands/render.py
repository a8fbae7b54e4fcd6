"""``uuv_array render``: draw what the array reads in a scene."""

import argparse
from typing import Annotated

import numpy as np

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import RANGES_M
from uuv_optical_array.plots.scene import draw_scene, sheet_poses
from uuv_optical_array.plots.style import save

DESCRIPTION = """\
Draw what the array reads in a scene: images from 4 to 8 m behind the lamp, aligned, shifted to
port, turned to port and pitched down; below them the profiles through the peak and their gradients,
from which the key parameters are taken. Each image has noise of its own."""

EPILOG = """\
examples:
  uuv_array render                               the default scene, into render.png
  uuv_array render --scene harbour --output harbour.png
  uuv_array render --scene sea.yaml --seed 2     your own scene, with other noise"""

TIME = Quantity("time at which lamp flicker, drift and plume are evaluated", "s", 0, 1e10)


def images_of(
    scene: Scene,
    poses: Array,
    *,
    seed: Annotated[int, options.SEED] = 0,
    time_s: Annotated[float, TIME] = 0.0,
) -> Array:
    """Return images at poses, m and rad, shape ``(..., 5)``; counts, ``(..., side, side)``."""
    return ForwardModel(scene).expose(poses, np.random.default_rng(seed), time_s=time_s)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    options.add_settings(parser, images_of)
    outputs.add_picture(parser, "render.png")


def run(args: argparse.Namespace) -> int:
    """Draw the scene, and print its effects and the range of each aligned image."""
    scene = options.scene_of(args)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)

    images = images_of(scene, sheet_poses(), **options.settings_of(args, images_of))
    save(draw_scene(scene, images), output)
    print(f"scene {scene.name}: {', '.join(scene.effects) or 'no effects'}")
    for range_m, image in zip(RANGES_M, images[:, 0], strict=True):
        print(f"  aligned at {range_m:g} m: {image.min():.4g} to {image.max():.4g} counts")
    print(f"picture: {output}")
    return 0
