"""The same functions, compiled by Numba where that is installed (the extra ``fast``).

Numba is imported when something is first compiled, so that nothing else waits for it.
A function is compiled with all plain functions of this package that it calls; `compiled_math` tells
Numba what these are, and what the helpers of `elementwise` and some functions of SciPy are.
"""

import contextlib
import fcntl
import hashlib
import importlib
import importlib.metadata
import importlib.util
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from uuv_optical_array.core.extras import install_line
from uuv_optical_array.core.storage import files

# Loops over readings become vectors by this, by laws that are inlined and by an exponential without
# a call: a frame of `follow` takes 1.23 times as long without the three, 1.16 to 1.19 times without
# two of them (benchmarks/kernel.py).
FASTMATH = {"contract", "arcp", "reassoc"}
SOURCES = ("core", "forward", "estimation")  # the folders whose functions may be compiled
KEPT = 8  # caches of other versions of the package that are left on disk
SUM, TURN = "sha256", "turn"  # beside Numba's folders: their sum, and the lock of who uses them


def installed() -> bool:
    """Say whether Numba is there, without importing it."""
    return importlib.util.find_spec("numba") is not None


@cache
def compiled(function: Callable[..., Any]) -> Any:
    """Return a function of the package as Numba compiles it at its first call, for this process.

    ValueError where Numba is not installed, or not for this NumPy.
    """
    if function.__module__.startswith(files.PACKAGE) and not is_source(function):
        raise ValueError(
            f"compiled: {function.__module__}.{function.__qualname__}: a change there would not be "
            f"noticed; move the function to one of {', '.join(SOURCES)}"
        )
    return _numba().njit(**options(function, inner=False))(function)


def is_source(function: Callable[..., Any]) -> bool:
    """Say whether a function is one of the package's that may be compiled."""
    package, _, place = function.__module__.partition(".")
    return package == files.PACKAGE and place.partition(".")[0] in SOURCES


def prepare(function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """Return a function compiled, or loaded from disk, for arguments of these types.

    It is called with them once. Of processes that do so at the same time one compiles, and the
    others load what it left on disk, once they found it unharmed; else the first of them compiles
    it anew. From then on `loaded` returns the compiled function, too.
    """
    ready, folder = compiled(function), cache_folder()
    if folder is None or ready.signatures:
        ready(*arguments)
    else:
        with _alone_with(folder), _kept(ready, folder):
            ready(*arguments)
            if ready.stats.cache_misses:
                files.write_text(folder / SUM, _sum(folder))
    _LOADED[function] = ready
    return ready


def entry(ready: Any, *arguments: Any) -> Callable[..., Any]:
    """Return what calls a function that `prepare` returned without looking up the arguments' types.

    To look them up takes 5 of the 7 us in which Numba hands over the 43 arrays and numbers of a
    problem, and makes a frame 1.07 times as long. Those given later have to have the types and
    layouts of these: nothing checks it.
    """
    types = tuple(_numba().typeof(argument) for argument in arguments)
    function: Callable[..., Any] = ready.overloads[types].entry_point
    return function


_LOADED: dict[Callable[..., Any], Any] = {}
_SETTING = threading.Lock()


@contextlib.contextmanager
def _kept(ready: Any, folder: Path) -> Iterator[None]:
    """Let Numba look for a function on disk, and keep it there, within this block alone."""
    config = _numba().config
    with _SETTING:
        before = config.CACHE_DIR
        config.CACHE_DIR = str(folder)
        try:
            ready.enable_caching()
        finally:
            config.CACHE_DIR = before
    try:
        yield
    finally:
        ready._cache.disable()


@contextlib.contextmanager
def _alone_with(folder: Path) -> Iterator[None]:
    """Let one process at a time use a folder; what is not as it was written is deleted first."""
    with (folder / TURN).open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        if not unharmed(folder):
            for path in folder.iterdir():
                if path.is_dir():
                    shutil.rmtree(path)
                elif path.name != TURN:
                    path.unlink()
        yield


def unharmed(folder: Path) -> bool:
    """Say whether what Numba keeps in a folder is as it was written, by its SHA-256.

    It has no checksum of its own, and runs the code that it finds.
    """
    kept = folder / SUM
    try:
        return (kept.read_bytes() if kept.exists() else b"") == _sum(folder).encode()
    except FileNotFoundError:  # deleted meanwhile
        return False


def _sum(folder: Path) -> str:
    """Return the sum of names and contents; empty where there are none."""
    digest, paths = hashlib.sha256(), sorted(folder.glob("*/*"))
    for path in paths:
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder)} {len(content)} ".encode() + content)
    return digest.hexdigest() if paths else ""


def loaded(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function as compiled where `prepare` was called for it, else as it stands."""
    return _LOADED.get(function, function)


def for_callers(function: Callable[..., Any]) -> Any:
    """Return a function as compiled code calls it: as `prepare` compiled it, or only inside."""
    return _LOADED.get(function) or _compiled_inside(function)


@cache
def _compiled_inside(function: Callable[..., Any]) -> Any:
    return _numba().njit(**options(function, inner=True))(function)


@cache
def _numba() -> Any:
    """Import Numba, and tell it what functions of this package are in compiled code."""
    try:
        numba = importlib.import_module("numba")
    except ImportError as error:
        raise ValueError(f"compiled: {error}; install Numba: {install_line('fast')}") from None
    importlib.import_module(f"{__package__}.compiled_math")
    return numba


def options(function: Callable[..., Any], inner: bool) -> dict[str, Any]:
    """Return the options of Numba's ``njit`` for a function."""
    given: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": FASTMATH}
    given |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": inner}
    if hasattr(function, "inline"):
        # A law makes no array, and so counts no references to those that it is given.
        given |= {"forceinline": True, "_nrt": False}
    return given | importlib.import_module(f"{__package__}.linked_functions").options(inner)


def _own(status: os.stat_result) -> bool:
    return status.st_uid == os.geteuid() and not status.st_mode & 0o022


@cache
def cache_folder() -> Path | None:
    """Return this user's folder of what was compiled from these sources.

    It is in ``NUMBA_CACHE_DIR`` or the user's cache; ``None`` where it cannot be this user's alone.
    Numba looks only at a function's own file, whether it is elsewhere or newer, not at what that
    calls. So a folder is for these sources, their places and times, this Python and this Numba.
    """
    digest = hashlib.sha256(f"{sys.implementation.cache_tag} {os.geteuid()}".encode())
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        digest.update(importlib.metadata.version("numba").encode())
    package = Path(importlib.import_module(files.PACKAGE).__path__[0])
    for source in sorted(path for folder in SOURCES for path in (package / folder).rglob("*.py")):
        digest.update(f"{source} {source.stat().st_mtime_ns}".encode() + source.read_bytes())
    given = os.environ.get("NUMBA_CACHE_DIR")
    home = (Path(given) if given else files.cache_dir()) / "compiled"
    folder = home / digest.hexdigest()[:16]
    try:
        home.mkdir(parents=True, exist_ok=True)
        home.chmod(0o700)
        if folder.exists() and not _own(folder.lstat()):
            shutil.rmtree(folder)
        folder.mkdir(mode=0o700, exist_ok=True)
        os.utime(folder)
    except OSError:
        return None
    with contextlib.suppress(OSError):  # where another process tidies up too
        others = sorted(home.iterdir(), key=lambda path: -path.stat().st_mtime)
        for stale in others[KEPT:]:
            shutil.rmtree(stale, ignore_errors=True)
    return folder
