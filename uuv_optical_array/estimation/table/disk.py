"""Signature tables on disk: written once, opened by every process that needs them.

A table is a folder of ``poses.npy`` (m, 5), ``parameters.npy`` (m, 5), ``table.yaml`` with the
scene it was built from and the scene's fingerprint, and the checksums of these files
(`core.storage.manifest`). One that is too large to be built in memory is a `store.TableStore`.
"""

import logging
import shutil
from pathlib import Path

import numpy as np

from uuv_optical_array.core.storage import files, manifest, memory, yaml_text
from uuv_optical_array.estimation.table import store
from uuv_optical_array.estimation.table.signature_table import (
    Progress,
    SignatureTable,
    build_table,
    check_scene,
)
from uuv_optical_array.forward.scene import Scene

FORMAT = 2
ARRAYS = "poses.npy", "parameters.npy"
ABOUT = "table.yaml"


def save_table(table: SignatureTable, path: str | Path) -> None:
    """Write a table to a folder, whole or not at all.

    Parameters
    ----------
    table
        The table.
    path
        The folder; a table there is replaced, anything else is refused.

    Raises
    ------
    ValueError
        Where `path` exists and is no table.
    """
    path = files.user_path(path)
    check_replaceable(path)
    about = {
        "format": FORMAT,
        "fingerprint": table.scene.fingerprint,
        "name": table.scene.name,
        "scene": table.scene.settings(),
    }
    with files.whole_directory(path) as scratch:
        for name, array in zip(ARRAYS, (table.poses, table.parameters), strict=True):
            np.save(scratch / name, array)
        (scratch / ABOUT).write_text(yaml_text.text_of(about), "utf-8")
        manifest.write(scratch, (*ARRAYS, ABOUT))


def check_replaceable(path: Path) -> None:
    """Raise ValueError where a path exists and is no table, which `save_table` would replace."""
    if path.exists() and not _is_table(path):
        raise ValueError(f"table {path}: exists and is no table; name another folder")


def _is_table(path: Path) -> bool:
    """Say whether a folder holds a table and nothing else."""
    about = path / ABOUT
    return (
        about.is_file()
        and about.read_bytes().startswith(b"format:")
        and {file.name for file in path.iterdir()} <= {*ARRAYS, ABOUT, manifest.NAME}
    )


def load_table(path: str | Path, scene: Scene) -> SignatureTable:
    """Open a table, memory-mapped, for the scene it is to be used in.

    Parameters
    ----------
    path
        Folder of the table.
    scene
        The scene at hand.

    Returns
    -------
    SignatureTable
        The table.

    Raises
    ------
    ValueError
        For a table that is missing, damaged or unfinished, was built for another scene, or is too
        large for this machine.
    """
    path = files.user_path(path)
    if store.is_store(path):
        return store.TableStore.open(path, scene).table()
    if not path.exists():
        raise ValueError(f"table {path}: no table there; build one with uuv_array table")
    try:
        manifest.check(path)
        about = yaml_text.read(path / ABOUT)
        if about["format"] != FORMAT:
            raise ValueError(f"format {about['format']}, this version reads {FORMAT}")
        poses, parameters = (np.load(path / name, mmap_mode="r") for name in ARRAYS)
    except (OSError, ValueError) as error:
        raise manifest.refusal(path, error) from None
    check_scene(path, about, scene)
    if why := memory.shortfall(len(poses)):
        raise ValueError(f"table {path}: {why}")
    return SignatureTable(scene, poses, parameters)


def open_cached(scene: Scene) -> SignatureTable | None:
    """Open the scene's table from the user's cache.

    Parameters
    ----------
    scene
        The scene.

    Returns
    -------
    SignatureTable or None
        The table; ``None`` where the cache has none.

    Raises
    ------
    ValueError
        As `load_table`, for one that cannot be used.
    """
    path = _cached_path(scene)
    files.remove_leftovers(path.parent)
    return load_table(path, scene) if path.exists() else None


def _cached_path(scene: Scene) -> Path:
    return files.cache_dir() / f"{scene.name}-{scene.fingerprint[:16]}"


def cached_table(scene: Scene, progress: Progress = iter) -> SignatureTable:
    """Open the scene's table from the user's cache, building it there the first time.

    Parameters
    ----------
    scene
        The scene.
    progress
        As in `build_table`.

    Returns
    -------
    SignatureTable
        The table; in memory only, where the cache cannot be written.
    """
    path = _cached_path(scene)
    try:
        if table := open_cached(scene):
            return table
    except ValueError as error:
        logging.getLogger(__name__).warning("%s: building it again now", error)
        shutil.rmtree(path, ignore_errors=True)
    table = build_table(scene, progress=progress)
    try:
        if not path.exists():  # else another process was faster
            save_table(table, path)
        return load_table(path, scene)
    except (OSError, ValueError):
        return table
