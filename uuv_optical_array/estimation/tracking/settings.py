"""What a user may set of a tracker."""

from dataclasses import dataclass
from typing import Annotated

from uuv_optical_array.core.settings import Quantity


@dataclass(frozen=True)
class TrackerSettings:
    """The motion and the errors to expect, and when to forget."""

    velocity_walk_m_per_s: Annotated[
        float, Quantity("random change of relative velocity in 1 s", "m/s", 1e-4, 10)
    ] = 0.1
    turn_walk_deg_per_s: Annotated[
        float, Quantity("random change of relative turn rate in 1 s", "deg/s", 1e-3, 500)
    ] = 2.0
    common_share: Annotated[
        float, Quantity("share of a pose's variance common to all frames", "", 0, 0.99)
    ] = 0.1
    gate_probability: Annotated[
        float, Quantity("probability that a valid frame passes the gate", "", 0.5, 1)
    ] = 0.9999
    reacquire_frames: Annotated[
        int, Quantity("outliers in a row, the last of which begins the track anew", "", 2, 100)
    ] = 5
    reset_after_s: Annotated[
        float, Quantity("without a pose until the track starts anew", "s", 0.1, 60)
    ] = 2.0
    command_timeout_s: Annotated[
        float, Quantity("age of a command from which the own motion is unknown", "s", 0.05, 60)
    ] = 1.0
    buffer_s: Annotated[float, Quantity("how late a frame may come", "s", 0, 10)] = 0.5
    constants_hold_s: Annotated[
        float, Quantity("time in which the sea's constants change", "s", 60, 1e7)
    ] = 3600.0
