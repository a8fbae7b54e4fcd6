"""The fit compiled in the background, so that no frame waits for the compiler.

Numba's compiler would hold this process up for a minute or two. A process of its own therefore
compiles and fills Numba's cache on disk, and a thread loads what is there then, which takes a
second.
"""

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.estimator import Estimator, Method
from uuv_optical_array.estimation.table.signature_table import SignatureTable
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, scene_from_settings

# It finds the same modules as this process. The environment is inherited as it is: where ROS comes
# as wheels, LD_LIBRARY_PATH and the guard that says so only work together.
CODE = """import sys
sys.path[:] = {path!r}
from {module} import fill_cache
fill_cache({settings!r})"""
LOAD_S = 5.0  # longest that a node waits for what is compiled
LOADED: set[str] = set()  # compiled code belongs to the process, whatever nodes it runs


def compiled_parts(scene: Scene) -> str:
    """Name what of the compiled fit depends on the scene: the laws of its effects."""
    return "-".join(
        ["fit", *sorted({law.__qualname__ for law in ForwardModel(scene).optics().laws})]
    )


def is_compiled(scene: Scene) -> bool:
    """Say whether `compile_fit` has only to load what it finds on disk."""
    folder = compilation.cache_folder()
    return folder is not None and (folder / compiled_parts(scene)).exists()


def compile_fit(scene: Scene) -> None:
    """Compile what ``least_squares`` runs in a scene, or load it from disk.

    Parameters
    ----------
    scene
        The scene; what it does not name is not compiled.

    Raises
    ------
    ValueError
        Where Numba is not installed, or not for this NumPy.
    OSError
        Where there is no folder to keep compiled code in.
    """
    folder = compilation.cache_folder()
    if folder is None:
        raise OSError("no folder to keep compiled code in; set NUMBA_CACHE_DIR to one")
    poses = np.zeros((2, 5))
    poses[:, 0] = -scene.lamp.reference_range_m, -2 * scene.lamp.reference_range_m
    Estimator(SignatureTable(scene, poses, np.ones((2, 5))), compiled=True)
    (folder / compiled_parts(scene)).touch()


def fill_cache(settings: dict[str, Any]) -> None:
    """Compile the fit of a scene in a process that ends, at the latest, with the one before it."""

    def end_with_the_other() -> None:
        os.read(sys.stdin.fileno(), 1)  # returns when the pipe's other end is gone
        os._exit(1)

    threading.Thread(target=end_with_the_other, daemon=True).start()
    os.nice(19)  # frames come first
    compile_fit(scene_from_settings(settings, "scene"))


class FitCompiler:
    """Compiles the fit in the background.

    Parameters
    ----------
    scene
        Whose fit it is.
    on_done
        Called from a thread when a compilation has ended, well or not.

    Attributes
    ----------
    done : bool
        Whether there is no more to wait for.
    failure : str
        Why the compiled fit cannot be used; empty where it can, and while that is not known.
    """

    def __init__(self, scene: Scene, on_done: Callable[[], None]) -> None:
        self.done, self.failure = False, ""
        self._scene, self._on_done = scene, on_done
        self._stopped = False
        self._process: subprocess.Popen[str] | None = None
        self._thread: threading.Thread | None = None

    def load(self) -> None:
        """Load the fit now where it is compiled already, while no frame waits yet.

        What takes longer than `LOAD_S` goes on in the background: Numba compiles anew what another
        processor compiled.
        """
        if not self.done and compilation.installed() and is_compiled(self._scene):
            self.start()
            if self._thread is not None:
                self._thread.join(LOAD_S)

    def start(self) -> None:
        """Begin, unless that was done before."""
        if self._thread is not None or self.done:
            return
        if compiled_parts(self._scene) in LOADED:
            self.done = True
        elif not compilation.installed():
            self.done, self.failure = True, "Numba is not installed"
        else:
            self._thread = threading.Thread(target=self._finish, daemon=True)
            if not is_compiled(self._scene):
                self._process = self._compiling()
            self._thread.start()

    def estimator(self, table: SignatureTable, **settings: Any) -> Estimator:
        """Return the best estimator that there is by now: a quick one until the fit is compiled.

        Parameters
        ----------
        table
            Of the scene.
        settings
            As `Estimator` takes them by name.
        """
        compiled = self.done and not self.failure
        made = Estimator(table, **settings, compiled=compiled, quick=not self.done)
        if compiled and made.settings.method == "least_squares":
            _ = made.linear  # by some fits, which the first frame would wait for
        return made

    def _compiling(self) -> "subprocess.Popen[str]":
        settings = self._scene.settings()
        code = CODE.format(path=sys.path, module=__name__, settings=settings)
        return subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C in a terminal is for the node
        )

    def stop(self) -> None:
        """End what is under way; nothing is called from now on."""
        self._stopped = True
        if self._process is not None:
            self._process.kill()
        if self._thread is not None:
            self._thread.join(timeout=2.0)  # it may be loading

    def _finish(self) -> None:
        failure = ""
        if self._process is not None:
            assert self._process.stderr is not None
            with self._process as process:
                errors = self._process.stderr.read()
            if process.returncode:
                failure = errors.strip().rpartition("\n")[2] or f"exit code {process.returncode}"
        if self._stopped:
            return
        self.failure, self.done = failure or self._load(), True
        if not self._stopped:
            self._on_done()

    def _load(self) -> str:
        """Load what is on disk; return why that failed."""
        try:
            compile_fit(self._scene)
            LOADED.add(compiled_parts(self._scene))
        except (ValueError, OSError) as error:
            return str(error)
        return ""


class ReadyEstimator:
    """Has an estimator at once: a quick one until the fit is compiled.

    Parameters
    ----------
    table, method
        As of `Estimator`.
    """

    def __init__(self, table: SignatureTable, method: Method) -> None:
        self._table, self._method = table, method
        self._compiler = FitCompiler(table.scene, lambda: None)
        self._compiler.load()
        self._compiler.start()
        self._make()

    def _make(self) -> None:
        self._done = self._compiler.done  # first, as it may change meanwhile
        self._estimator = self._compiler.estimator(self._table, method=self._method)

    def __call__(self) -> Estimator:
        """Return the best estimator that there is by now."""
        if self._compiler.done and not self._done:
            self._make()
        return self._estimator

    def stop(self) -> None:
        """End what is under way."""
        self._compiler.stop()
