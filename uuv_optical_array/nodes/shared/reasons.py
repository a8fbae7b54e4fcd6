"""Every text that a node can show on ``/diagnostics``, and its cure; docs/causes.py has the causes.

The kind of a text stands before its colon; a topic's name and a comma may come before the kind.
"""

_DRIVER = "Correct the node that publishes it, by the table of topics."
_STAMPS = "Give each exposure its own stamp; look for a second publisher on `array/image`."

# Frames that get no pose, and messages that are not used. WARN.
REFUSALS = {
    "no light": "Look at `array/image`; bring the lamp into view; check its supply and the window.",
    "no pattern": (
        "Look at `array/image`; back off from the lamp; check the array's cable and gain."
    ),
    "above full scale": "Correct `effects.adc` to the mounted converter.",
    "not five finite numbers": "Restart the feature node; check its input.",
    "not of this array": "Set one `scene` for feature and estimator node.",
    "another image": _STAMPS,
    "frozen": "Restart the array's driver; check its cable.",
    "no match": "Come closer to the station; else calibrate, or widen the scene's `table`.",
    "no fit": (
        "Cover the lamp and look at `array/image`; then calibrate. `scene_...` says what differs."
    ),
    "outlier": (
        "If it lasts, raise `velocity_walk_m_per_s` and `turn_walk_deg_per_s`; see `own_motion`."
    ),
    "too uncertain": "Look at the estimator's diagnostics, and cure what they name.",
    "late frame": "Look for load, and for a network between array and estimator.",
    "repeated stamp": _STAMPS,
    "stamp not later": (
        "Let the driver stamp each exposure; look for a second publisher, or a clock that is set "
        "back. It recovers by itself."
    ),
    "stamp ahead": "If it lasts, let the driver stamp by a synchronised clock.",
    "wrong frame": "Set one `beacon_frame` and `frame_prefix` for estimator and formation node.",
    "no image": "Let driver and feature node keep the stamp; see `use_image`.",
    "no table": "See the error `table ...`.",
    "no roll": (
        "Check the IMU's topic and clock, raise `max_imu_age_s`, or set `use_imu` to false."
    ),
    "no orientation": "Remap `imu` to the topic of its filter, or set `use_imu` to false.",
    "not finite": "Check its publisher; if it is this node, report it with a bag.",
    "out of bounds": _DRIVER,
    "bad attitude": _DRIVER,
    "wrong encoding": _DRIVER,
    "wrong size": "Name the scene of the mounted array.",
    "wrong step": _DRIVER,
    "truncated": _DRIVER,
    "wrong fields": "Remap `array/features`.",
    "wrong field type": _DRIVER,
    "wrong field offsets": _DRIVER,
    "pose": _DRIVER,
    "covariance": _DRIVER,
    "range": _DRIVER,
    "range std": "Correct the range's variance, or `range_std_m`.",
    "false range": (
        "If it lasts, look for echoes and for a constant error of the sensor; see `learnt_...`."
    ),
    "late range": "Look for load and for clocks that differ, or raise `buffer_s`.",
    "repeated range": "Let the sensor stamp each range; look for a second publisher on `range`.",
    "range without light": "With light, look for clocks that differ.",
    "late motion": "Look at the modem's delay, and for clocks that differ.",
    "motion": _DRIVER,
    "false motion": (
        "If it lasts, look at the frame of the leader's twist, whether it is through the water, "
        "and at its covariance."
    ),
    "readings": "Report it with a bag.",
    "no leader": "Check `leader/odometry`.",
    "no leader pose at the follower's stamp": "Raise `max_gap_s`; use one clock for both.",
    "no state": "Let `follow_state` name the topic of a formation node of this version.",
    "frames differ": "Publish both in one frame.",
    "paused": "Look who sets the simulated clock, or for load. It goes on by itself.",
}

# Lasting conditions that prevent answers or make them worse. WARN.
WARNINGS = {
    "no input": (
        "Try `ros2 topic hz` upstream; names, namespace, `ROS_DOMAIN_ID` and QoS must agree."
    ),
    "no output": "Wait a second; if it lasts, look at `follow_state`, and report it with a bag.",
    "several publishers": "Give each run a namespace or a `ROS_DOMAIN_ID` of its own.",
    "mismatch": (
        "Look at what is named: detector, other lamps, the lamp's battery; then calibrate, or "
        "widen the scene's `prior`."
    ),
    "old stamps": "Set the clocks (NTP, PTP), or `use_sim_time` for a bag.",
    "future stamps": "Set the clocks (NTP, PTP); check who publishes `/clock`.",
    "no clock": "Start what publishes `/clock`, or set `use_sim_time` to false.",
    "zero stamp": "Let the driver stamp each exposure.",
    "dark lamp": "Look whether it is on, and what may hide it.",
    "faulty detector": "Clean or repair it; until then name it in `effects.detector_faults`.",
    "coasting": "Look whether the lamp shines and what hides it. It searches after `coast_s`.",
    "searching": "Wait, or bring the leader's lamp into view. `~/engage` with false stops it.",
    "lost": "Bring the lamp into view, which is followed again, or call `~/search`.",
    "slow station": (
        "Move `station_m` away, or lower `min_distance_m`, `light_timeout_s` or `stop_time_s`."
    ),
    "not engaged": "Call its service `~/engage` (std_srvs/SetBool) with true.",
    "follower waits": "Start the leader (`demo:=leader`), or let `leader_odometry` name its topic.",
    "left out": "Start that vehicle, or name in `others` those alone that there are.",
    "leader waits": "It sets off when each `estimator_node` has a pose and its `fit` is compiled.",
}

# Errors of the set-up: the node does not work until it is corrected. ERROR.
ERRORS = {
    "table": "Build it with `uuv_array table`, or empty the parameter `table`.",
    "scene": "Correct the scene's `table` or its lamp.",
}

CURES = {**REFUSALS, **WARNINGS, **ERRORS}


def kind_of(text: str) -> str:
    """Return the kind of a text, a key of `CURES`; empty for a text of none."""
    head = text.partition(":")[0]
    for kind in (head, head.rpartition(", ")[2], head.partition(" ")[0]):
        if kind in CURES:
            return kind
    return ""
