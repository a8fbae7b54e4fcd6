"""The signature table: the key parameters of a grid of poses."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.geometry import Array, lamp_in_body
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.elementwise import transmit
from uuv_optical_array.core.settings import Span
from uuv_optical_array.core.storage import manifest, memory
from uuv_optical_array.estimation.signature.features import key_parameters, lifted, write_parameters
from uuv_optical_array.estimation.signature.spectral_angle import SpectralIndex
from uuv_optical_array.forward.light import COSINE, HALF_SQUARE, RANGE, lamp_light, ray
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.optics import BEAM_ROWS, LIGHT, Optics, detect
from uuv_optical_array.forward.scene import Scene, TableSettings, scene_from_settings

BLOCK_POSES = 4096  # keeps the temporaries of a 5 x 5 array in the cache
BLOCK_READINGS = 25 * BLOCK_POSES  # and those of larger ones
TILE_POSES = 32  # whose rays to a 5 x 5 array stay in the first level of the cache
# Rows of a table from which loading Numba takes less time than it saves.
WORTH_COMPILING = 1_000_000
COARSE_POINTS = 7  # an axis; some 0.1 s of work

Progress = Callable[[Iterable[int]], Iterable[int]]


class GridPoses:
    """The poses of a grid, worked out when they are asked for; indexed by rows, as an array.

    Parameters
    ----------
    axes
        As `grid_axes`.
    rows
        The grid's rows that count, ascending; ``None``: all.
    """

    def __init__(self, axes: list[Array], rows: NDArray[np.intp] | None = None) -> None:
        self._axes = axes
        self._grid = tuple(len(axis) for axis in axes)
        self._rows = rows
        self.shape = (math.prod(self._grid) if rows is None else len(rows), 5)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: Any) -> Array:
        """Return poses, m and rad, shape ``(..., 5)``, for a row, rows, a slice or a mask."""
        count = len(self)
        if isinstance(rows, slice):
            rows = np.arange(*rows.indices(count))
        rows = np.asarray(rows)
        if rows.dtype == bool:
            if rows.shape != (count,):
                raise IndexError(f"a mask of shape {rows.shape} for {count} poses")
            rows = np.flatnonzero(rows)
        if ((rows < -count) | (rows >= count)).any():
            raise IndexError(f"row {rows[(rows < -count) | (rows >= count)][0]} of {count} poses")
        rows = np.where(rows < 0, rows + count, rows).astype(np.intp)
        cells = np.unravel_index(rows if self._rows is None else self._rows[rows], self._grid)
        return np.stack([axis[i] for axis, i in zip(self._axes, cells, strict=True)], axis=-1)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return self[:] if dtype is None else self[:].astype(dtype)


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
    poses: Array | GridPoses
    parameters: Array

    def vectors(self, parameters: ArrayLike) -> Array:
        """Return what is matched, shape ``(..., 6)``, of key parameters, shape ``(..., 5)``."""
        return lifted(parameters, self.scene.signature, self.scene.array.detectors_per_side)

    @cached_property
    def index(self) -> SpectralIndex:
        """The search for the nearest rows, built when it is first asked for."""
        return SpectralIndex(self.vectors(self.parameters))


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
        Where no pose of the grid has light, or this machine has too little memory.
    """
    grid = GridPoses(grid_axes(scene.table))
    rows = grid.shape[0]
    if why := memory.shortfall(rows):
        raise ValueError(f"scene {scene.name}: the table's {why}")
    memory.keep_freed()
    model = ForwardModel(scene)
    compiled = rows > WORTH_COMPILING and compilation.usable()
    poses, parameters = np.empty((rows, 5)), np.empty((rows, 5))
    kept = 0
    size = min(BLOCK_POSES, max(BLOCK_READINGS // model.array.side**2, 1))
    for start in progress(range(0, rows, size)):
        block = grid[start : min(start + size, rows)]
        lit, found = signatures(model, block, min_peak_counts, compiled)
        stop = kept + len(found)
        poses[kept:stop] = block[lit]
        parameters[kept:stop] = found
        kept = stop
    if kept == 0:
        raise no_light(scene, min_peak_counts)
    return SignatureTable(scene, poses[:kept], parameters[:kept])


def coarse_scene(scene: Scene) -> Scene:
    """Return the scene with a grid of at most `COARSE_POINTS` points an axis, of the same extent.

    A table of it answers at once, with a covariance that counts its wider cells.
    """
    spans: dict[str, Span] = {
        field.name: getattr(scene.table, field.name) for field in fields(scene.table)
    }
    coarse = {
        name: span._replace(number=min(span.number, COARSE_POINTS)) for name, span in spans.items()
    }
    return replace(scene, table=TableSettings(**coarse))


def widening(table: SignatureTable, scene: Scene) -> float:
    """Return how many times wider a table's cells are than those of a scene's grid, >= 1.

    By as much the spectral angle from an honest signature to the nearest row grows.
    """
    axes = zip(grid_axes(scene.table), grid_axes(table.scene.table), strict=True)
    return max(1.0, *((len(own) - 1) / max(len(other) - 1, 1) for own, other in axes))


def signatures(
    model: ForwardModel, poses: Array, min_peak_counts: float, compiled: bool = False
) -> tuple[NDArray[np.bool_], Array]:
    """Return which poses have light, shape ``(m,)``, and the key parameters of those.

    Parameters
    ----------
    model
        Forward model of the scene.
    poses
        m and rad, shape ``(m, 5)``.
    min_peak_counts
        A brightest reading below this is no light.
    compiled
        Whether the work is done as Numba compiles it, the same to rounding.
    """
    scene = model.scene
    if not compiled:
        images = model.expected(poses)
        lit = images.max(axis=(1, 2)) >= min_peak_counts
        return lit, key_parameters(images[lit], scene.full_scale_counts, scene.signature.peak)
    parameters = np.empty((5, len(poses)))
    compilation.compiled(write_signatures)(
        model.optics((), True),
        model.saturation_counts,
        np.ascontiguousarray(poses),
        model.array.side,
        float(scene.full_scale_counts),
        scene.signature.peak == "subdetector",
        parameters,
    )
    lit = parameters[0] * scene.full_scale_counts >= min_peak_counts
    return lit, parameters[:, lit].T


def write_signatures(
    optics: Optics,
    saturation_counts: float,
    poses: Array,
    side: int,
    full_scale_counts: float,
    subdetector: bool,
    parameters: Array,
) -> None:
    """Write the key parameters at each pose, one after the other: for compiled code.

    Parameters
    ----------
    optics
        Of the scene, without nuisances.
    saturation_counts
        Largest analogue reading; inf: none.
    poses
        m and rad, shape ``(m, 5)``.
    side, full_scale_counts, subdetector
        As `features.write_parameters` has them.
    parameters
        Result, shape ``(5, m)``.
    """
    n, nothing, tile = side * side, np.empty(0), TILE_POSES
    laws, settings, steps = optics.laws, optics.law_settings, len(optics.step_kinds)
    lamps, rays = np.empty((6, tile)), np.empty((3, n * tile))
    beam = np.empty((BEAM_ROWS + len(laws), n * tile))
    image, found = np.empty((1, n)), np.empty((5, tile))
    # A detector's readings of all poses of the tile lie next to each other.
    light = beam[LIGHT]
    readings = light.reshape(n, tile)
    for first in range(0, len(poses), tile):
        for i in range(tile):
            # The last tile is filled up with its last pose.
            pose = poses[min(first + i, len(poses) - 1)]
            x, y, z, u, v, w = lamp_in_body(pose[0], pose[1], pose[2], pose[3], pose[4], 0.0)
            lamps[0, i], lamps[1, i], lamps[2, i] = x, y, z
            lamps[3, i], lamps[4, i], lamps[5, i] = u, v, w
        write_light(optics.detectors, lamps, optics.power, optics.beam_sigma_rad, rays, light)
        for k in range(len(laws)):
            a, b, c = settings[k, 0], settings[k, 1], settings[k, 2]
            transmit(laws[k], rays, a, b, c, beam, BEAM_ROWS + k, False)
        if steps > 0:
            for i in range(tile):
                for j in range(n):
                    image[0, j] = readings[j, i]
                detect(optics, nothing, image)
                for j in range(n):
                    readings[j, i] = image[0, j]
        for j in range(n * tile):
            light[j] = min(light[j], saturation_counts)
        write_parameters(readings, side, full_scale_counts, subdetector, found)
        for k in range(5):
            for i in range(min(tile, len(poses) - first)):
                parameters[k, first + i] = found[k, i]


def write_light(
    detectors: Array, lamps: Array, power: float, beam_sigma_rad: float, rays: Array, light: Array
) -> None:
    """Write range, half the squared off-axis angle, cosine and light, by detector, then lamp."""
    count = lamps.shape[1]
    for k in range(detectors.shape[1]):
        for i in range(count):
            range_m, half_square, cosine, _, _, _, _, _ = ray(
                detectors[0, k],
                detectors[1, k],
                detectors[2, k],
                detectors[3, k],
                detectors[4, k],
                detectors[5, k],
                lamps[0, i],
                lamps[1, i],
                lamps[2, i],
                lamps[3, i],
                lamps[4, i],
                lamps[5, i],
            )
            j = k * count + i
            rays[RANGE, j], rays[HALF_SQUARE, j], rays[COSINE, j] = range_m, half_square, cosine
    # A loop of its own: of two short ones a processor has more turns under way.
    for j in range(len(light)):
        range_m, half_square, cosine = rays[RANGE, j], rays[HALF_SQUARE, j], rays[COSINE, j]
        light[j], _, _, _, _ = lamp_light(range_m, half_square, cosine, power, beam_sigma_rad)


def no_light(scene: Scene, min_peak_counts: float) -> ValueError:
    """Return the error for a grid that lies in the dark."""
    return ValueError(
        f"scene {scene.name}: no pose of the table has {min_peak_counts:g} count of light; "
        "move the grid into the beam or strengthen the lamp"
    )


def check_scene(path: Path, about: dict[str, Any], scene: Scene) -> None:
    """Refuse the table of another scene, by what differs; ``about`` is what the table says."""
    if about["fingerprint"] == scene.fingerprint:
        return
    try:
        theirs = scene_from_settings(about["scene"], about["name"])
    except ValueError as error:  # of a version with other settings
        raise manifest.refusal(path, error) from None
    why = "; ".join(scene.differences(theirs)) or "its fingerprint does not match its scene"
    raise ValueError(
        f"table {path}: built for another scene than {scene.name}: {why}; "
        "build one for this scene with uuv_array table"
    )
