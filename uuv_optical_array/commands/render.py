"""``uuv_array render``: draw what the array reads in a scene.

Draw what the array reads in a scene: images from 4 to 8 m behind the lamp, aligned, shifted to
port, turned to port and pitched down; below them the profiles through the peak and their gradients,
from which the key parameters are taken. Each image has its own noise.

  uuv_array render                               the default scene, into render.png
  uuv_array render --scene harbour --output harbour.png
  uuv_array render --scene sea.yaml --seed 2     your own scene, with other noise
"""

import argparse
from typing import Any

import numpy as np

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.core.geometry import DOF_NAMES, IN_DEGREES, Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import RANGES_M
from uuv_optical_array.plots.style import array_image, detector_ticks, new_figure, save, shades

TIME = Quantity("time at which lamp flicker, drift and plume are evaluated", "s", 0, 1e10)
COLUMNS = (  # title, degree of freedom, m or deg
    ("aligned", "x", 0.0),
    ("y 0.3 m", "y", 0.3),
    ("y 0.6 m", "y", 0.6),
    ("yaw 10 deg", "yaw", 10.0),
    ("yaw 20 deg", "yaw", 20.0),
    ("pitch 10 deg", "pitch", 10.0),
    ("pitch 20 deg", "pitch", 20.0),
)
PROFILED = (0, 2, 3, 5)  # columns whose profiles are drawn


def sheet_poses() -> Array:
    """Return the poses of the sheet, m and rad, shape ``(ranges, columns, 5)``."""
    sheet = np.zeros((len(RANGES_M), len(COLUMNS), 5))
    sheet[..., 0] = -np.array(RANGES_M)[:, None]
    for column, (_, name, value) in enumerate(COLUMNS):
        dof = DOF_NAMES.index(name)
        sheet[:, column, dof] += value / IN_DEGREES[dof]
    return sheet


def _draw_images(figure: Any, images: Array) -> None:
    grid = figure.subplots(len(RANGES_M), len(COLUMNS))
    for range_m, row, axes_row in zip(RANGES_M, images, grid, strict=True):
        # Each row has a scale of its own, so that background light does not hide the pattern.
        low, high = row.min(), max(row.max(), row.min() + 1)
        for (title, _, _), image, axes in zip(COLUMNS, row, axes_row, strict=True):
            mesh = array_image(axes, image, vmin=low, vmax=high)
            for edge in range(image.shape[1], len(image), image.shape[1]):
                axes.axhline(edge - 0.5, color="w", lw=1)
            axes.tick_params(labelsize=8, length=2)
            axes.label_outer()
            if range_m == RANGES_M[0]:
                axes.set_title(title, fontsize=11)
            if range_m == RANGES_M[-1]:
                axes.set_xlabel("column, to starboard", fontsize=9)
        axes_row[0].set_ylabel(f"{range_m:g} m\nrow, downwards", fontsize=10)
        figure.colorbar(mesh, ax=axes_row, pad=0.01, aspect=12, label="reading (counts)")


def _draw_profiles(figure: Any, images: Array, full_scale_counts: float) -> None:
    """Draw the profiles through the peak of some columns of the sheet, and their gradients."""
    images = together(images)
    side = images.shape[-1]
    colours = shades("viridis", 0, 0.85, len(RANGES_M))
    grid = figure.subplots(2, 2 * len(PROFILED), sharex=True)
    detectors = np.arange(side)
    peaks = key_parameters(images, full_scale_counts, "detector")[..., 1:3] + (side - 1) / 2
    at = np.rint(peaks).astype(int)
    for place, column in enumerate(PROFILED):
        for across, axes in ((True, grid[:, 2 * place]), (False, grid[:, 2 * place + 1])):
            for row, range_m in enumerate(RANGES_M):
                image, (peak_column, peak_row) = images[row, column], at[row, column]
                profile = image[peak_row] if across else image[:, peak_column]
                size = 3 if side < 9 else 0
                style = {"color": colours[row], "lw": 1.6, "marker": "o", "ms": size}
                axes[0].plot(detectors, profile, label=f"{range_m:g} m", **style)
                axes[1].plot(detectors, np.gradient(profile), **style)
            direction = "horizontal" if across else "vertical"
            axes[0].set_title(f"{COLUMNS[column][0]}\n{direction}", fontsize=10)
            axes[1].set_xlabel("column" if across else "row", fontsize=9)
            detector_ticks(axes[1].xaxis, most=4)
    for row, name in zip(grid, ("profile (counts)", "gradient\n(counts/detector)"), strict=True):
        limits = [axes.get_ylim() for axes in row]
        for axes in row:
            axes.set_ylim(np.min(limits), np.max(limits))
            axes.grid(alpha=0.3)
            axes.tick_params(labelsize=8, labelleft=axes is row[0])
        row[0].set_ylabel(name, fontsize=10)
    look: Any = {"loc": "outside right center", "fontsize": 10, "title": "behind the lamp"}
    figure.legend(*grid[0, 0].get_legend_handles_labels(), **look)


def draw_scene(scene: Scene, images: Array) -> Any:
    """Draw a scene's images at `sheet_poses`, ``(ranges, columns, side, side)``, and profiles."""
    figure = new_figure(13, 15)
    sheet, profiles = figure.subfigures(2, 1, height_ratios=[2.3, 1])
    _draw_images(sheet, images)
    _draw_profiles(profiles, images, scene.full_scale_counts)
    side = scene.array.detectors_per_side
    several = "; those of the lamps below one another, profiles of their sum" if scene.lamps else ""
    array = f"the {side} x {side} array with base_link 4 to 8 m behind the lamp"
    scale = "each row has its own scale, from its least to its largest reading"
    title = f"Scene {scene.name}: readings of {array}\nimages: {scale}{several}"
    figure.suptitle(title, fontsize=12)
    return figure


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    options.add_number(parser, "seed", options.SEED, 0)
    options.add_number(parser, "time_s", TIME, 0.0)
    outputs.add_picture(parser, "render.png")


def run(args: argparse.Namespace) -> int:
    """Draw the scene, and print its effects and the range of each aligned image."""
    scene = options.scene_of(args)
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    rng = np.random.default_rng(args.seed)
    images = ForwardModel(scene).expose(sheet_poses(), rng, time_s=args.time_s)
    save(draw_scene(scene, images), output)
    print(f"scene {scene.name}: {', '.join(scene.effects) or 'no effects'}")
    for range_m, image in zip(RANGES_M, images[:, 0], strict=True):
        print(f"  aligned at {range_m:g} m: {image.min():.4g} to {image.max():.4g} counts")
    print(f"picture: {output}")
    return 0
