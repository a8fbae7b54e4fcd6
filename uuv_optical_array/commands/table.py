"""``uuv_array table``: write the signature table of a scene.

Write the five key parameters, without noise, of every pose on the grid of the scene's `table`.
Estimators build this table in memory, within a few seconds for the default scene. If the grid is
too fine for that, write the table, and name its folder in the parameter `table` of estimator_node,
which refuses a folder that is damaged or of another scene.

The table is a Zarr array, which Dask fills block by block, on threads of this machine or on a
cluster; this needs the extra `cluster`. After an interruption, repeat the command to continue.

  uuv_array table                              the default scene, into follow.zarr/
  uuv_array table --scene sea.yaml -o /data/t  your own scene, into a folder of your choice
  uuv_array table --scene sea.yaml -o /shared/sea.zarr --workers tcp://10.0.0.1:8786
                                               on a cluster, into a folder that all its machines see
"""

import argparse
import functools
import time

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.estimation import signature_table as tables
from uuv_optical_array.estimation.large_table import build_large_table


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    outputs.add_folder(parser, "folder to write (default: SCENE.zarr here)")
    about = "threads (default: all cores), or a Dask cluster's scheduler"
    parser.add_argument("--workers", metavar="N|ADDRESS", help=about)


def run(args: argparse.Namespace) -> int:
    """Write the table, or what is missing of it."""
    scene = options.scene_of(args)
    workers = args.workers
    scheduler = workers if workers and ":" in workers else None
    threads = int(workers) if workers and workers.isdecimal() else None
    if workers is not None and not scheduler and not threads:
        raise options.OptionError(
            f"--workers {workers}: give a number of threads, at least 1, or the address of a "
            "scheduler, such as tcp://10.0.0.1:8786"
        )
    output = outputs.folder_to_write(args.output or f"{scene.name}.zarr", "--output")
    began = time.perf_counter()
    over = functools.partial(progress.over, unit="block")
    try:
        rows = build_large_table(output, scene, scheduler, threads, over)
    except KeyboardInterrupt:
        print(f"interrupted: the same command continues what is in {output}")
        return options.INTERRUPTED
    size_mb = sum(file.stat().st_size for file in output.iterdir()) / 1e6
    poses = tables.grid_rows(tables.grid_axes(scene.table))
    print(
        f"{output}: {rows} signatures of {poses} poses, {size_mb:.0f} MB, scene {scene.name}, in "
        f"{time.perf_counter() - began:.0f} s; an estimator needs "
        f"{tables.gigabytes(tables.memory_bytes(rows))} of memory for it"
    )
    return 0
