"""The signature table: the key parameters of a grid of poses, built once and kept on disk.

A table is a folder of ``poses.npy`` (m, 5), ``parameters.npy`` (m, 5) and ``table.yaml`` with the
scene it was built from and the scene's fingerprint.
"""

import math
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from uuv_optical_array import files
from uuv_optical_array.bulk import worthwhile
from uuv_optical_array.features import key_parameters
from uuv_optical_array.image import ForwardModel
from uuv_optical_array.pose import Array
from uuv_optical_array.scene import Scene, TableSettings, scene_from_settings

FORMAT = 1
BLOCK_POSES = 4096  # keeps the temporaries of a 5 x 5 array in the cache
BLOCK_READINGS = 25 * BLOCK_POSES  # and those of larger ones

Progress = Callable[[Iterable[int]], Iterable[int]]


@dataclass(frozen=True)
class SignatureTable:
    """Poses and their key parameters, row by row.

    Parameters
    ----------
    scene
        The scene that the table was built from.
    poses
        ``(x, y, z, pitch, yaw)`` in m and rad, shape ``(m, 5)``.
    parameters
        Key parameters of each pose, shape ``(m, 5)``; every row has light.
    """

    scene: Scene
    poses: Array
    parameters: Array


def grid_axes(settings: TableSettings) -> list[Array]:
    """Return the values along each axis of the table's grid, m and rad, five arrays."""
    axes = []
    for field in fields(settings):
        values = np.linspace(*getattr(settings, field.name))
        axes.append(np.radians(values) if field.name.endswith("_deg") else values)
    return axes


def build_table(
    scene: Scene, min_peak_counts: float = 1.0, progress: Progress = iter
) -> SignatureTable:
    """Compute the signature of every pose of the scene's grid, free of noise and rounding.

    Parameters
    ----------
    scene
        The scene; its ``table`` gives the grid.
    min_peak_counts
        Poses whose brightest detector stays below this have no signature and are left out.
    progress
        Wraps the loop over blocks, such as ``tqdm.tqdm``.

    Returns
    -------
    SignatureTable
        The table, in memory.

    Raises
    ------
    ValueError
        Where no pose of the grid has light.
    """
    axes = grid_axes(scene.table)
    shape = tuple(len(axis) for axis in axes)
    rows = math.prod(shape)
    model = ForwardModel(scene, worthwhile(rows * scene.array.detectors_per_side**2))
    poses, parameters = np.empty((rows, 5)), np.empty((rows, 5))
    kept = 0
    size = min(BLOCK_POSES, max(BLOCK_READINGS // model.array.side**2, 1))
    for start in progress(range(0, rows, size)):
        index = np.unravel_index(np.arange(start, min(start + size, rows)), shape)
        block = np.stack([axis[i] for axis, i in zip(axes, index, strict=True)], axis=-1)
        images = model.expected(block)
        lit = images.max(axis=(1, 2)) >= min_peak_counts
        stop = kept + int(lit.sum())
        poses[kept:stop] = block[lit]
        parameters[kept:stop] = key_parameters(
            images[lit], scene.full_scale_counts, scene.signature.peak
        )
        kept = stop
    if kept == 0:
        raise ValueError(
            f"scene {scene.name}: no pose of the table has {min_peak_counts:g} count of light; "
            "move the grid into the beam or strengthen the lamp"
        )
    return SignatureTable(scene, poses[:kept], parameters[:kept])


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
        return {key: values[key] for key in ("fingerprint", "name", "rows", "scene")}
    except FileNotFoundError:
        raise ValueError(f"table {path}: no table there; build one with uuv_array table") from None
    except (OSError, yaml.YAMLError, TypeError, KeyError, ValueError) as error:
        raise _damaged(path, "table.yaml", error) from None


def _damaged(path: Path, name: str, error: Exception) -> ValueError:
    text = " ".join(str(error).split())
    return ValueError(f"table {path}: {name} is damaged ({text}); build it again")


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
        For a table that is missing, damaged, or was built for another scene.
    """
    path = files.user_path(path)
    about = _read_about(path)
    if about["fingerprint"] != scene.fingerprint:
        try:
            theirs = scene_from_settings(about["scene"], about["name"])
        except ValueError as error:
            raise _damaged(path, "table.yaml", error) from None
        why = "; ".join(scene.differences(theirs)) or "its fingerprint does not match its scene"
        raise ValueError(
            f"table {path}: built for another scene than {scene.name}: {why}; "
            "build one for this scene with uuv_array table"
        )
    arrays = []
    for name in ("poses", "parameters"):
        try:
            array = np.load(path / f"{name}.npy", mmap_mode="r")
        except (OSError, ValueError, EOFError) as error:
            raise _damaged(path, f"{name}.npy", error) from None
        if array.shape != (about["rows"], 5) or array.dtype != np.float64:
            raise ValueError(
                f"table {path}: {name}.npy holds {array.dtype} {array.shape}, "
                f"not float64 {(about['rows'], 5)}; build it again"
            )
        arrays.append(array)
    return SignatureTable(scene, *arrays)


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
    path = files.cache_dir() / f"{scene.name}-{scene.fingerprint[:16]}"
    if path.exists():
        try:
            return load_table(path, scene)
        except ValueError:
            shutil.rmtree(path, ignore_errors=True)
    table = build_table(scene, progress=progress)
    try:
        save_table(table, path)
    except (OSError, ValueError):
        return table
    return load_table(path, scene)
