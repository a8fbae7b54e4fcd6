"""The same functions, compiled by Numba where that is installed (the extra ``fast``).

Numba is imported when something is first compiled, so that nothing else waits for it.
`compiled` copies a function and all functions of this package that it calls, with the helpers of
`elementwise` and some functions of NumPy and SciPy replaced by those of `compiled_math`.
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
from types import CellType, CodeType, FunctionType
from typing import Any

from uuv_optical_array.core.extras import install_line
from uuv_optical_array.core.storage import files

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "arcp"}}
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
    numba, twin, options = _prepared(function, inner=False)
    return numba.njit(no_cfunc_wrapper=True, **options)(twin)


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


@cache
def compiled_inside(function: Callable[..., Any]) -> Any:
    """Return a function compiled to be called from compiled code only."""
    numba, twin, options = _prepared(function, inner=True)
    return numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)(twin)


def _numba() -> Any:
    try:
        return importlib.import_module("numba")
    except ImportError as error:
        raise ValueError(f"compiled: {error}; install Numba: {install_line('fast')}") from None


def _prepared(function: Any, inner: bool) -> tuple[Any, FunctionType, dict[str, Any]]:
    """Return Numba, a copy of a function that calls compiled ones, and the options of ``njit``."""
    package, _, place = function.__module__.partition(".")
    if package == files.PACKAGE and place.partition(".")[0] not in SOURCES:
        raise ValueError(
            f"compiled: {function.__module__}.{function.__qualname__}: a change there would not be "
            f"noticed; move the function to one of {', '.join(SOURCES)}"
        )
    numba = _numba()
    replaced = importlib.import_module(f"{__package__}.compiled_math").REPLACED
    linking = importlib.import_module(f"{__package__}.linked_functions").options(inner)

    def instead(value: Any) -> Any:
        if callable(value) and not isinstance(value, type) and value in replaced:
            return replaced[value]
        ours = isinstance(value, FunctionType) and value.__module__.startswith(files.PACKAGE)
        return compiled_inside(value) if ours else value

    code, mine = function.__code__, dict(function.__globals__)
    mine |= {name: instead(mine[name]) for name in _names(code) & mine.keys()}
    cells = tuple(CellType(instead(cell.cell_contents)) for cell in function.__closure__ or ())
    twin = FunctionType(code, mine, function.__name__, function.__defaults__, cells)
    # A linker takes a function for one of the same name in another file of the cache, so those of
    # one source that call others have names of their own.
    inside = [cell.cell_contents for cell in function.__closure__ or ()]
    calls = [each.__qualname__ for each in inside if isinstance(each, FunctionType)]
    twin.__qualname__ = "_of_".join([function.__qualname__, *calls])
    twin.__module__ = function.__module__
    options = OPTIONS | linking | ({"forceinline": True} if hasattr(function, "inline") else {})
    if hasattr(function, "reorder"):
        options["fastmath"] = options["fastmath"] | {"reassoc"}
    return numba, twin, options


def _names(code: CodeType) -> set[str]:
    inner = (const for const in code.co_consts if isinstance(const, CodeType))
    return set(code.co_names).union(*(_names(const) for const in inner))


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
