"""``uuv_array table``: write the signature table of a scene."""

import argparse
import time

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.estimation.large_table import build_large_table
from uuv_optical_array.estimation.signature_table import (
    gigabytes,
    grid_axes,
    grid_rows,
    memory_bytes,
)

DESCRIPTION = """\
Write the signature table of a scene: the five key parameters of every pose on the grid that the
scene's `table` names, free of noise. Estimators build the table of their scene in memory, which
takes a second for the default scene. Write a table whose grid is so fine that this takes too long,
and name its folder in the parameter `table` of estimator_node, which refuses it where it is
damaged or of another scene.

The table is a Zarr array, which Dask fills block by block, on threads of this machine or on a
cluster; this needs the extra `cluster`. The same command goes on after an interruption."""

EPILOG = """\
examples:
  uuv_array table                              the default scene, into follow.zarr/
  uuv_array table --scene sea.yaml -o /data/t  your own scene, into a folder of your choice
  uuv_array table --scene sea.yaml -o /shared/sea.zarr --workers tcp://10.0.0.1:8786
                                               on a cluster, into a folder that all of it sees"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    outputs.add_folder(parser, "folder to write (default: SCENE.zarr here)")
    parser.add_argument(
        "--workers",
        metavar="N|ADDRESS",
        help="threads of this machine (default: all cores), or the scheduler of a Dask cluster",
    )


def run(args: argparse.Namespace) -> int:
    """Write the table, or what is missing of it."""
    scene = options.scene_of(args)
    scheduler = args.workers if args.workers and ":" in args.workers else None
    threads = None
    if args.workers is not None and not scheduler:
        threads = int(args.workers) if args.workers.isdecimal() else 0
        if threads < 1:
            raise options.OptionError(
                f"--workers {args.workers}: give a number of threads, at least 1, or the address "
                "of a scheduler, such as tcp://10.0.0.1:8786"
            )
    output = outputs.folder_to_write(args.output or f"{scene.name}.zarr", "--output")
    began = time.perf_counter()
    try:
        rows = build_large_table(
            output, scene, scheduler, threads, lambda blocks: progress.over(blocks, "block")
        )
    except KeyboardInterrupt:
        print(f"interrupted: the same command goes on from what is in {output}")
        return options.INTERRUPTED
    size_mb = sum(file.stat().st_size for file in output.iterdir()) / 1e6
    print(
        f"{output}: {rows} signatures of {grid_rows(grid_axes(scene.table))} poses, "
        f"{size_mb:.0f} MB, scene {scene.name}, in {time.perf_counter() - began:.0f} s; "
        f"an estimator needs {gigabytes(memory_bytes(rows))} of memory for it"
    )
    return 0
