"""Work of a frame that its answer does not wait for."""

from collections.abc import Callable

from rclpy.node import Node


class Rest:
    """What is left of the newest frame, done at the next turn of a node's executor.

    What was published meanwhile reaches nodes of the same process first. Whoever takes the next
    frame calls `finish` before, as that may need it; without a node nothing else does.
    """

    def __init__(self, node: Node | None) -> None:
        self._node = node
        self._work: Callable[[], None] | None = None

    def leave(self, work: Callable[[], None]) -> None:
        """Leave work for the next turn."""
        self.finish()
        self._work = work
        if self._node is not None and self._node.executor is not None:
            self._node.executor.create_task(self.finish)

    def finish(self) -> None:
        """Do now what is left, if anything is."""
        work, self._work = self._work, None
        if work is not None:
            work()
