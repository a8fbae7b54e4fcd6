"""Where a command writes; it is checked before the work begins, so that no result is lost."""

import argparse
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from uuv_optical_array.cli.options import INTERRUPTED, OptionError, checking_options
from uuv_optical_array.core.storage import files
from uuv_optical_array.core.storage.formats import json_text
from uuv_optical_array.plots.style import KINDS, draw_trial

PICTURE = tuple(KINDS)
SCENE = (".yaml", ".yml")


def add_picture(
    parser: Any, default: str | None, option: str = "--output", about: str = "picture"
) -> None:
    """Add the option that names a picture."""
    about = f"{about}: {_listed(PICTURE)}" + (" (default: %(default)s)" if default else "")
    path = default and Path(default)
    parser.add_argument(*_names(option), type=Path, default=path, metavar="FILE", help=about)


def add_folder(parser: Any, about: str, option: str = "--output") -> None:
    """Add the option that names a folder."""
    parser.add_argument(*_names(option), type=Path, metavar="DIR", help=about)


def _names(option: str) -> tuple[str, ...]:
    return ("-o", option) if option == "--output" else (option,)


def add_scene_file(parser: Any, default: str) -> None:
    """Add the option that names the scene to write."""
    words = {"type": Path, "default": Path(default), "metavar": "FILE"}
    parser.add_argument("-o", "--output", help="scene to write (default: %(default)s)", **words)


def finish(
    args: argparse.Namespace,
    result: Mapping[str, Any],
    text: str,
    complete: bool = True,
    missing: str = "",
) -> int:
    """Print a result, as JSON or as text and what Ctrl-C left `missing`; return the exit code."""
    print(json_text(result) if args.json else text)
    if not complete and not args.json:
        print(f"interrupted: {missing}")
    return 0 if complete else INTERRUPTED


@checking_options()
def file_to_write(path: str | Path, option: str, suffixes: Sequence[str] = ()) -> Path:
    """Return the path, given by an option, of a file that can be written.

    OptionError for another suffix than `suffixes` (empty: any), no file, an unwritable folder, or
    where no `PICTURE` can be drawn.
    """
    path = files.user_path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise OptionError(f"{option} {path}: its name must end in {_listed(suffixes)}")
    if path.is_dir():
        raise OptionError(f"{option} {path}: it is a folder; name a file")
    if path.exists() and not path.is_file():
        raise OptionError(f"{option} {path}: it is a device; name a file")
    # A link stays one: what it leads to is written.
    folder = Path(os.path.realpath(path)).parent if path.is_symlink() else path.parent
    if not folder.is_dir():
        raise OptionError(f"{option} {path}: no folder {folder}; make it first")
    _check_writable(folder, path, option)
    if suffixes == PICTURE:
        draw_trial()
    return path


@checking_options()
def folder_to_write(path: str | Path, option: str, new: bool = False) -> Path:
    """Return the path of a folder that can be written, or made with its parents.

    OptionError where it is a file, cannot be made or written, or exists though it must be new.
    """
    path = files.user_path(path)
    if new and path.exists():
        raise OptionError(f"{option} {path}: it exists; name a new folder")
    home = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    if not home.is_dir():
        raise OptionError(f"{option} {path}: {home} is a file; name a folder")
    _check_writable(home, path, option)
    return path


def _check_writable(folder: Path, path: Path, option: str) -> None:
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"\n")
    except OSError as error:
        reason = f"cannot write in {folder}: {error.strerror}; name another place"
        raise OptionError(f"{option} {path}: {reason}") from None


def _listed(suffixes: Sequence[str]) -> str:
    *others, last = suffixes
    return f"{', '.join(others)} or {last}" if others else last
