"""The signature table: the key parameters of every pose on a grid, built in memory."""

import math
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.background import BackgroundCompiler, is_compiled, marked
from uuv_optical_array.estimation.signature import features
from uuv_optical_array.estimation.signature.features import lifted, parameters_of
from uuv_optical_array.estimation.signature.spectral_angle import SpectralIndex
from uuv_optical_array.forward import many_poses
from uuv_optical_array.forward.many_poses import expected_readings
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, TableSettings, load_scene

BLOCK_POSES = 2048  # keeps what is written of a detector in the processor's cache
BLOCK_READINGS = 1 << 21  # limits the memory of larger arrays
WORTH_LOADING = 100_000  # poses from which that of compiled code takes less time than it saves
DONE, EXAMPLE = "table.done", "reference"  # what is compiled is the same in every scene
LOAD_S = 1.0  # longest that a table waits for what is compiled already
REUSED_BYTES = 1 << 24
MIN_PEAK_COUNTS = 1.0
# A process with an estimator, and what each row adds at the peak: pose, parameters, and the vectors
# and tree of the index. docs/how_to/tables.md has the measurement.
PROCESS_BYTES, ROW_BYTES = 250_000_000, 240
CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")

_ONE = threading.Lock()

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
    rows = np.asarray(rows)
    poses = np.empty((*rows.shape, len(axes)))
    for k in reversed(range(len(axes))):
        above = rows // len(axes[k])  # by a constant, which takes a tenth of np.unravel_index
        poses[..., k] = axes[k][rows - above * len(axes[k])]
        rows = above
    return poses


def pose_blocks(axes: list[Array], rows: range, size: int) -> Iterator[Array]:
    """Yield the poses of rows of a grid, components first, in blocks of up to so many."""
    # The axes that vary within a block repeat themselves, and are copied from a row of them.
    inner, period = len(axes), 1
    while inner and period * len(axes[inner - 1]) <= size:
        inner -= 1
        period *= len(axes[inner])
    pattern = grid_poses(axes[inner:], np.arange(period + size) % period).T.copy()
    for start in range(0, len(rows), size):
        part = rows[start : start + size]
        first, place = divmod(part.start, period)
        outer = grid_poses(axes[:inner], np.arange(first, (part.stop - 1) // period + 1))
        poses = np.empty((len(axes), len(part)))
        poses[:inner] = np.repeat(outer.T, period, axis=1)[:, place : place + len(part)]
        poses[inner:] = pattern[:, place : place + len(part)]
        yield poses


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
    parameters = np.empty((5, len(rows)))  # so that a block is copied by rows
    optics = model.optics()
    detectors = scene.array.detectors_per_side**2
    full_scale = scene.full_scale_counts
    least = (min_peak_counts + scene.lamp_count * model.noise.black) / full_scale
    size = min(BLOCK_POSES, max(BLOCK_READINGS // (scene.lamp_count * detectors), 1))
    blocks = zip(progress(range(0, len(rows), size)), pose_blocks(axes, rows, size), strict=False)
    for start, poses in blocks:
        readings = expected_readings(model, optics, poses.T)
        if scene.lamps:
            readings = readings.reshape(-1, detectors, poses.shape[1]).sum(axis=0)
        found = parameters_of(readings, full_scale, scene.signature.peak)
        found[:, found[0] < least] = np.nan
        parameters[:, start : start + size] = found
    return parameters.T


def compile_tables() -> None:
    """Compile what `grid_parameters` runs in any scene, or load it from disk."""
    with marked(DONE):
        model = ForwardModel(load_scene(EXAMPLE))
        many_poses.prepare(model)
        features.prepare(model.array.side)


@cache
def _table_compiler() -> BackgroundCompiler:
    return BackgroundCompiler(compile_tables, DONE, LOAD_S)


def table_compiler() -> BackgroundCompiler:
    """Return the compiler of tables, one in a process, of several threads too."""
    with _ONE:
        return _table_compiler()


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
    if count >= WORTH_LOADING and is_compiled(DONE):
        table_compiler()
    parameters = grid_parameters(model, range(count), min_peak_counts, progress)
    lit = lit_rows(parameters)
    if not len(lit):
        raise no_light(scene, min_peak_counts)
    if count >= WORTH_LOADING:
        table_compiler()  # for the next one: this one, and the first pose, wait for no compiler
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
