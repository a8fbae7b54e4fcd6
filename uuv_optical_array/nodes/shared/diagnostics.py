"""What a node sends to ``/diagnostics`` once a second, by the conventions of diagnostic_updater."""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType  # type: ignore[attr-defined]
from rclpy.node import Node

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.nodes.shared.reasons import CURES, kind_of

PERIOD_S = 1.0
WINDOW = 5  # periods that the rate is counted over
ACCEPTABLE_AGE_S = -1.0, 5.0  # of a stamp, beyond which it is of another clock
UNKNOWN = "a node not known by name yet"  # its publishers are found before it is
SEPARATE = "give each run a namespace or a ROS_DOMAIN_ID of its own"


class BrokenOff(KeyboardInterrupt):
    """Work that was interrupted because the node ends; its message is not reported."""


def publishers(node: Node, topic: str) -> list[str]:
    """Return the full names of the nodes that publish on a topic, one for each publisher."""
    ends = node.get_publishers_info_by_topic(topic)
    names = ((end.node_namespace.rstrip("/"), end.node_name) for end in ends)
    return sorted(UNKNOWN if "UNKNOWN_" in name else f"{space}/{name}" for space, name in names)


def several_publishers(node: Node, topic: str) -> str:
    """Say who publishes on a topic where several do; a killed node counts for some 20 s more."""
    if node.count_publishers(topic) < 2:
        return ""
    return f"several publishers: {topic} of {' and '.join(publishers(node, topic))}; {SEPARATE}"


def status_name(node: Node) -> str:
    """Return the name of a node's status."""
    return node.get_fully_qualified_name().lstrip("/")


def hardware_id(node: Node) -> str:
    """Return the hardware's name in a node's status: its namespace."""
    return node.get_namespace().strip("/") or "uuv_optical_array"


class Diagnostics:
    """Count what a node answered and what it refused, and publish both at 1 Hz.

    OK: answers and no refusal in the last period. WARN: at least one refusal, with the latest
    reason of each kind, lasting warnings, several publishers of a watched topic, stamps of another
    clock, no input or no output. ERROR: the set-up must change. The hardware's name is the node's
    namespace. Of `state` are values that every status has.
    """

    def __init__(self, node: Node, state: Callable[[], Mapping[str, str]] = dict) -> None:
        self._node, self._state = node, state
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.totals = Counter(answered=0, refused=0)  # since the start, by the key of each count
        self._refusals: dict[str, str] = {}  # of this period, the latest by kind
        self._values: Callable[[], Mapping[str, str]] = dict
        self._failure = ""
        self._warnings: tuple[str, ...] = ()
        self._watched: list[str] = []
        self._heard_s, self._heard = time.monotonic(), False
        # When the last periods ended, and the totals then.
        self._ends = deque([(self._heard_s, self.totals.copy())], maxlen=WINDOW)
        self._stamps_ns: list[int] = []
        self._ages_s: list[float] = []
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # a node that waits for /clock says so
        self.timer = node.create_timer(PERIOD_S, self.publish, clock=steady)

    def answer(
        self, stamp_ns: int | None = None, values: Callable[[], Mapping[str, str]] | None = None
    ) -> None:
        """Note an answer; `values` is called for the last before each publication."""
        self.totals["answered"] += 1
        self._note(stamp_ns, values)

    def take(
        self, stamp_ns: int | None = None, values: Callable[[], Mapping[str, str]] | None = None
    ) -> None:
        """Note a message whose answer comes later; alone it does not make the status OK."""
        self.totals["taken"] += 1
        self._note(stamp_ns, values)

    def _note(self, stamp_ns: int | None, values: Callable[[], Mapping[str, str]] | None) -> None:
        self._heard = True
        if values is not None:
            self._values = values
        if stamp_ns is not None:
            self._stamps_ns.append(stamp_ns)
            now_ns = self._node.get_clock().now().nanoseconds
            self._ages_s.append((now_ns - stamp_ns) * 1e-9)

    def pass_over(self, count: int) -> None:
        """Note messages that were not looked at because a newer one had come."""
        self.totals["passed_over"] += count

    def refuse(self, reason: str) -> None:
        """Note a message that was not answered; the reason's kind stands before its colon."""
        kind = reason.partition(":")[0]
        self._refusals[kind] = reason
        self.totals.update(["refused", f"refused: {kind}"])
        self._node.get_logger().warning(reason, throttle_duration_sec=5.0)

    @contextmanager
    def refusing(self, topic: str = "") -> Iterator[None]:
        """Refuse the message that a block finds bad; the reason begins with the topic."""
        try:
            yield
        except BrokenOff:
            pass  # the executor of events would log it as a fault of the node
        except (NoPose, ValueError) as reason:
            self.refuse(f"{topic}, {reason}" if topic else str(reason))

    def warn(self, *reasons: str) -> None:
        """Note lasting conditions that make answers worse; one that is not named again is over."""
        for reason in reasons:
            if reason and reason not in self._warnings:
                self._node.get_logger().info(reason)
        self._warnings = reasons

    def fail(self, reason: str) -> None:
        """Note what keeps the node from working at all; an empty text is a recovery."""
        if reason and reason != self._failure:
            self._node.get_logger().error(reason)
        self._failure = reason

    def watch(self, topic: str) -> None:
        """Warn whenever a topic has more than one publisher."""
        self._watched.append(topic)

    def unwatch(self, topic: str) -> None:
        """Warn no more of a topic that is not used any longer."""
        self._watched.remove(topic)

    def publish(self) -> None:
        """Publish the last period and begin the next."""
        now_s, (since_s, before), (_, last) = time.monotonic(), self._ends[0], self._ends[-1]
        answered, passed_over = (
            self.totals[name] - last[name] for name in ("answered", "passed_over")
        )
        mixed = [several_publishers(self._node, topic) for topic in self._watched]
        if any(mixed):
            log = self._node.get_logger()
            log.warning("; ".join(filter(None, mixed)), throttle_duration_sec=30.0)
        told = self._failure, *self._warnings, *mixed, *self._refusals.values(), self._clock()
        reasons = list(filter(None, told))
        if self._heard or self._refusals:
            self._heard_s = now_s
        if not (answered or reasons):
            reasons = [f"no input: nothing came for {now_s - self._heard_s:.1f} s"]
            if self._heard:
                reasons = ["no output: what came was not answered yet"]
        level = DiagnosticStatus.WARN if reasons else DiagnosticStatus.OK
        passed = f", {passed_over} passed over for newer ones" if passed_over else ""
        text = "; ".join(reasons) or f"{answered} answered{passed}"
        if self._failure:
            level, text = DiagnosticStatus.ERROR, self._failure
        events, window_s = self.totals["answered"] - before["answered"], max(now_s - since_s, 1e-9)
        values = {
            "Events in window": str(events),  # as diagnostic_updater names them
            "Events since startup": str(self.totals["answered"]),
            "Duration of window (s)": f"{window_s:.3f}",
            "Actual frequency (Hz)": f"{events / window_s:.3f}",
            **{name: str(count) for name, count in self.totals.items()},
            **self._ages(),
            **self._state(),
            **self._values(),
            **{f"cure: {kind}": CURES[kind] for kind in map(kind_of, reasons) if kind},
        }
        status = DiagnosticStatus(
            level=level,
            name=status_name(self._node),
            message=text,
            hardware_id=hardware_id(self._node),
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
        self._ends.append((now_s, self.totals.copy()))
        self._refusals, self._values, self._heard = {}, dict, False
        self._stamps_ns, self._ages_s = self._stamps_ns[-1:], []

    def _clock(self) -> str:
        """Say what is wrong with the stamps of the last period."""
        least, most = ACCEPTABLE_AGE_S
        if not self._node.get_clock().now().nanoseconds:
            return "no clock: use_sim_time is true, and no /clock has come yet"
        if 0 in self._stamps_ns:
            return "zero stamp: a message has none"
        if self._ages_s and max(self._ages_s) > most:
            return f"old stamps: {max(self._ages_s):.3g} s old, more than {most:g} s"
        if self._ages_s and min(self._ages_s) < least:
            return f"future stamps: {-min(self._ages_s):.3g} s ahead, more than {-least:g} s"
        return ""

    def _ages(self) -> dict[str, str]:
        """Return how old stamps were when they were answered, and how evenly they came."""
        if not self._ages_s:
            return {}
        steps_s = np.diff(self._stamps_ns) * 1e-9
        return {
            "Earliest timestamp delay:": f"{min(self._ages_s):.6f}",
            "Latest timestamp delay:": f"{max(self._ages_s):.6f}",
            **({"Timestamp jitter (s)": f"{steps_s.std():.6f}"} if len(steps_s) > 1 else {}),
        }
