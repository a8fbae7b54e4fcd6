"""The signature table: the key parameters of every pose on a grid, built in memory."""

import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.signature.features import lifted, scene_parameters
from uuv_optical_array.estimation.signature.spectral_angle import SpectralIndex
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, TableSettings

BLOCK_POSES = 4096  # keeps the temporaries of a 5 x 5 array in the processor's cache
BLOCK_READINGS = 25 * BLOCK_POSES  # and those of larger arrays
REUSED_BYTES = 1 << 24
MIN_PEAK_COUNTS = 1.0
# A process with an estimator, and what each row adds at the peak: pose, parameters, and the vectors
# and tree of the index. docs/how_to/tables.md has the measurement.
PROCESS_BYTES, ROW_BYTES = 250_000_000, 240
CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")

Progress = Callable[[Iterable[int]], Iterable[int]]


@dataclass(frozen=True)
class SignatureTable:
    """Poses and their key parameters, row by row.

    - scene: the scene that the table was built from.
    - poses: ``(x, y, z, pitch, yaw)`` in m and rad, shape ``(m, 5)``.
    - parameters: key parameters of each pose, shape ``(m, 5)``; every row has light.
    """

    scene: Scene
    poses: Array
    parameters: Array

    def vectors(self, parameters: ArrayLike) -> Array:
        """Return what is matched, shape ``(..., 6)``, of key parameters, shape ``(..., 5)``."""
        return lifted(parameters, self.scene.signature, self.scene.array.detectors_per_side)

    @cached_property
    def index(self) -> SpectralIndex:
        """The search for the nearest rows, built at its first use."""
        return SpectralIndex(self.vectors(self.parameters))


def grid_axes(settings: TableSettings) -> list[Array]:
    """Return the values along each axis of the table's grid, m and rad, five arrays."""
    axes = []
    for field in fields(settings):
        values = np.linspace(*getattr(settings, field.name))
        axes.append(np.radians(values) if field.name.endswith("_deg") else values)
    return axes


def grid_rows(axes: list[Array]) -> int:
    """Return the number of poses of a grid."""
    return math.prod(len(axis) for axis in axes)


def grid_poses(axes: list[Array], rows: ArrayLike) -> Array:
    """Return poses of a grid, ``(..., 5)``, by their row numbers; the last axis varies fastest."""
    cells = np.unravel_index(np.asarray(rows), [len(axis) for axis in axes])
    return np.stack([axis[i] for axis, i in zip(axes, cells, strict=True)], axis=-1)


def grid_parameters(
    model: ForwardModel,
    rows: range,
    min_peak_counts: float = MIN_PEAK_COUNTS,
    progress: Progress = iter,
) -> Array:
    """Return key parameters of grid rows, as in `build_table`, ``(m, 5)``; NaN where it is dark."""
    scene, axes = model.scene, grid_axes(model.scene.table)
    # glibc keeps the memory of freed arrays up to the size of the largest one that was ever freed.
    # Without this the system gives fresh pages to each block, which takes longer than the block.
    np.empty(REUSED_BYTES, dtype=np.uint8)
    parameters = np.full((len(rows), 5), np.nan)
    size = min(BLOCK_POSES, max(BLOCK_READINGS // scene.array.detectors_per_side**2, 1))
    for start in progress(range(0, len(rows), size)):
        images = model.expected(grid_poses(axes, rows[start : start + size]))
        lit = images.max(axis=(1, 2)) - model.noise.black >= min_peak_counts
        parameters[start : start + size][lit] = scene_parameters(images[lit], scene)
    return parameters


def build_table(
    scene: Scene, min_peak_counts: float = MIN_PEAK_COUNTS, progress: Progress = iter
) -> SignatureTable:
    """Compute the signature of every pose of the scene's grid, free of noise and rounding.

    Parameters
    ----------
    scene
        The scene; its ``table`` gives the grid.
    min_peak_counts
        Poses whose brightest detector stays below this have no signature and are left out.
    progress
        Wraps the loop over blocks of poses, such as ``tqdm.tqdm``.

    Raises
    ------
    ValueError
        Where no pose of the grid has light, or this machine has too little memory.
    """
    model = ForwardModel(scene)
    axes = grid_axes(scene.table)
    count = grid_rows(axes)
    check_memory(count, f"scene {scene.name}")
    parameters = grid_parameters(model, range(count), min_peak_counts, progress)
    lit = lit_rows(parameters)
    if not len(lit):
        raise no_light(scene, min_peak_counts)
    return SignatureTable(scene, grid_poses(axes, lit), parameters[lit])


def lit_rows(parameters: Array) -> NDArray[np.intp]:
    """Return the rows of `grid_parameters` that have light."""
    return np.flatnonzero(~np.isnan(parameters[:, 0]))


def no_light(scene: Scene, min_peak_counts: float = MIN_PEAK_COUNTS) -> ValueError:
    """Return the error for a grid whose poses are all dark."""
    return ValueError(
        f"scene {scene.name}: no pose of the table has {min_peak_counts:g} count of light; "
        "move the grid into the beam or strengthen the lamp"
    )


def memory_bytes(rows: int) -> int:
    """Return the memory that a process with a table of so many rows needs, bytes."""
    return PROCESS_BYTES + ROW_BYTES * rows


def machine_bytes(container_limit: Path = CONTAINER_LIMIT) -> int:
    """Return the memory of this machine, or of the container that this runs in, bytes."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        return min(total, int(container_limit.read_text()))
    except (OSError, ValueError):  # no such file, or ``max`` in it
        return total


def check_memory(rows: int, what: str) -> None:
    """Raise ValueError where this machine cannot hold a table of so many rows and its index."""
    need, have = memory_bytes(rows), machine_bytes()
    if need > have:
        raise ValueError(
            f"{what}: a table of {rows:,} rows needs {gigabytes(need)} of memory, this machine has "
            f"{gigabytes(have)}; take a coarser grid, of at most "
            f"{max(0, have - PROCESS_BYTES) // ROW_BYTES:,} rows"
        )


def gigabytes(count: float) -> str:
    """Return a number of bytes as it is printed."""
    return f"{count / 1e9:.3g} GB"
