"""Detectors in any layout, and the model of their readings.

The forward model and the calibration hold detectors on a square grid. Others fill the first cells
of a grid that is large enough, and the rest of its cells are named as dead.
"""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage import files, tables
from uuv_optical_array.core.storage.formats import csv_text
from uuv_optical_array.forward.array import DetectorArray, build_array
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, scene_from_settings

PLACE, NORMAL, GAIN = ("x_m", "y_m", "z_m"), ("normal_x", "normal_y", "normal_z"), "gain"
COLUMNS = (*PLACE, *NORMAL, GAIN)  # beside the name
FAR_M = 100.0  # of a detector from base_link
# Effects that are of the grid of the scene's own array.
OF_THE_GRID = "responsivity", "detector_faults"
POINT_M = 0.01  # width of the grid that stands for one detector in `Scene.array`


@dataclass(frozen=True)
class Detectors:
    """Detectors of a vehicle in its ``base_link``.

    - names: of each, as columns of readings have them.
    - positions, normals: centres, m, and outward unit normals, shape ``(n, 3)``.
    - gains: relative to each other, > 0, shape ``(n,)``.
    """

    names: tuple[str, ...]
    positions: Array
    normals: Array
    gains: Array


def read_detectors(path: Path) -> Detectors:
    """Read a table with the columns ``name``, `PLACE`, `NORMAL` and perhaps ``gain``.

    Normals may have any length. ValueError, with the line, for any other table; OSError for a file
    that cannot be opened.
    """
    head, table = tables.read(path)
    needed = ("name", *PLACE, *NORMAL)
    if missing := [name for name in needed if name not in head]:
        raise ValueError(
            f"{path}: no column {', '.join(missing)}; a table of detectors has {', '.join(needed)} "
            f"and perhaps {GAIN}"
        )
    names, rows = [], []
    for line, cells in table:
        name = cells["name"]
        if not name or name in names:
            fault = f"{name} is named twice" if name else "no name"
            raise ValueError(f"{path}: line {line}: {fault}; give each detector a name of its own")
        row = [number_in(cells.get(key) or "1", f"{path}: line {line}: {key}") for key in COLUMNS]
        if max(map(abs, row[:3])) > FAR_M:
            raise ValueError(
                f"{path}: line {line}: {row[:3]} is more than {FAR_M:g} m off base_link; positions "
                "are in m"
            )
        if not any(row[3:6]):
            raise ValueError(f"{path}: line {line}: the normal is 0; give the direction of view")
        if row[6] <= 0:
            raise ValueError(f"{path}: line {line}: gain {row[6]:g}; it must be more than 0")
        names.append(name)
        rows.append(row)
    if not rows:
        raise ValueError(f"{path}: no detector below the columns; give one at least")
    values = np.array(rows)
    normals = values[:, 3:6] / np.linalg.norm(values[:, 3:6], axis=1, keepdims=True)
    return Detectors(tuple(names), values[:, :3], normals, values[:, 6])


def number_in(cell: str, where: str) -> float:
    """Return the number of a cell; ValueError, with where it stands, for anything else."""
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{where}: {cell!r} is not a number; give one, with a decimal point")
    return value


def write_detectors(path: Path, detectors: Detectors, comment: str) -> None:
    """Write the table that `read_detectors` reads, below a comment."""
    values = np.column_stack([detectors.positions, detectors.normals, detectors.gains])
    rows = [
        {"name": name, **{key: f"{x:.9g}" for key, x in zip(COLUMNS, row, strict=True)}}
        for name, row in zip(detectors.names, values.tolist(), strict=True)
    ]
    files.write_text(path, f"# {comment}\n{csv_text(('name', *COLUMNS), rows)}")


def of_scene(scene: Scene) -> Detectors:
    """Return the detectors of a scene's own array, named by row and column."""
    array, model = build_array(scene.array), ForwardModel(scene)
    names = tuple(f"{i // array.side}_{i % array.side}" for i in range(array.side**2))
    gains: Array = np.ones(len(names))
    if "responsivity" in scene.effects:
        dark = np.zeros((array.side * scene.lamp_count, array.side))
        gains = (model.on_array(dark + 1.0) - model.on_array(dark)).ravel()[: len(names)]
    return Detectors(names, array.positions, array.normals, gains)


@dataclass(frozen=True)
class Layout:
    """Detectors of a scene on a grid.

    - scene: with an array of one place, so that ``lamp.reference_counts`` is what a detector reads
      that faces the lamp from its axis, and with the lamps, their power and the water of the scene
      that it came from.
    - detectors: as they were given.
    - array: where they are, on the grid.
    """

    scene: Scene
    detectors: Detectors
    array: DetectorArray

    def model(self) -> ForwardModel:
        """Return the forward model of the detectors; cells without one read as the first."""
        model = ForwardModel(self.scene)
        model.array = self.array
        return model

    def images(self, readings: Array) -> Array:
        """Return readings ``(m, L, n)`` as images ``(m, L side, side)``; empty cells read 0."""
        count, lamps, n = readings.shape
        side = self.array.side
        images = np.zeros((count, lamps, side * side))
        images[..., :n] = readings
        return np.asarray(images.reshape(count, lamps * side, side))

    def readings(self, images: Array) -> Array:
        """Return what `images` was made of, or such values as it."""
        n, side = len(self.detectors.names), self.array.side
        return np.asarray(images.reshape(len(images), -1, side * side)[..., :n])

    def with_gains(self, gains: Array) -> Detectors:
        """Return the detectors with the gains of a grid, ``(side, side)``."""
        own = gains.ravel()[: len(self.detectors.names)]
        return dataclasses.replace(self.detectors, gains=own)


def layout_of(scene: Scene, detectors: Detectors) -> Layout:
    """Put detectors in place of a scene's array.

    ValueError for a scene with an effect that is of a grid alone, or out of bounds without it.
    """
    if "forward_scatter" in scene.effects:
        raise ValueError(
            f"scene {scene.name}: effects.forward_scatter needs a square grid; use effects.sea"
        )
    count = len(detectors.names)
    side = max(2, math.ceil(math.sqrt(count)))
    settings = scene.settings()
    effects = settings["effects"]
    for name in OF_THE_GRID:
        effects.pop(name, None)
    settings["array"] = {
        "shape": "planar",
        "detectors_per_side": side,
        "width_m": POINT_M,
        "bow_m": 0.0,
    }
    for key in ("radius_std", "temperature_std_c"):
        settings["prior"][key] = 0.0
    gains = np.ones(side * side)
    gains[:count] = detectors.gains
    if (gains != 1).any():
        effects["responsivity"] = {"gains": gains.reshape(side, side).tolist()}
    if empty := [[*divmod(i, side)] for i in range(count, side * side)]:
        effects["detector_faults"] = {"dead": empty}
    placed = with_power(settings, scene.name, ForwardModel(scene).power)
    cells = np.minimum(np.arange(side * side), count) % count
    array = DetectorArray(
        np.ascontiguousarray(detectors.positions[cells]),
        np.ascontiguousarray(detectors.normals[cells]),
        side,
        POINT_M,
    )
    return Layout(placed, detectors, array)


def on_array_of(scene: Scene, fitted: Scene) -> Scene:
    """Return a scene, with its array, in the light that was fitted to detectors of a `Layout`."""
    settings, light = scene.settings(), fitted.settings()
    before = settings["effects"]
    settings["lamp"] = light["lamp"]
    settings["effects"] = {k: v for k, v in light["effects"].items() if k not in OF_THE_GRID}
    for name in OF_THE_GRID:
        if name in before:
            settings["effects"][name] = before[name]
    if "lamps" in light:
        settings["lamps"] = light["lamps"]
    own = {key: settings["prior"][key] for key in ("radius_std", "temperature_std_c", "gain_std")}
    settings["prior"] = light["prior"] | own
    return with_power(settings, scene.name, ForwardModel(fitted).power)


def with_power(settings: dict[str, Any], name: str, power: float) -> Scene:
    """Return the scene of settings whose lamp has a power, counts m^2."""
    lamp = settings["lamp"]
    unit = ForwardModel(scene_from_settings(settings, name)).power / lamp["reference_counts"]
    lamp["reference_counts"] = float(f"{power / unit:.9g}")
    return scene_from_settings(settings, name)
