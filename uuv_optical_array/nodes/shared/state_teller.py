"""The topic ``follow_state``, with the state of a follower at each change and at 1 Hz."""

import math

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType  # type: ignore[attr-defined]
from rclpy.node import Node

from uuv_optical_array.control.follow_states import values_of
from uuv_optical_array.control.following import State
from uuv_optical_array.nodes.shared.diagnostics import hardware_id, status_name
from uuv_optical_array.nodes.shared.node import FinitePublisher, steady_clock

PERIOD_S = 1.0
# Of any other state the level is WARN.
LEVELS = {"locked": DiagnosticStatus.OK, "lost": DiagnosticStatus.ERROR}


class StateTeller:
    """Tell the state of a follower: its name is the message, the values are when and why."""

    def __init__(self, node: Node, publisher: FinitePublisher) -> None:
        self._node, self._publisher = node, publisher
        self._noted: State | None = None
        self._clock, self._noted_at = steady_clock(node), steady_clock(node).now()
        self.state = State("waiting", math.nan, "")
        self.warning = ""  # for the diagnostics
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.timer = node.create_timer(PERIOD_S, self.publish, clock=steady)

    def note(self, state: State) -> bool:
        """Take the state at the present; return whether it is new, and if so publish it."""
        if state is self._noted:
            return False
        # Not since the stamp of an image that came late: states follow one another.
        self._noted, self._noted_at = state, self._clock.now()
        now_s = float(self._node.get_clock().now().nanoseconds) * 1e-9
        self.state = state._replace(since_s=now_s)
        self.warning = _warning(state)
        if not self.warning:
            self._node.get_logger().info(f"{state.name}: {state.reason}")
        self.publish()
        return True

    def publish(self) -> None:
        """Publish the state."""
        # The clock of `since_s` may have been set since.
        lasted_s = (self._clock.now() - self._noted_at).nanoseconds * 1e-9
        values = values_of(self.state, self.state.since_s + lasted_s)
        message = DiagnosticStatus(
            level=LEVELS.get(self.state.name, DiagnosticStatus.WARN),
            name=status_name(self._node),
            message=self.state.name,
            hardware_id=hardware_id(self._node),
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        self._publisher.publish(message)


def _warning(state: State) -> str:
    """Say what the diagnostics warn of; of a follower that waits they say that nothing came."""
    if state.name == "disengaged":
        return f"not engaged: {state.reason}"
    return "" if state.name in ("waiting", "locked") else f"{state.name}: {state.reason}"
