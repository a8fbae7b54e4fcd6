"""Signature tables that take long to build: written block by block into a Zarr array, by Dask.

The array has the key parameters of the scene's grid in its order, NaN for a pose without light and
0 for one not yet computed; its attributes hold the scene. Zarr moves the file of each block into
place when it is whole, and Zstandard protects it by a checksum. So any process can compute any
block, an interrupted build goes on, and nothing damaged is read.
"""

import logging
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage import files
from uuv_optical_array.estimation.signature_table import (
    BLOCK_POSES,
    WORTH_LOADING,
    Progress,
    SignatureTable,
    check_memory,
    gigabytes,
    grid_axes,
    grid_parameters,
    grid_poses,
    grid_rows,
    lit_rows,
    no_light,
    table_compiler,
)
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, scene_from_settings

FORMAT = 3
BLOCK_ROWS = 32 * BLOCK_POSES  # 2.6 MB, a fraction of a second of work
WAIT_S = 30.0
RETRIES = 2  # of a block whose worker lives and fails, as a shared disk may
# What Zarr raises for a damaged block depends on its version and on the damage.
DAMAGE = OSError, ValueError, RuntimeError, TypeError


def build_large_table(
    path: str | Path,
    scene: Scene,
    scheduler: str | None = None,
    threads: int | None = None,
    progress: Progress = iter,
    block_rows: int = BLOCK_ROWS,
) -> int:
    """Build the table of a scene in a folder, or finish one that was interrupted or damaged.

    - path: the folder; with a scheduler, all workers must see it under the same name.
    - scheduler: address of a Dask scheduler; ``None``: threads of this process.
    - threads: of this process, >= 1; ``None``: one for each core.
    - progress: wraps the loop over blocks, which have `block_rows` poses in a new table.
    - returned: number of rows with light.
    - ValueError: where the folder holds anything else, or the table of another scene; where the
      disk is too small, no pose has light, or the scheduler has no worker.
    """
    path = files.user_path(path).absolute()
    if path.exists():
        _open(path, scene)
    distributed = needs("cluster", "distributed")
    here = {
        "processes": False,
        "n_workers": 1,
        "threads_per_worker": threads,
        "memory_limit": 0,
        # HTTP is served without a dashboard, too, with a warning where the usual port is taken.
        "dashboard_address": None,
        "scheduler_kwargs": {"dashboard_address": "127.0.0.1:0"},
        # What fails is raised by its result; all else is logged by a cluster that is being closed.
        "silence_logs": logging.CRITICAL,
    }
    chosen = {"address": scheduler} if scheduler else here
    with distributed.Client(timeout=WAIT_S, **chosen) as client:
        try:
            client.wait_for_workers(1, timeout=WAIT_S)
        except TimeoutError:
            none = f"scheduler {scheduler}: no workers; start some with dask worker {scheduler}"
            raise ValueError(none) from None
        if not path.exists():
            _create(path, scene, block_rows)
        blocks = range(_open(path, scene).nchunks)
        futures = client.map(fill, blocks, path=path, scene=scene, pure=False, retries=RETRIES)
        done = distributed.as_completed(futures)
        lit = sum(future.result() for _, future in zip(progress(blocks), done, strict=False))
    if lit == 0:
        raise no_light(scene)
    return lit


def _create(path: Path, scene: Scene, block_rows: int) -> None:
    """Begin a table, with no block in it."""
    zarr, codecs = needs("cluster", "zarr"), needs("cluster", "numcodecs")
    rows = grid_rows(grid_axes(scene.table))
    home = next(parent for parent in path.parents if parent.exists())
    need, free = rows * 5 * 8, shutil.disk_usage(home).free
    if need > free:
        raise ValueError(
            f"table {path}: {rows:,} rows take up to {gigabytes(need)}, and {home} has "
            f"{gigabytes(free)} free; take a coarser grid or another disk"
        )
    # The format that Zarr 2 and 3 both read.
    form = {} if zarr.__version__.startswith("2.") else {"zarr_format": 2}
    packing = codecs.Zstd(level=1, checksum=True)
    layout = {"shape": (rows, 5), "chunks": (block_rows, 5), "dtype": "<f8", "fill_value": 0.0}
    with files.whole_directory(path) as scratch:
        array = zarr.open_array(str(scratch), mode="w", compressor=packing, **layout, **form)
        array.attrs.put({"format": FORMAT, "name": scene.name, "scene": scene.settings()})


def _open(path: Path, scene: Scene) -> Any:
    """Open the array of a scene's table, finished or not; ValueError for anything else."""
    zarr = needs("cluster", "zarr")
    if not os.path.exists(path):
        raise ValueError(
            f"table {path}: no table there, or in a folder that may not be searched; build one "
            "with uuv_array table"
        )
    try:
        array = zarr.open_array(str(path), mode="r")
        about = dict(array.attrs)
        if about["format"] != FORMAT:
            raise ValueError(f"format {about['format']}, this version reads {FORMAT}")
        theirs = scene_from_settings(about["scene"], about["name"])
        layout = array.shape, array.chunks[1:], array.fill_value, array.dtype
        if layout != ((grid_rows(grid_axes(theirs.table)), 5), (5,), 0.0, np.dtype("<f8")):
            raise ValueError("its header is damaged")
    except Exception as error:  # of many kinds, where there is no array or its header is damaged
        raise ValueError(
            f"table {path}: {_line(error)}; name another folder, or delete this one and build it "
            "again with uuv_array table"
        ) from None
    if differences := scene.differences(theirs):
        raise ValueError(
            f"table {path}: built for another scene than {scene.name}: {'; '.join(differences)}; "
            "build one for this scene with uuv_array table"
        )
    return array


def fill(block: int, path: Path, scene: Scene) -> int:
    """Compute a block of a table, unless it is there and whole; return its rows with light.

    ValueError on a machine that does not see the table; OSError where it cannot be written.
    """
    if not (path / ".zarray").is_file():
        raise ValueError(f"table {path}: not seen by every worker; name a folder that all share")
    array = needs("cluster", "zarr").open_array(str(path), mode="r+")
    try:
        parameters = _read(array, block)
    except DAMAGE:
        start, size = block * array.chunks[0], array.chunks[0]
        rows = range(array.shape[0])[start : start + size]
        if array.shape[0] >= WORTH_LOADING:
            table_compiler()
        parameters = grid_parameters(ForwardModel(scene), rows)
        with files.naming(path):
            # The last block is less than a whole one, and Zarr reads what is there of it first.
            (path / f"{block}.0").unlink(missing_ok=True)
            array.blocks[block] = parameters
    return len(lit_rows(parameters))


def _read(array: Any, block: int) -> Array:
    """Read the key parameters of a block; one of `DAMAGE` where it is missing or damaged."""
    parameters: Array = array.blocks[block]
    if (parameters[:, 0] == 0).any():
        raise ValueError("missing")
    return parameters


def load_table(path: str | Path, scene: Scene) -> SignatureTable:
    """Read the table of a scene into memory.

    Parameters
    ----------
    path, scene
        Folder of the table, and the scene that it has to be of.

    Raises
    ------
    ValueError
        For a table that is missing, damaged or unfinished, was built for another scene, or is too
        large for this machine.
    """
    path = files.user_path(path).absolute()
    array = _open(path, scene)
    if array.nchunks_initialized < array.nchunks:
        raise ValueError(
            f"table {path}: {array.nchunks_initialized} of {array.nchunks} blocks are there; "
            "run the same uuv_array table again to finish it"
        )
    lit, parameters, count = [], [], 0
    for block in range(array.nchunks):
        try:
            values = _read(array, block)
        except DAMAGE as error:
            raise ValueError(
                f"table {path}: block {block}.0 is damaged ({_line(error)}); "
                "run the same uuv_array table again to mend it"
            ) from None
        rows = lit_rows(values)
        lit.append(rows + block * array.chunks[0])
        parameters.append(values[rows])
        count += len(rows)
        check_memory(count, f"table {path}")
    poses = grid_poses(grid_axes(scene.table), np.concatenate(lit))
    return SignatureTable(scene, poses, np.concatenate(parameters))


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
