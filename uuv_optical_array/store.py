"""A signature table built chunk by chunk: a Zarr array that many machines fill.

The store is one Zarr array (format 2), named ``*.zarr``: the key parameters of every pose of the
grid in the grid's order, NaN where there is no light. So a pose is the number of its row, and a
chunk has its place and size before anything is computed: who computes it, and when, leaves no
trace. A chunk is one file that appears whole, with a checksum. The attributes hold the scene and,
once every chunk is there, the number of rows with light.
"""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array import files, memory
from uuv_optical_array.bulk import worthwhile
from uuv_optical_array.image import ForwardModel
from uuv_optical_array.pose import Array
from uuv_optical_array.scene import Scene
from uuv_optical_array.table import (
    BLOCK_POSES,
    GridPoses,
    SignatureTable,
    check_scene,
    damaged,
    grid_axes,
    no_light,
    signatures,
)

FORMAT = 1
CHUNK_ROWS = 16 * BLOCK_POSES  # 2.6 MB, a fraction of a second's work
# What a thread holds: the chunk, encoded and not, and for each reading of a block the temporaries
# of the forward model.
CHUNK_BYTES, READING_BYTES = 4 * CHUNK_ROWS * 5 * 8, 16 * 8

_CHUNK_ERRORS = (OSError, ValueError, RuntimeError, TypeError)  # by version and damage


def needs(module: str) -> Any:
    """Import what only the extra ``cluster`` installs.

    Raises
    ------
    ValueError
        Where it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ValueError(
            f"{error}; tables in chunks need the extra: pip install 'uuv_optical_array[cluster]'"
        ) from None


def is_store(path: Path) -> bool:
    """Say whether a folder is such a store, or is named as one."""
    return path.suffix == ".zarr" or (path / ".zarray").is_file()


@dataclass(frozen=True)
class TableStore:
    """A table on disk, finished or not; sent to workers as it is.

    Parameters
    ----------
    path
        Folder of the store, absolute; every worker must see it.
    scene
        The scene.
    min_peak_counts
        As in `table.build_table`.
    compiled
        Whether Numba's kernel does the work, which changes the last bits; the same on all workers.
    """

    path: Path
    scene: Scene
    min_peak_counts: float
    compiled: bool

    @classmethod
    def create(cls, path: str | Path, scene: Scene, min_peak_counts: float = 1.0) -> "TableStore":
        """Open the unfinished or finished table of a scene, or begin one.

        Parameters
        ----------
        path
            Folder, its name ending in ``.zarr``.
        scene
            The scene; its ``table`` gives the grid.
        min_peak_counts
            As in `table.build_table`.

        Raises
        ------
        ValueError
            Where `path` holds anything else, or the table of another scene, or the disk is full.
        """
        path = files.user_path(path).absolute()
        if path.suffix != ".zarr":
            raise ValueError(f"table {path}: built in chunks it is a Zarr store; name it *.zarr")
        if path.exists():
            store = cls.open(path, scene)
            if store.min_peak_counts != min_peak_counts:
                raise ValueError(
                    f"table {path}: begun with min_peak_counts {store.min_peak_counts:g}, "
                    f"not {min_peak_counts:g}; name another folder"
                )
            return store
        zarr, codecs = needs("zarr"), needs("numcodecs")
        readings = scene.array.detectors_per_side**2
        rows = GridPoses(grid_axes(scene.table)).shape[0]
        home = next(parent for parent in path.parents if parent.exists())
        need, free = rows * 5 * 8, shutil.disk_usage(home).free
        if need > free:
            raise ValueError(
                f"table {path}: {rows:,} rows take up to {memory.gigabytes(need)}, and {home} has "
                f"{memory.gigabytes(free)} free; take a coarser grid or another disk"
            )
        compiled = worthwhile(rows * readings)
        about = {
            "format": FORMAT,
            "fingerprint": scene.fingerprint,
            "name": scene.name,
            "min_peak_counts": min_peak_counts,
            "compiled": compiled,
            "scene": scene.settings(),
        }
        # Zarr 3 writes no file for a chunk of nothing but the fill value, which no chunk is so.
        layout = {"shape": (rows, 5), "chunks": (CHUNK_ROWS, 5), "dtype": "<f8", "fill_value": 0.0}
        # Fast, and nearly halves the file.
        packing = codecs.Zstd(level=1, checksum=True)
        with files.whole_directory(path) as scratch:
            if zarr.__version__.startswith("2."):
                array = zarr.open_array(str(scratch), mode="w", compressor=packing, **layout)
            else:
                array = zarr.create_array(
                    str(scratch),
                    zarr_format=2,
                    filters=None,
                    compressors=packing,
                    overwrite=True,
                    **layout,
                )
            array.attrs.put(about)
        return cls(path, scene, min_peak_counts, compiled)

    @classmethod
    def open(cls, path: Path, scene: Scene) -> "TableStore":
        """Open the table of a scene, finished or not.

        Raises
        ------
        ValueError
            Where there is none, or that of another scene.
        """
        path = path.absolute()
        if not path.exists():
            raise ValueError(f"table {path}: no table there; build one with uuv_array table")
        try:
            if not (path / ".zarray").is_file():
                raise ValueError("no Zarr array")
            array = needs("zarr").open_array(str(path), mode="r")
            about = dict(array.attrs)
            if about["format"] != FORMAT:
                raise ValueError(f"format {about['format']}, this version reads {FORMAT}")
            check_scene(path, about, scene)
            store = cls(path, scene, float(about["min_peak_counts"]), bool(about["compiled"]))
            chunks = min(CHUNK_ROWS, store.rows), 5
            if array.shape != (store.rows, 5) or array.dtype != np.dtype("<f8"):
                raise ValueError(f"{array.dtype} {array.shape}, not float64 {(store.rows, 5)}")
            if (min(array.chunks[0], store.rows), array.chunks[1]) != chunks:
                raise ValueError(f"chunks of {array.chunks}, not {(CHUNK_ROWS, 5)}")
        except (OSError, KeyError, TypeError) as error:
            raise damaged(path, ".zarray or .zattrs", error) from None
        except ValueError as error:
            if str(error).startswith("table "):
                raise
            if isinstance(error.__cause__, ImportError) or "extra" in str(error):
                raise
            raise ValueError(f"table {path}: exists and is no table ({error})") from None
        return store

    @property
    def rows(self) -> int:
        """Poses of the grid, with light or without."""
        return self._grid.shape[0]

    @property
    def chunks(self) -> range:
        """The numbers of the chunks."""
        return range(-(-self.rows // CHUNK_ROWS))

    @property
    def _grid(self) -> GridPoses:
        return GridPoses(grid_axes(self.scene.table))

    def thread_bytes(self) -> int:
        """Return what a thread that computes chunks holds, bytes."""
        return CHUNK_BYTES + BLOCK_POSES * self.scene.array.detectors_per_side**2 * READING_BYTES

    def present(self) -> list[int]:
        """Return the chunks that have a file, whole ones by the way they are written."""
        return [chunk for chunk in self.chunks if (self.path / f"{chunk}.0").is_file()]

    def fill(self, chunk: int) -> int:
        """Make sure that a chunk is there; one that is whole is not computed again.

        Parameters
        ----------
        chunk
            Number of the chunk.

        Returns
        -------
        int
            Its rows with light.

        Raises
        ------
        ValueError
            On a machine that does not see the store, or computes in another way.
        """
        if not (self.path / ".zarray").is_file():
            raise ValueError(
                f"table {self.path}: not seen by every worker; name a folder that all share"
            )
        array = needs("zarr").open_array(str(self.path), mode="r+")
        try:
            parameters = self._read(array, chunk)
        except _CHUNK_ERRORS:
            parameters = self.compute(chunk)
            array[self._rows(chunk)] = parameters
        return int((~np.isnan(parameters[:, 0])).sum())

    def compute(self, chunk: int) -> Array:
        """Compute the key parameters of a chunk's poses, NaN without light, shape ``(m, 5)``."""
        model, grid, rows = ForwardModel(self.scene, self.compiled), self._grid, self._rows(chunk)
        parameters = np.full((rows.stop - rows.start, 5), np.nan)
        for start in range(0, len(parameters), BLOCK_POSES):
            poses = grid[rows.start + start : min(rows.start + start + BLOCK_POSES, rows.stop)]
            lit, found = signatures(model, poses, self.min_peak_counts)
            parameters[start : start + BLOCK_POSES][lit] = found
        return parameters

    def finish(self, lit: Iterable[int]) -> None:
        """Mark the table as finished, given the rows with light of each chunk.

        Raises
        ------
        ValueError
            Where no pose has light.
        """
        count = sum(lit)
        if count == 0:
            raise no_light(self.scene, self.min_peak_counts)
        array = needs("zarr").open_array(str(self.path), mode="r+")
        if array.attrs.get("lit") != count:
            array.attrs["lit"] = count

    def table(self) -> SignatureTable:
        """Read the table into memory, the poses as row numbers.

        Raises
        ------
        ValueError
            For a table that is unfinished, damaged, or too large for this machine.
        """
        array = needs("zarr").open_array(str(self.path), mode="r")
        lit = array.attrs.get("lit")
        if lit is None:
            raise ValueError(
                f"table {self.path}: {len(self.present())} of {len(self.chunks)} chunks are there; "
                "run the same uuv_array table again to finish it"
            )
        if why := memory.shortfall(lit):
            raise ValueError(f"table {self.path}: {why}")
        parameters = np.empty((lit, 5))
        rows = None if lit == self.rows else np.empty(lit, dtype=np.intp)
        kept = 0
        for chunk in self.chunks:
            try:
                found = self._read(array, chunk)
                has_light = ~np.isnan(found[:, 0])
                stop = kept + int(has_light.sum())
                parameters[kept:stop] = found[has_light]
            except _CHUNK_ERRORS as error:
                raise ValueError(
                    f"table {self.path}: chunk {chunk}.0 is damaged ({' '.join(str(error).split())}"
                    "); run the same uuv_array table again to mend it"
                ) from None
            if rows is not None:
                rows[kept:stop] = self._rows(chunk).start + np.flatnonzero(has_light)
            kept = stop
        if kept != lit:
            raise ValueError(f"table {self.path}: {kept} rows have light, not {lit}; build again")
        return SignatureTable(self.scene, GridPoses(grid_axes(self.scene.table), rows), parameters)

    def _rows(self, chunk: int) -> slice:
        return slice(chunk * CHUNK_ROWS, min((chunk + 1) * CHUNK_ROWS, self.rows))

    def _read(self, array: Any, chunk: int) -> Array:
        """Read a chunk; its checksum is looked at. A missing one would read as dark."""
        if not (self.path / f"{chunk}.0").is_file():
            raise FileNotFoundError("missing")
        return array[self._rows(chunk)]
