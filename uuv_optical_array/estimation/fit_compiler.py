"""The fit compiled in the background, so that no frame waits for the compiler.

Numba's compiler would hold this process up for half a minute. So another process fills Numba's
cache on disk, from which a thread then loads the fit in a second.
"""

import atexit
import gc
import logging
import os
import subprocess
import sys
import threading
from functools import cache

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.least_squares.image_fit import ImageFit
from uuv_optical_array.estimation.unknowns.constants import constants_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

# It finds the same modules as this process. The environment is inherited as it is: where ROS comes
# as wheels, LD_LIBRARY_PATH and the guard that says so only work together.
CODE = """import sys
sys.path[:] = {path!r}
from {module} import fill_cache
fill_cache()"""
LOAD_S = 5.0  # longest that an estimator waits for what is compiled already
DONE, EXAMPLE = "fit.done", "reference"  # it is the same in every scene


def is_compiled() -> bool:
    """Say whether `compile_fit` has only to load what it finds on disk; warn if harmed."""
    folder = compilation.cache_folder()
    if folder is None or not (folder / DONE).exists():
        return False
    sound = compilation.unharmed(folder)
    if not sound:
        logging.getLogger(__name__).warning(
            "%s: not as it was written; deleted, and the fit is compiled anew", folder
        )
    return sound


def compile_fit() -> None:
    """Compile what ``least_squares`` runs in any scene, or load it from disk."""
    folder = compilation.cache_folder()
    if folder is None:
        raise OSError(
            "no folder to keep compiled code in that this user alone can write; set "
            "NUMBA_CACHE_DIR to one"
        )
    model = ForwardModel(load_scene(EXAMPLE))
    ImageFit(model, constants_of(model), candidates=1, max_misfit=0.5, compiled=True)
    (folder / DONE).touch()


def fill_cache() -> None:
    """Compile the fit in a process that ends, at the latest, with the one before it."""

    def end_with_the_other() -> None:
        os.read(sys.stdin.fileno(), 1)  # returns when the pipe's other end is gone
        os._exit(1)

    threading.Thread(target=end_with_the_other, daemon=True).start()
    os.nice(5)  # frames come first
    gc.disable()  # the compiler makes many objects, and the process ends soon: a tenth of its time
    compile_fit()


class FitCompiler:
    """Compiles the fit in the background.

    What is compiled already is loaded at once, unless that takes longer than `LOAD_S`, as it does
    where another processor compiled it.

    - done: whether there is no more to wait for.
    - failure: why the compiled fit cannot be used; empty where it can, and while that is not known.
    """

    def __init__(self) -> None:
        self.done, self.failure = False, ""
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._finish, daemon=True)
        if not compilation.installed():
            self.done, self.failure = True, "Numba is not installed"
            return
        compiled = is_compiled()
        if not compiled:
            self._process = self._compiling()
        atexit.register(self._stop)
        self._thread.start()
        if compiled:
            self._thread.join(LOAD_S)

    def wait(self) -> None:
        """Wait until there is no more to wait for."""
        if not self.done:
            self._thread.join()

    def _compiling(self) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            [sys.executable, "-c", CODE.format(path=sys.path, module=__name__)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C in a terminal is for the program
        )

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
        self._thread.join(timeout=2.0)  # it may be loading

    def _finish(self) -> None:
        failure = ""
        if self._process is not None:
            assert self._process.stderr is not None
            with self._process as process:
                errors = self._process.stderr.read()
            if process.returncode:
                failure = errors.strip().rpartition("\n")[2] or f"exit code {process.returncode}"
        if not failure:
            try:
                compile_fit()
            except Exception as error:  # of any kind: who waits has to hear of it
                failure = f"{type(error).__name__}: {error}"
        self.failure, self.done = failure, True


@cache
def fit_compiler() -> FitCompiler:
    """Return the compiler of the fit, one in a process."""
    return FitCompiler()
