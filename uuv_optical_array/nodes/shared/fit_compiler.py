"""The fit compiled beside a node, so that no frame waits for the compiler.

Numba's compiler would hold this process up for some ten seconds. A process of its own therefore
compiles and fills Numba's cache on disk, and a thread loads what is there then, which takes half a
second.
"""

import importlib.util
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

# It finds the same modules as this process. The environment is inherited as it is: where ROS comes
# as wheels, LD_LIBRARY_PATH and the guard that says so only work together.
CODE = "import sys; sys.path[:] = {path!r}; from {module} import fill_cache; fill_cache()"
LOADED = threading.Event()  # compiled code belongs to the process, whatever nodes it runs


def load() -> None:
    """Load the compiled fit into this process; what Numba's cache does not hold is compiled.

    Raises
    ------
    OSError
        Where Numba can keep nothing on disk.
    ImportError
        Where Numba is not installed, or not for this NumPy.
    """
    import numpy as np

    from uuv_optical_array.estimation.least_squares import fit_kernel
    from uuv_optical_array.estimation.least_squares.compiled_fit import CompiledFit
    from uuv_optical_array.estimation.least_squares.solver import Prior
    from uuv_optical_array.forward.model import ForwardModel
    from uuv_optical_array.forward.scene import load_scene

    compiled: Any = fit_kernel.descend
    if compiled.stats.cache_path is None:
        raise OSError("Numba finds no folder to keep compiled code in; set NUMBA_CACHE_DIR to one")
    CompiledFit(ForwardModel(load_scene("follow")), Prior(np.zeros(5), np.ones(5), {}))
    LOADED.set()


def fill_cache() -> None:
    """Compile the fit in a process that ends, at the latest, with the one that started it."""

    def end_with_the_other() -> None:
        os.read(sys.stdin.fileno(), 1)  # returns when the pipe's other end is gone
        os._exit(1)

    threading.Thread(target=end_with_the_other, daemon=True).start()
    os.nice(5)  # frames come first
    load()


class FitCompiler:
    """Compiles the fit in the background.

    Parameters
    ----------
    on_done
        Called from a thread when a compilation has ended, well or not.

    Attributes
    ----------
    done : bool
        Whether there is no more to wait for.
    failure : str
        Why the compiled fit cannot be used; empty where it can, and while that is not known.
    """

    def __init__(self, on_done: Callable[[], None]) -> None:
        self.done, self.failure = False, ""
        self._on_done = on_done
        self._stopped = False
        self._process: subprocess.Popen[str] | None = None
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin, unless that was done before."""
        if self._process is not None or self.done:
            return
        if LOADED.is_set():
            self.done = True
        elif importlib.util.find_spec("numba") is None:
            self.done, self.failure = True, "Numba is not installed"
        else:
            self._process = subprocess.Popen(
                [sys.executable, "-c", CODE.format(path=sys.path, module=__name__)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,  # Ctrl-C in a terminal is for the node
            )
            self._thread = threading.Thread(target=self._finish, args=[self._process], daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End what is under way; nothing is called from now on."""
        self._stopped = True
        if self._process is not None and self._thread is not None:
            self._process.kill()
            self._thread.join(timeout=2.0)  # it may be loading

    def _finish(self, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        with process:
            errors = process.stderr.read()
        if self._stopped:
            return
        failure = ""
        if process.returncode:
            failure = errors.strip().rpartition("\n")[2] or f"exit code {process.returncode}"
        else:
            try:
                load()
            except (ImportError, OSError) as error:
                failure = str(error)
        self.failure, self.done = failure, True
        if not self._stopped:
            self._on_done()
