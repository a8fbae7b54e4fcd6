"""Where the package's own files lie, and how a file or folder is written whole or not at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PACKAGE = "uuv_optical_array"
PART = ".part"  # how the name of what is being written ends


def shared_file(relative: str) -> Path:
    """Find a file such as ``config/follow.yaml`` in a checkout, an environment or a workspace."""
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


def shown(path: Path) -> str:
    """Return a file's name as it can be drawn and written in UTF-8, whatever its bytes are."""
    return os.fsencode(path.name).decode("utf-8", "replace")


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

    Where it is a link, it stays one, and what it leads to is replaced. OSError, with the name of
    `path`, such as where the disk is full.
    """
    target = Path(os.path.realpath(path))
    scratch = target.with_name(f".{target.name}{PART}")
    try:
        with naming(path, scratch):
            yield scratch
            os.replace(scratch, target)
    finally:
        scratch.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file as `whole_file` does."""
    with whole_file(path) as scratch:
        scratch.write_text(text, encoding="utf-8")


@contextmanager
def whole_directory(path: Path) -> Iterator[Path]:
    """Yield a scratch folder as `whole_file` does a file; missing parents are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as beside:
        scratch = Path(beside, path.name)
        with naming(path, scratch):
            scratch.mkdir()
            yield scratch
            scratch.rename(path)
