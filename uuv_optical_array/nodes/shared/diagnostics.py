"""What a node tells ``/diagnostics`` once a second."""

from collections import Counter

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node


class Diagnostics:
    """Count what a node answered and what it refused, and publish both at 1 Hz.

    OK: answers and no refusal in the last period. WARN: at least one refusal, with the latest
    reason of each kind, or a lasting warning. STALE: neither. ERROR: the node cannot work until its
    set-up changes.

    Parameters
    ----------
    node
        The node that reports.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._totals = Counter(answered=0, refused=0)
        self._answered = 0
        self._refusals: dict[str, tuple[int, str]] = {}
        self._values: dict[str, str] = {}
        self._failure = self._warning = ""
        self._timer = node.create_timer(1.0, self.publish)

    def answer(self, **values: str) -> None:
        """Note a message that was answered, with figures worth showing."""
        self._answered += 1
        self._totals["answered"] += 1
        self._values = values

    def refuse(self, reason: str) -> None:
        """Note a message that was not answered; the reason's kind stands before its colon."""
        kind = reason.partition(":")[0]
        count, _ = self._refusals.get(kind, (0, ""))
        self._refusals[kind] = count + 1, reason
        self._totals["refused"] += 1
        self._node.get_logger().warning(reason, throttle_duration_sec=5.0)

    def warn(self, reason: str) -> None:
        """Note what lasts and makes the answers worse; an empty text is its end."""
        if reason and reason != self._warning:
            self._node.get_logger().info(reason)
        self._warning = reason

    def fail(self, reason: str) -> None:
        """Note what keeps the node from working at all; an empty text is a recovery."""
        self._failure = reason
        if reason:
            self._node.get_logger().error(reason)

    def publish(self) -> None:
        """Publish the last period and begin the next."""
        if self._failure:
            level, text = DiagnosticStatus.ERROR, self._failure
        elif self._refusals or self._warning:
            level = DiagnosticStatus.WARN
            reasons = [self._warning, *(reason for _, reason in self._refusals.values())]
            text = "; ".join(filter(None, reasons))
        elif self._answered:
            level, text = DiagnosticStatus.OK, f"{self._answered} answered"
        else:
            level, text = DiagnosticStatus.STALE, "no input"
        values = {
            "answered": str(self._totals["answered"]),
            "refused": str(self._totals["refused"]),
            **{f"refused: {kind}": str(count) for kind, (count, _) in self._refusals.items()},
            **self._values,
        }
        status = DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name().lstrip("/"),
            message=text,
            hardware_id="uuv_optical_array",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
        self._answered, self._refusals, self._values = 0, {}, {}
