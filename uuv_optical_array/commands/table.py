"""``uuv_array table``: build the signature table of a scene."""

import argparse
import sys
import time
from pathlib import Path

from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.parallel.cluster import on_cluster, on_threads, threads_within
from uuv_optical_array.core.storage import memory
from uuv_optical_array.estimation.table.disk import check_replaceable, save_table
from uuv_optical_array.estimation.table.signature_table import build_table
from uuv_optical_array.estimation.table.store import TableStore
from uuv_optical_array.forward.scene import Scene

DESCRIPTION = """\
Build the signature table of a scene: the five key parameters of every pose on the grid that the
scene's `table` names, free of noise. The folder that is written holds the poses, the parameters,
the scene and its fingerprint, and the checksums of these files. The estimator refuses it where it
is damaged, and in any other scene.

Estimator nodes without a `table` parameter build the same table in the user's cache by
themselves. Build one by hand to ship it with a vehicle or to look at its size beforehand.

A table that is too large to be built in memory is built in chunks into a Zarr store, on threads or
on a Dask cluster, with the extra `cluster`: name it *.zarr or give one of the options below. What
was interrupted goes on where it stopped when the same command is given again."""

EPILOG = """\
examples:
  uuv_array table                              the default scene, into follow.table/
  uuv_array table --scene reference            another ready scene
  uuv_array table --scene sea.yaml -o /data/t  your own scene, into a folder of your choice
  uuv_array table --scene sea.yaml --memory 2GB
                                               in chunks, into sea.zarr/
  uuv_array table --scene sea.yaml -o /shared/sea.zarr --scheduler tcp://10.0.0.1:8786
                                               on a cluster, into a folder that all of it sees"""


def add_parser(subparsers: options.Subparsers) -> None:
    """Add the subcommand."""
    parser = options.add_command(
        subparsers,
        "table",
        run,
        "build the signature table of a scene",
        DESCRIPTION,
        EPILOG,
    )
    options.add_scene(parser, "follow")
    parser.add_argument(
        "-o", "--output", type=Path, help="folder to write (default: SCENE.table here)"
    )
    chunks = parser.add_argument_group("in chunks (default folder: SCENE.zarr here)")
    chunks.add_argument(
        "--threads", type=options.whole_number, help="threads of this machine (default: all cores)"
    )
    chunks.add_argument("--memory", help="what this process may take, such as 2GB")
    chunks.add_argument("--scheduler", metavar="ADDRESS", help="scheduler of a Dask cluster")


def run(args: argparse.Namespace) -> int:
    """Build and save the table."""
    scene = options.scene_of(args)
    chosen = args.threads, args.memory, args.scheduler
    if chosen != (None, None, None) or (args.output and args.output.suffix == ".zarr"):
        return run_chunks(args, scene)
    output = outputs.folder_to_write(
        args.output or f"{scene.name}.table", "--output", replaced=True
    )
    check_replaceable(output)
    try:
        table = build_table(scene, progress=lambda blocks: progress.over(blocks, "block"))
    except KeyboardInterrupt:
        print("interrupted: nothing written")
        return options.INTERRUPTED
    save_table(table, output)
    size_mb = 2 * table.parameters.nbytes / 1e6
    print(f"{output}: {len(table.poses)} signatures, {size_mb:.0f} MB, scene {scene.name}")
    return 0


def run_chunks(args: argparse.Namespace, scene: Scene) -> int:
    """Build the table in chunks."""
    if args.scheduler and (args.memory or args.threads):
        raise options.OptionError(
            "scheduler: its workers have limits of their own; give them to dask worker as "
            "--memory-limit and --nthreads"
        )
    if args.threads is not None and args.threads < 1:
        raise options.OptionError(f"threads: {args.threads}; give at least 1")
    output = outputs.folder_to_write(args.output or f"{scene.name}.zarr", "--output")
    began = time.perf_counter()
    store = TableStore.create(output, scene)
    if why := memory.shortfall(store.rows):
        print(f"warning: not to be served here: {why}", file=sys.stderr)
    if before := len(store.present()):
        print(f"{output}: {before} of {len(store.chunks)} chunks are there already")
    try:
        lit = fill(store, args)
    except KeyboardInterrupt:
        print(
            f"interrupted: {len(store.present())} of {len(store.chunks)} chunks are in {output}; "
            "the same command goes on from there"
        )
        return options.INTERRUPTED
    store.finish(lit)
    size_mb = sum(file.stat().st_size for file in store.path.iterdir()) / 1e6
    print(
        f"{output}: {sum(lit)} signatures, {size_mb:.0f} MB, scene {scene.name}, "
        f"in {time.perf_counter() - began:.0f} s; "
        f"to serve it a node needs {memory.gigabytes(memory.serving_bytes(sum(lit)))}"
    )
    return 0


def fill(store: TableStore, args: argparse.Namespace) -> list[int]:
    """Work out the chunks that are missing, and show progress; return the lit rows of each."""
    need = store.thread_bytes()
    with progress.counter(total=len(store.chunks), unit="chunk") as shown:
        if args.scheduler:
            return on_cluster(store.fill, store.chunks, args.scheduler, need, shown.update)
        threads = threads_within(args.memory, need, args.threads)
        return on_threads(store.fill, store.chunks, threads, shown.update)
