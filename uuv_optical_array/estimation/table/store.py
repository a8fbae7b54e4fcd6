"""A signature table built chunk by chunk, `chunks.ChunkedRows` on disk, named ``*.zarr``.

Its rows are the key parameters of every pose of the grid in the grid's order, NaN where there is no
light. So a pose is the number of its row. The attributes hold the scene; once every chunk is there,
the number of rows with light is kept beside them.
"""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.parallel.chunks import ChunkedRows
from uuv_optical_array.core.storage import files, memory
from uuv_optical_array.estimation.table.signature_table import (
    BLOCK_POSES,
    GridPoses,
    SignatureTable,
    check_scene,
    grid_axes,
    no_light,
    signatures,
)
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene

FORMAT = 2
CHUNK_ROWS = 16 * BLOCK_POSES  # 2.6 MB, a fraction of a second's work
# What a thread holds: the chunk, encoded and not, and for each reading of a block the temporaries
# of the forward model.
CHUNK_BYTES, READING_BYTES = 4 * CHUNK_ROWS * 5 * 8, 16 * 8


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
            store._disk.drop_damaged()
            return store
        rows = _on_disk(path, scene).shape[0]
        home = next(parent for parent in path.parents if parent.exists())
        need, free = rows * 5 * 8, shutil.disk_usage(home).free
        if need > free:
            raise ValueError(
                f"table {path}: {rows:,} rows take up to {memory.gigabytes(need)}, and {home} has "
                f"{memory.gigabytes(free)} free; take a coarser grid or another disk"
            )
        compiled = compilation.usable()
        about = {
            "format": FORMAT,
            "fingerprint": scene.fingerprint,
            "name": scene.name,
            "min_peak_counts": min_peak_counts,
            "compiled": compiled,
            "scene": scene.settings(),
        }
        _on_disk(path, scene).create(about)
        return cls(path, scene, min_peak_counts, compiled)

    @classmethod
    def open(cls, path: Path, scene: Scene) -> "TableStore":
        """Open the table of a scene, finished or not.

        Raises
        ------
        ValueError
            Where there is none, that of another scene, or one whose headers are damaged.
        """
        path = path.absolute()
        about = _on_disk(path, scene).about(FORMAT)
        check_scene(path, about, scene)
        return cls(path, scene, float(about["min_peak_counts"]), bool(about["compiled"]))

    @property
    def rows(self) -> int:
        """Poses of the grid, with light or without."""
        return self._grid.shape[0]

    @property
    def chunks(self) -> range:
        """The numbers of the chunks."""
        return self._disk.chunks

    @property
    def _disk(self) -> ChunkedRows:
        return _on_disk(self.path, self.scene)

    @property
    def _grid(self) -> GridPoses:
        return GridPoses(grid_axes(self.scene.table))

    def thread_bytes(self) -> int:
        """Return what a thread that computes chunks holds, bytes."""
        return CHUNK_BYTES + BLOCK_POSES * self.scene.array.detectors_per_side**2 * READING_BYTES

    def present(self) -> list[int]:
        """Return the chunks that have a file, whole ones by the way they are written."""
        return self._disk.present()

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
        parameters = self._disk.fill(chunk, self.compute)
        return int((~np.isnan(parameters[:, 0])).sum())

    def compute(self, chunk: int) -> Array:
        """Compute the key parameters of a chunk's poses, NaN without light, shape ``(m, 5)``."""
        model, rows = ForwardModel(self.scene), self._disk.rows(chunk)
        grid = self._grid
        parameters = np.full((rows.stop - rows.start, 5), np.nan)
        for start in range(0, len(parameters), BLOCK_POSES):
            poses = grid[rows.start + start : min(rows.start + start + BLOCK_POSES, rows.stop)]
            lit, found = signatures(model, poses, self.min_peak_counts, self.compiled)
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
        self._disk.finish({"lit": count})

    def table(self) -> SignatureTable:
        """Read the table into memory, the poses as row numbers.

        Raises
        ------
        ValueError
            For a table that is unfinished, damaged, or too large for this machine.
        """
        known = self._disk.finished()
        if known is None:
            raise ValueError(
                f"table {self.path}: {len(self.present())} of {len(self.chunks)} chunks are there; "
                "run the same uuv_array table again to finish it"
            )
        lit: int = known["lit"]
        if why := memory.shortfall(lit):
            raise ValueError(f"table {self.path}: {why}")
        parameters = np.empty((lit, 5))
        rows = None if lit == self.rows else np.empty(lit, dtype=np.intp)
        kept = 0
        for chunk in self.chunks:
            found = self._disk.read(chunk)
            has_light = ~np.isnan(found[:, 0])
            stop = kept + int(has_light.sum())
            parameters[kept:stop] = found[has_light]
            if rows is not None:
                rows[kept:stop] = self._disk.rows(chunk).start + np.flatnonzero(has_light)
            kept = stop
        return SignatureTable(self.scene, GridPoses(grid_axes(self.scene.table), rows), parameters)


def _on_disk(path: Path, scene: Scene) -> ChunkedRows:
    """Return where the rows of a scene's table lie."""
    rows = GridPoses(grid_axes(scene.table)).shape[0]
    return ChunkedRows(path, (rows, 5), CHUNK_ROWS)
