"""Where the package's own files lie, and how a file or folder is written whole or not at all."""

import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PACKAGE = "uuv_optical_array"
PART = ".part"  # how the name of what is being written ends


def shared_file(relative: str) -> Path:
    """Find a file of the package: in a checkout, a virtual environment or a ROS workspace.

    Parameters
    ----------
    relative
        Path below the package's share directory, such as ``config/follow.yaml``.

    Returns
    -------
    Path
        The existing file.

    Raises
    ------
    FileNotFoundError
        Where no parent of this module holds the file.
    """
    for parent in Path(__file__).resolve().parents:
        for root in (parent, parent / "share" / PACKAGE):
            if (root / "package.xml").exists() and (root / relative).exists():
                return root / relative
    raise FileNotFoundError(f"{relative}: not found near {__file__}; install the package again")


def cache_dir() -> Path:
    """Return the folder for what can be made again (``XDG_CACHE_HOME``)."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / PACKAGE


def user_path(path: str | Path) -> Path:
    """Return a path as a user writes it, ``~`` being the home; ValueError for an unknown user."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise ValueError(f"{path}: {error}") from None


@contextmanager
def naming(path: Path, scratch: Path | None = None) -> Iterator[None]:
    """Let an OSError of the block that names no file, or one of `scratch`, name `path`."""
    try:
        yield
    except OSError as error:
        named = error.filename
        if named is not None and not (scratch and str(named).startswith(str(scratch))):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a scratch path that becomes `path` when the block ends well, and else vanishes.

    Raises
    ------
    OSError
        With the name of `path`, such as where the disk is full.
    """
    scratch = path.with_name(f".{path.name}{PART}")
    try:
        with naming(path, scratch):
            yield scratch
            os.replace(scratch, path)
    finally:
        scratch.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file as `whole_file` does."""
    with whole_file(path) as scratch:
        scratch.write_text(text, encoding="utf-8")


@contextmanager
def whole_directory(path: Path) -> Iterator[Path]:
    """Yield a scratch folder that becomes `path` when the block ends well, and else vanishes.

    What earlier processes left that were killed in the midst of it is removed.

    Parameters
    ----------
    path
        The folder to make; one that exists is replaced.

    Raises
    ------
    OSError
        With the name of `path`, such as where the disk is full.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(path.parent, path.name)
    with _scratch_directory(path) as scratch, naming(path, scratch):
        yield scratch
        scratch.chmod(0o755)
        if not path.exists():
            scratch.rename(path)
            return
        with _scratch_directory(path) as old:
            path.rename(old / path.name)
            try:
                scratch.rename(path)
            except OSError:
                (old / path.name).rename(path)
                raise


@contextmanager
def _scratch_directory(path: Path) -> Iterator[Path]:
    """Yield a hidden folder beside a path; the lock on it ends with this process at the latest."""
    while True:
        scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=PART, dir=path.parent))
        with suppress(FileNotFoundError):  # another process may remove it before it is locked
            lock = os.open(scratch, os.O_RDONLY)
            with suppress(OSError):  # a file system without locks
                fcntl.flock(lock, fcntl.LOCK_EX)
            if scratch.exists():
                break
            os.close(lock)
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        os.close(lock)


def remove_leftovers(folder: Path, name: str | None = None) -> None:
    """Remove scratch folders of `whole_directory` whose processes have ended.

    Parameters
    ----------
    folder
        Where they are.
    name
        Of the folder that was to be made; ``None``: of any.
    """
    for left in folder.glob(f".{'*' if name is None else glob.escape(name)}.*{PART}"):
        with suppress(OSError):
            lock = os.open(left, os.O_RDONLY)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # fails while its process lives
                shutil.rmtree(left, ignore_errors=True)
            finally:
                os.close(lock)
