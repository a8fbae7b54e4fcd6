"""Signature tables on disk: written once, opened by every process that needs them.

A table is a folder of ``poses.npy`` (m, 5), ``parameters.npy`` (m, 5) and ``table.yaml`` with the
scene it was built from and the scene's fingerprint. One that is too large to be built in memory is
a `store.TableStore`.
"""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from uuv_optical_array.core import files, memory
from uuv_optical_array.estimation.table import store
from uuv_optical_array.estimation.table.signature_table import (
    Progress,
    SignatureTable,
    build_table,
    check_scene,
    damaged,
)
from uuv_optical_array.forward.scene import Scene

FORMAT = 1


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
    if path.exists() and not _is_table(path):
        raise ValueError(f"table {path}: exists and is no table; name another folder")
    about = {
        "format": FORMAT,
        "fingerprint": table.scene.fingerprint,
        "name": table.scene.name,
        "rows": len(table.poses),
        "scene": table.scene.settings(),
    }
    with files.whole_directory(path) as scratch:
        np.save(scratch / "poses.npy", table.poses)
        np.save(scratch / "parameters.npy", table.parameters)
        (scratch / "table.yaml").write_text(yaml.safe_dump(about, sort_keys=False), "utf-8")


def _is_table(path: Path) -> bool:
    """Say whether a folder holds a table and nothing else."""
    about = path / "table.yaml"
    return (
        about.is_file()
        and about.read_bytes().startswith(b"format:")
        and {file.name for file in path.iterdir()} <= {"poses.npy", "parameters.npy", about.name}
    )


def _read_about(path: Path) -> dict[str, Any]:
    try:
        values = yaml.safe_load((path / "table.yaml").read_text(encoding="utf-8"))
        if values["format"] != FORMAT:
            raise ValueError(f"format {values['format']}, this version reads {FORMAT}")
        if not isinstance(values["rows"], int):
            raise ValueError(f"{values['rows']!r} rows")
        return {key: values[key] for key in ("fingerprint", "name", "rows", "scene")}
    except FileNotFoundError:
        raise ValueError(f"table {path}: no table there; build one with uuv_array table") from None
    except (OSError, yaml.YAMLError, TypeError, KeyError, ValueError) as error:
        raise damaged(path, "table.yaml", error) from None


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
    about = _read_about(path)
    check_scene(path, about, scene)
    if why := memory.shortfall(about["rows"]):
        raise ValueError(f"table {path}: {why}")
    arrays = []
    for name in ("poses", "parameters"):
        try:
            array = np.load(path / f"{name}.npy", mmap_mode="r")
        except (OSError, ValueError, EOFError) as error:
            raise damaged(path, f"{name}.npy", error) from None
        if array.shape != (about["rows"], 5) or array.dtype != np.float64:
            raise ValueError(
                f"table {path}: {name}.npy holds {array.dtype} {array.shape}, "
                f"not float64 {(about['rows'], 5)}; build it again"
            )
        arrays.append(array)
    return SignatureTable(scene, *arrays)


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
    except ValueError:
        shutil.rmtree(path, ignore_errors=True)
    table = build_table(scene, progress=progress)
    try:
        save_table(table, path)
    except (OSError, ValueError):
        return table
    return load_table(path, scene)
