"""Rows of a table that many machines work out chunk by chunk: a Zarr array on a shared disk.

The array (Zarr format 2) has its rows in an order that is known beforehand. So a chunk has its
place and size before anything is computed: who computes it, and when, leaves no trace. A chunk is
one file that appears whole, with a checksum. The attributes say what was computed. A manifest has
the checksums of the headers from the beginning, and of every file once all chunks are there.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage import files, manifest

HEADERS = ".zarray", ".zattrs"
FINISHED = "finished.json"  # what is only known once every chunk is there
_CHUNK_ERRORS = (OSError, ValueError, RuntimeError, TypeError)  # by version and damage


@dataclass(frozen=True)
class ChunkedRows:
    """A float64 array of rows on disk, whole or in part; sent to workers as it is.

    Parameters
    ----------
    path
        Folder of the array, absolute; every worker must see it.
    shape
        Rows and columns.
    chunk_rows
        Rows of a chunk; the last has what is left.
    """

    path: Path
    shape: tuple[int, int]
    chunk_rows: int

    @property
    def chunks(self) -> range:
        """The numbers of the chunks."""
        return range(-(-self.shape[0] // self.chunk_rows))

    def rows(self, chunk: int) -> slice:
        """Return the rows of a chunk."""
        return slice(chunk * self.chunk_rows, min((chunk + 1) * self.chunk_rows, self.shape[0]))

    def create(self, about: Mapping[str, Any]) -> None:
        """Begin the array, with no chunk in it.

        Parameters
        ----------
        about
            Its attributes, plain values.
        """
        zarr, codecs = needs("cluster", "zarr"), needs("cluster", "numcodecs")
        chunks = self.chunk_rows, self.shape[1]
        # Zarr 3 writes no file for a chunk of nothing but the fill value, which no chunk is so.
        layout = {"shape": self.shape, "chunks": chunks, "dtype": "<f8", "fill_value": 0.0}
        # Fast, and nearly halves the file.
        packing = codecs.Zstd(level=1, checksum=True)
        with files.whole_directory(self.path) as scratch:
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
            array.attrs.put(dict(about))
            manifest.write(scratch, HEADERS)

    def about(self, form: int) -> dict[str, Any]:
        """Return the attributes.

        Parameters
        ----------
        form
            The format that is read; the attribute ``format``.

        Raises
        ------
        ValueError
            Where there is nothing, anything else, a damaged header or another format.
        """
        if not self.path.exists():
            raise ValueError(f"table {self.path}: no table there; build one with uuv_array table")
        try:
            if not manifest.read(self.path).keys() >= set(HEADERS):
                raise ValueError("is no table in chunks")
            manifest.check(self.path, HEADERS)
            about: dict[str, Any] = json.loads((self.path / ".zattrs").read_bytes())
            if about["format"] != form:
                raise ValueError(f"format {about['format']}, this version reads {form}")
        except (OSError, ValueError) as error:
            raise manifest.refusal(self.path, error) from None
        return about

    def present(self) -> list[int]:
        """Return the chunks that have a file, whole ones by the way they are written."""
        return [chunk for chunk in self.chunks if (self.path / self._name(chunk)).is_file()]

    def fill(self, chunk: int, compute: Callable[[int], Array]) -> Array:
        """Make sure that a chunk is there; one that is whole is not computed again.

        Parameters
        ----------
        chunk
            Number of the chunk.
        compute
            Takes it to its rows, shape ``(m, columns)``.

        Returns
        -------
        Array
            Its rows.

        Raises
        ------
        ValueError
            On a machine that does not see the folder.
        OSError
            Where it cannot be written.
        """
        if not (self.path / ".zarray").is_file():
            raise ValueError(
                f"table {self.path}: not seen by every worker; name a folder that all share"
            )
        array = needs("cluster", "zarr").open_array(str(self.path), mode="r+")
        try:
            return self._read(array, chunk)
        except _CHUNK_ERRORS:
            rows = compute(chunk)
            with files.naming(self.path):
                array[self.rows(chunk)] = rows
            return rows

    def read(self, chunk: int) -> Array:
        """Read the rows of a chunk.

        Raises
        ------
        ValueError
            Where it is missing or damaged.
        """
        zarr = needs("cluster", "zarr")
        try:
            return self._read(zarr.open_array(str(self.path), mode="r"), chunk)
        except _CHUNK_ERRORS as error:
            raise ValueError(
                f"table {self.path}: chunk {chunk}.0 is damaged "
                f"({' '.join(str(error).split())}); run the same uuv_array table again to mend it"
            ) from None

    def finish(self, known: Mapping[str, Any]) -> None:
        """Keep what is known now that every chunk is there, and the checksums of all files."""
        for left in self.path.glob("*.partial"):  # by Zarr, where its process was killed
            left.unlink(missing_ok=True)
        files.write_text(self.path / FINISHED, json.dumps(dict(known)) + "\n")
        manifest.write(self.path, (*HEADERS, FINISHED, *map(self._name, self.chunks)))

    def finished(self) -> dict[str, Any] | None:
        """Return what `finish` kept, once all files are seen to be whole; ``None`` before it.

        Raises
        ------
        ValueError
            For the first file that is damaged, missing, or does not belong there.
        """
        try:
            listed = manifest.read(self.path)
            if FINISHED not in listed:
                return None
            for name, fault in manifest.faults(self.path).items():
                mend = "run the same uuv_array table again to mend it"
                cure = mend if name in listed else "remove it"
                raise ValueError(f"table {self.path}: {fault}; {cure}")
            return json.loads((self.path / FINISHED).read_bytes())
        except OSError as error:
            raise manifest.refusal(self.path, error) from None

    def drop_damaged(self) -> None:
        """Remove the chunks of a finished array that are not as they were written."""
        if FINISHED in manifest.read(self.path):
            for name in manifest.faults(self.path, map(self._name, self.chunks)):
                (self.path / name).unlink(missing_ok=True)

    def _name(self, chunk: int) -> str:
        return f"{chunk}.0"

    def _read(self, array: Any, chunk: int) -> Array:
        """Read a chunk; its checksum is looked at. A missing one would read as zero."""
        if not (self.path / self._name(chunk)).is_file():
            raise FileNotFoundError("missing")
        return array[self.rows(chunk)]
