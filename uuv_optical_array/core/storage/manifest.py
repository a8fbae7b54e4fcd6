"""Checksums of every file of a folder, so that nothing damaged is read unnoticed.

The file ``SHA256SUMS`` lists the folder's other files as ``sha256sum`` does, below a line with the
digest of the list itself. It is written last.
"""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from uuv_optical_array.core.storage import files

NAME = "SHA256SUMS"
BLOCK_BYTES = 1 << 20


def write(folder: Path, names: Iterable[str]) -> None:
    """List files of a folder with their checksums; a list that is there is replaced.

    Parameters
    ----------
    folder
        The folder.
    names
        Its files that count.
    """
    lines = "".join(f"{_digest(folder / name)}  {name}\n" for name in sorted(names))
    files.write_text(folder / NAME, f"# {_of(lines.encode())}\n{lines}")


def read(folder: Path) -> dict[str, str]:
    """Return the checksum of each file that is listed, SHA-256 in hexadecimal.

    Raises
    ------
    ValueError
        Where the list is missing or damaged.
    OSError
        Where it cannot be read.
    """
    try:
        head, _, lines = (folder / NAME).read_bytes().partition(b"\n")
    except FileNotFoundError:
        raise ValueError(f"{NAME} is missing") from None
    if head != f"# {_of(lines)}".encode():
        raise ValueError(f"{NAME} is damaged")
    pairs = (line.split("  ", 1) for line in lines.decode().splitlines())
    return {name: digest for digest, name in pairs}


def faults(folder: Path, names: Iterable[str] | None = None) -> dict[str, str]:
    """Say what is wrong with each file that is missing, damaged, or not listed.

    Parameters
    ----------
    folder
        The folder.
    names
        Files to look at; ``None``: the whole folder.

    Raises
    ------
    ValueError, OSError
        As `read`, and where a file cannot be read.
    """
    listed = read(folder)
    if names is None:
        names = sorted({NAME, *listed, *(file.name for file in folder.iterdir())} - {NAME})
    found = {}
    for name in names:
        if name not in listed:
            found[name] = f"{name} does not belong there"
        elif not (folder / name).is_file():
            found[name] = f"{name} is missing"
        elif _digest(folder / name) != listed[name]:
            found[name] = f"{name} is damaged"
    return found


def check(folder: Path, names: Iterable[str] | None = None) -> None:
    """Raise ValueError for the first of `faults`."""
    for fault in faults(folder, names).values():
        raise ValueError(fault)


def refusal(folder: Path, error: Exception) -> ValueError:
    """Return the error for a table that is damaged, or not of this version, with its cure."""
    text = " ".join(str(error).split())
    return ValueError(
        f"table {folder}: {text}; name another folder, or delete this one and build it again with "
        "uuv_array table"
    )


def _digest(file: Path) -> str:
    digest = hashlib.sha256()
    with file.open("rb") as stream:
        while block := stream.read(BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()


def _of(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
