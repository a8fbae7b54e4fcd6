"""The commands that a vehicle obeys."""

import numpy as np
from geometry_msgs.msg import TwistStamped
from rclpy.clock import Clock
from rclpy.time import Time

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.messages import twist_from_message


class Helm:
    """The newest command, for as long as it is fresh by a clock, else a stop."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._command: tuple[Array, Array] = np.zeros(3), np.zeros(3)
        self._taken: Time | None = None

    def take(self, message: TwistStamped) -> None:
        """Take a command; ValueError for one that is not finite or out of bounds."""
        self._command, self._taken = twist_from_message(message), self._clock.now()

    def command(self, timeout_s: float) -> tuple[Array, Array]:
        """Return linear, m/s, and angular velocity, rad/s, shape ``(3,)`` each."""
        now = self._clock.now()
        if self._taken is not None and now < self._taken:
            self._taken = now  # a simulated clock that was set back
        if self._taken is None or (now - self._taken).nanoseconds * 1e-9 > timeout_s:
            self._command = np.zeros(3), np.zeros(3)
        return self._command
