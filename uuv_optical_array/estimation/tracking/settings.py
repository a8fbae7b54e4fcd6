"""What a user may set of a tracker."""

from dataclasses import dataclass
from typing import Annotated

from uuv_optical_array.core.settings import Quantity


@dataclass(frozen=True)
class TrackerSettings:
    """The motion and the errors to expect, and when to forget."""

    velocity_walk_m_per_s: Annotated[
        float,
        Quantity(
            "standard deviation of the change of a velocity in 1 s: the leader's, or, where no "
            "commands are obeyed, the relative one",
            "m/s",
            1e-4,
            10,
        ),
    ] = 0.1
    turn_walk_deg_per_s: Annotated[
        float,
        Quantity(
            "standard deviation of the change of a turn rate in 1 s: the leader's, or, where no "
            "commands are obeyed, the relative one",
            "deg/s",
            1e-3,
            500,
        ),
    ] = 2.0
    common_share: Annotated[
        float,
        Quantity(
            "least share of a pose's variance that is common to all frames, where the track takes "
            "poses, as of the sam methods",
            "",
            0,
            0.99,
        ),
    ] = 0.1
    gate_probability: Annotated[
        float, Quantity("probability that a valid frame passes the gate", "", 0.5, 1)
    ] = 0.9999
    reacquire_frames: Annotated[
        int,
        Quantity(
            "number of consecutive outliers, the last of which restarts the track", "", 2, 100
        ),
    ] = 5
    reset_after_s: Annotated[
        float,
        Quantity("time without a pose that the track takes, after which it restarts", "s", 0.1, 60),
    ] = 2.0
    command_timeout_s: Annotated[
        float,
        Quantity(
            "age of a command beyond which the follower's own motion is unknown", "s", 0.05, 60
        ),
    ] = 1.0
    buffer_s: Annotated[
        float,
        Quantity(
            "largest delay behind the newest frame at which one still enters the track", "s", 0, 10
        ),
    ] = 0.5
    constants_hold_s: Annotated[
        float, Quantity("time in which the constants of the sea drift to new values", "s", 60, 1e7)
    ] = 3600.0
