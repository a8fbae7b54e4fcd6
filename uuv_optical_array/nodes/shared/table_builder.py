"""The scene's table built beside a node, so that no frame waits for it.

A thread will do: NumPy works without the interpreter's lock, and a frame meanwhile waits some
milliseconds at most.
"""

import threading
from collections.abc import Callable, Iterable, Iterator

from uuv_optical_array.estimation.table.disk import cached_table, open_cached
from uuv_optical_array.estimation.table.signature_table import (
    SignatureTable,
    build_table,
    coarse_scene,
)
from uuv_optical_array.forward.scene import Scene

BUILDING = "building the signature table, once on a machine: until then a coarse one answers"


class TableBuilder:
    """Has the scene's table from the user's cache, and builds it in the background.

    Parameters
    ----------
    scene
        The scene.
    on_done
        Called from a thread when a table has been built, or could not be.

    Attributes
    ----------
    failure : str
        Why the last table could not be built; empty where it could, and while that is not known.
    """

    def __init__(self, scene: Scene, on_done: Callable[[], None]) -> None:
        self._scene, self._on_done = scene, on_done
        self._table: SignatureTable | None = None
        self._coarse: SignatureTable | None = None
        self.failure = self._damage = ""
        self._stopped = False
        self._thread: threading.Thread | None = None

    def table(self) -> SignatureTable:
        """Return the table, or a coarse one while it is built; after a failure it is tried again.

        Raises
        ------
        ValueError
            Where no pose of the table has light, or this machine has too little memory.
        """
        if self._table is None and self._thread is None:
            self._begin()
        table = self._table or self._coarse
        assert table is not None
        return table

    def shortcoming(self, table: SignatureTable | None) -> str:
        """Say why a table is the coarse one; empty for any other."""
        if table is None or table is not self._coarse:
            return ""
        if self.failure:
            return f"a coarse table answers, the signature table was not built: {self.failure}"
        return f"{self._damage}{BUILDING}"

    def _begin(self) -> None:
        self.failure = self._damage = ""
        try:
            self._table = open_cached(self._scene)
        except ValueError as error:
            self._damage = f"{error}: building it again now; "
        if self._table is not None:
            return
        coarse = coarse_scene(self._scene)
        try:
            self._coarse = None if coarse == self._scene else build_table(coarse)
        except ValueError:
            self._coarse = None  # the finer grid may still meet the light
        if self._coarse is None:
            self._table = cached_table(self._scene)
            return
        self._thread = threading.Thread(target=self._build, daemon=True)
        self._thread.start()

    def _build(self) -> None:
        table, failure = None, ""
        try:
            table = cached_table(self._scene, self._unless_stopped)
            _ = table.index  # which takes a moment too
        except (ValueError, OSError, MemoryError) as error:
            failure = str(error) or type(error).__name__
        self._table, self.failure, self._thread = table, failure, None
        if not self._stopped:
            self._on_done()

    def _unless_stopped(self, blocks: Iterable[int]) -> Iterator[int]:
        for block in blocks:
            if self._stopped:
                raise ValueError("stopped")
            yield block

    def stop(self) -> None:
        """End what is under way; nothing is called from now on."""
        self._stopped = True
        if (thread := self._thread) is not None:
            thread.join(timeout=2.0)  # it may be writing
