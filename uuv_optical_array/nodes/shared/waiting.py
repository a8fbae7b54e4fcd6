"""What a leader of the demonstration waits for before it sets off."""

from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from uuv_optical_array.control.following import StateName
from uuv_optical_array.nodes.shared.diagnostics import UNKNOWN, publishers

# Of a follower that has not found the leader, though it may command a search.
SEEKING: tuple[StateName, ...] = "waiting", "searching", "lost"
COMPILING = "being compiled"  # how the text of such a fit ends


class Waiting:
    """Waits until each follower is commanded, has found the leader and has its final fit.

    `spaces` stand before the names of each follower's topics, such as ``follower_1/``.
    """

    def __init__(self, node: Node, spaces: Iterable[str]) -> None:
        self._node = node
        self._awaited = {space: "" for space in spaces}  # and why, where a command has come
        self.fits: dict[str, str] = {}  # what each estimator says of its fit
        self.states: dict[str, str] = {}  # what each follower says of itself, by its space

    def on_command(self, space: str) -> bool:
        """Note that a follower is commanded; return whether all are that the leader waits for."""
        if space in self._awaited:
            self._awaited[space] = self._reason(space)
            if not self._awaited[space]:
                del self._awaited[space]
        return not self._awaited

    @property
    def busy(self) -> bool:
        """Whether a fit is compiled or a follower searches, which ends by itself."""
        compiling = any(fit.endswith(COMPILING) for fit in self.fits.values())
        return compiling or "searching" in self.states.values()

    @property
    def text(self) -> str:
        """What it waits for, in words; nothing once that is over."""
        silent = ", ".join(f"{space}cmd_vel" for space, why in self._awaited.items() if not why)
        reasons = [f"no {silent} has come yet"] if silent else []
        reasons += filter(None, self._awaited.values())
        return f"leader waits: {' and '.join(reasons)}" if reasons else ""

    def _reason(self, space: str) -> str:
        """Say why the leader waits though a command came; nothing where it does not."""
        if self.states.get(space) in SEEKING:
            return f"{space}cmd_vel is of a follower that is {self.states[space]}"
        topic = self._node.resolve_topic_name(f"{space}cmd_vel")
        name = f"{topic.rpartition('/')[0]}/estimator_node"
        there = {name, UNKNOWN} & {*publishers(self._node, "/diagnostics")}
        if there and self.fits.get(name, COMPILING).endswith(COMPILING):
            return f"{name} compiling the fit, once on a machine"
        return ""

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note how the fit of each estimator runs."""
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "method" in values:
                self.fits[f"/{status.name}"] = values.get("fit", "")

    def on_state(self, space: str, message: DiagnosticStatus) -> None:
        """Note what a follower says of itself."""
        self.states[space] = message.message
