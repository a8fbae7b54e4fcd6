"""The follower's roll, which one lamp does not show, by its IMU."""

import math

from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from uuv_optical_array.core.messages import Refused, stamp_ns
from uuv_optical_array.nodes.shared import messages

# A vehicle that rights itself keeps its roll so well while its IMU is silent, and at least.
DRIFT_RAD_PER_S, MOST_RAD = 0.05, 0.2


class FollowerRoll:
    """The roll of the last IMU message, less and less certain until another comes.

    - by_imu: whether there is an IMU; else the roll is 0.
    - stamp_ns: of the last message, ns; 0 before the first.
    - lost: why the roll of the last image is less certain; empty where it is not.
    """

    def __init__(self, by_imu: bool) -> None:
        self._by_imu = by_imu
        self.stamp_ns, self._roll_rad = 0, 0.0
        self.lost = ""

    def take(self, message: Imu) -> None:
        """Keep the roll of a message; Refused for one without an orientation."""
        self._roll_rad = messages.imu_roll(message)
        self.stamp_ns = stamp_ns(message.header)

    def at(self, header: Header, std_rad: float, max_age_s: float) -> tuple[float, float]:
        """Return the roll when an image was taken, and its standard deviation, rad.

        - std_rad: of a roll from an IMU or taken as 0, rad.
        - max_age_s: largest time between an image and a roll that is of it, s.
        - Refused: where there is an IMU that has sent nothing yet.
        """
        self.lost = ""
        if not self._by_imu:
            return 0.0, std_rad
        if not self.stamp_ns:
            raise Refused("no roll: no imu message has come")
        std, age_s = std_rad, abs(stamp_ns(header) - self.stamp_ns) * 1e-9
        if age_s > max_age_s:
            std = math.hypot(std, min(DRIFT_RAD_PER_S * age_s, MOST_RAD))
            self.lost = (
                f"no roll: the last imu message is {age_s:.3g} s from the image, more than "
                f"max_imu_age_s of {max_age_s:g} s; its roll is taken to hold, within "
                f"{std:.2g} rad"
            )
        return self._roll_rad, std
