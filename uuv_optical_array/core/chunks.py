"""Rows of a table that many machines work out chunk by chunk: a Zarr array on a shared disk.

The array (Zarr format 2) has its rows in an order that is known beforehand. So a chunk has its
place and size before anything is computed: who computes it, and when, leaves no trace. A chunk is
one file that appears whole, with a checksum. The attributes say what was computed.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.core import files
from uuv_optical_array.core.geometry import Array

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
            f"{error}; work in chunks needs the extra: pip install 'uuv_optical_array[cluster]'"
        ) from None


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
        zarr, codecs = needs("zarr"), needs("numcodecs")
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

    @contextmanager
    def opening(self, form: int) -> Iterator[dict[str, Any]]:
        """Yield the attributes to a block that judges them; then look at the layout.

        Parameters
        ----------
        form
            The format that is read; the attribute ``format``.

        Raises
        ------
        ValueError
            Where there is nothing, anything else, or another layout; a missing attribute in the
            block counts as damage, and what the block raises under the name of `path` passes.
        """
        named = f"table {self.path}: "
        if not self.path.exists():
            raise ValueError(f"{named}no table there; build one with uuv_array table")
        zarr = needs("zarr")
        try:
            if not (self.path / ".zarray").is_file():
                raise ValueError("no Zarr array")
            array = zarr.open_array(str(self.path), mode="r")
            about = dict(array.attrs)
            if about["format"] != form:
                raise ValueError(f"format {about['format']}, this version reads {form}")
            yield about
            if array.shape != self.shape or array.dtype != np.dtype("<f8"):
                raise ValueError(f"{array.dtype} {array.shape}, not float64 {self.shape}")
            found, expected = (
                (min(rows, self.shape[0]), columns)
                for rows, columns in (array.chunks, (self.chunk_rows, self.shape[1]))
            )
            if found != expected:
                raise ValueError(f"chunks of {found}, not {expected}")
        except (OSError, KeyError, TypeError) as error:
            text = " ".join(str(error).split())
            raise ValueError(
                f"{named}.zarray or .zattrs is damaged ({text}); build it again"
            ) from None
        except ValueError as error:
            if str(error).startswith(named):
                raise
            raise ValueError(f"{named}exists and is no table ({error})") from None

    def present(self) -> list[int]:
        """Return the chunks that have a file, whole ones by the way they are written."""
        return [chunk for chunk in self.chunks if (self.path / f"{chunk}.0").is_file()]

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
        """
        if not (self.path / ".zarray").is_file():
            raise ValueError(
                f"table {self.path}: not seen by every worker; name a folder that all share"
            )
        array = needs("zarr").open_array(str(self.path), mode="r+")
        try:
            return self._read(array, chunk)
        except _CHUNK_ERRORS:
            rows = compute(chunk)
            array[self.rows(chunk)] = rows
            return rows

    def read(self, chunk: int) -> Array:
        """Read the rows of a chunk.

        Raises
        ------
        ValueError
            Where it is missing or damaged.
        """
        try:
            return self._read(needs("zarr").open_array(str(self.path), mode="r"), chunk)
        except _CHUNK_ERRORS as error:
            raise ValueError(
                f"table {self.path}: chunk {chunk}.0 is damaged "
                f"({' '.join(str(error).split())}); run the same uuv_array table again to mend it"
            ) from None

    def attribute(self, name: str) -> Any:
        """Return an attribute, ``None`` where there is none of that name."""
        return needs("zarr").open_array(str(self.path), mode="r").attrs.get(name)

    def mark(self, name: str, value: Any) -> None:
        """Set an attribute; one that has the value is not written again."""
        array = needs("zarr").open_array(str(self.path), mode="r+")
        if array.attrs.get(name) != value:
            array.attrs[name] = value

    def _read(self, array: Any, chunk: int) -> Array:
        """Read a chunk; its checksum is looked at. A missing one would read as zero."""
        if not (self.path / f"{chunk}.0").is_file():
            raise FileNotFoundError("missing")
        return array[self.rows(chunk)]
