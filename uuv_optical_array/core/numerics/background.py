"""Functions compiled in the background, so that nothing waits for the compiler.

Numba's compiler would hold this process up, for the fit by half a minute. So another process fills
Numba's cache on disk, from which a thread then loads what it compiled, in a second at most.
"""

import atexit
import contextlib
import gc
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

from uuv_optical_array.core.numerics import compilation

# It finds the same modules as this process. The environment is inherited as it is: where ROS comes
# as wheels, LD_LIBRARY_PATH and the guard that says so only work together.
CODE = """import sys
sys.path[:] = {path!r}
from {here} import fill_cache
from {module} import {name}
fill_cache({name})"""


def is_compiled(mark: str) -> bool:
    """Say whether what left a mark (see `marked`) has only to be loaded; warn if it is harmed."""
    folder = compilation.cache_folder()
    if folder is None or not (folder / mark).exists():
        return False
    sound = compilation.unharmed(folder)
    if not sound:
        logging.getLogger(__name__).warning(
            "%s: it changed since it was written; it is deleted and compiled again", folder
        )
    return sound


@contextlib.contextmanager
def marked(mark: str) -> Iterator[None]:
    """Leave a mark when all that is compiled within this block is kept on disk.

    OSError where nothing can be kept.
    """
    folder = compilation.cache_folder()
    if folder is None:
        raise OSError(
            "no folder for compiled code that only this user can write; set NUMBA_CACHE_DIR to one"
        )
    collecting = gc.isenabled()
    gc.disable()  # the compiler makes many objects that last: a tenth of its time
    try:
        yield
    finally:
        if collecting:
            gc.enable()
    (folder / mark).touch()


def fill_cache(work: Callable[[], None]) -> None:
    """Compile in a process that ends, at the latest, with the one before it."""

    def end_with_the_other() -> None:
        os.read(sys.stdin.fileno(), 1)  # returns when the pipe's other end is gone
        os._exit(1)

    threading.Thread(target=end_with_the_other, daemon=True).start()
    os.nice(5)  # frames come first
    work()


class BackgroundCompiler:
    """Compiles in the background.

    What is compiled already is loaded at once, unless that takes longer than `load_s`, as it does
    where another process compiles, or another processor compiled it.

    - work: what compiles, or loads, a function of a module, within a block that is `marked`.
    - mark: what it leaves.
    - load_s: longest that this waits for what is compiled already, s.
    - done: whether there is no more to wait for.
    - failure: why what is compiled cannot be used; empty where it can, and while that is not known.
    """

    def __init__(self, work: Callable[[], None], mark: str, load_s: float) -> None:
        self.done, self.failure = False, ""
        self._work = work
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._finish, daemon=True)
        if not compilation.installed():
            self.done, self.failure = True, "Numba is not installed"
            return
        compiled = is_compiled(mark)
        if not compiled:
            self._process = self._compiling()
        atexit.register(self._stop)
        self._thread.start()
        if compiled:
            self._thread.join(load_s)

    def wait(self) -> None:
        """Wait until there is no more to wait for."""
        if not self.done:
            self._thread.join()

    def _compiling(self) -> "subprocess.Popen[str]":
        place = {"module": self._work.__module__, "name": self._work.__name__}
        return subprocess.Popen(
            [sys.executable, "-c", CODE.format(path=sys.path, here=__name__, **place)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",  # a file's name may be of any bytes
            start_new_session=True,  # Ctrl-C in a terminal is for the program
        )

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
        self._thread.join(timeout=2.0)  # it may be loading

    def _finish(self) -> None:
        try:
            failure = "" if self._process is None else self._failure_of(self._process)
            if not failure:
                self._work()
        except Exception as error:  # of any kind: who waits has to hear of it
            failure = f"{type(error).__name__}: {error}"
        self.failure, self.done = failure, True

    @staticmethod
    def _failure_of(process: "subprocess.Popen[str]") -> str:
        """Wait for a process, and return what it failed by."""
        assert process.stderr is not None
        with process:
            errors = process.stderr.read()
        if not process.returncode:
            return ""
        return errors.strip().rpartition("\n")[2] or f"exit code {process.returncode}"
