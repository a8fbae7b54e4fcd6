"""What a user may set of the formation law: station, gains and limits."""

import math
from dataclasses import dataclass
from typing import Annotated

from uuv_optical_array.core.settings import Place, Quantity

STATION = Quantity("station in the lamp's frame, y to port and z up; x at most -0.5", "m", -50, 50)


@dataclass(frozen=True)
class FormationSettings:
    """Station, gains and limits; ValueError for a station that is not behind the lamp."""

    station_m: Annotated[Place, STATION] = (-4.5, 0.0, 0.0)
    min_distance_m: Annotated[
        float, Quantity("smallest distance from the lamp; 0: no minimum", "m", 0, 50)
    ] = 2.0
    position_gain_per_s: Annotated[
        float, Quantity("commanded speed per position error", "1/s", 0.01, 2)
    ] = 0.4
    attitude_gain_per_s: Annotated[
        float, Quantity("commanded turn rate per attitude error", "1/s", 0.01, 2)
    ] = 0.4
    smoothing_s: Annotated[
        float, Quantity("time constant of the low-pass filter of the command", "s", 0.01, 10)
    ] = 0.5
    max_surge_m_per_s: Annotated[float, Quantity("largest surge speed", "m/s", 0.01, 5)] = 1.4
    max_sway_m_per_s: Annotated[float, Quantity("largest sway and heave speed", "m/s", 0.01, 5)] = (
        1.0
    )
    max_turn_deg_per_s: Annotated[float, Quantity("largest turn rate", "deg/s", 0.1, 90)] = 30.0
    max_acceleration_m_per_s2: Annotated[
        float,
        Quantity(
            "largest acceleration of the commanded speed on each axis; to keep off the lamp, or a "
            "depth, or to disengage, it may be more",
            "m/s^2",
            0.01,
            5,
        ),
    ] = 1.0
    max_acceleration_deg_per_s2: Annotated[
        float,
        Quantity(
            "largest acceleration of the commanded turn rate; to disengage, it may be more",
            "deg/s^2",
            0.1,
            90,
        ),
    ] = 30.0
    light_timeout_s: Annotated[
        float, Quantity("time without a pose after which the light is lost", "s", 0.1, 60)
    ] = 1.0
    stop_time_s: Annotated[
        float,
        Quantity(
            "assumed time from lost light to standstill, which limits the approach speed",
            "s",
            0.1,
            60,
        ),
    ] = 3.0
    bow_to_lamp: Annotated[
        bool, Quantity("point the bow at the lamp, instead of along the leader's heading")
    ] = False

    def __post_init__(self) -> None:
        if not self.station_m[0] <= -0.5:
            raise ValueError(
                f"station_m: {list(self.station_m)} is not behind the lamp; "
                "its x must be from -50 to -0.5 m"
            )

    @property
    def blind_s(self) -> float:
        """Time for which a follower would go on at its speed, should the light go out, s."""
        return self.light_timeout_s + self.stop_time_s / 2

    def room_m(self, range_m: float) -> float:
        """Return how much nearer to a lamp at a range a follower may come, m."""
        return range_m - self.min_distance_m if self.min_distance_m else math.inf
