"""Every text that a node can show on ``/diagnostics``, and its cure; docs/causes.py has the causes.

The kind of a text stands before its colon; a topic's name and a comma may come before the kind.
"""

_DRIVER = "Correct the node that publishes it; the table of topics says what it must publish."
_STAMPS = "Give each exposure its own stamp; look for a second publisher on `array/image`."

# Frames that get no pose, and messages that are not used. WARN.
REFUSALS = {
    "no light": "Look at `array/image`; bring the lamp into view; check its supply and the window.",
    "no pattern": (
        "Look at `array/image`; back off from the lamp; check the array's cable and gain."
    ),
    "above full scale": "Set `effects.adc` and `effects.saturation` to those of the array.",
    "not five finite numbers": "Restart the feature node; check its input.",
    "not of this array": "Set the same `scene` for feature and estimator node.",
    "another image": _STAMPS,
    "frozen": "Restart the array's driver; check its cable.",
    "no match": (
        "Move the follower closer to its station; if that does not help, calibrate, or widen the "
        "scene's `table`."
    ),
    "no fit": (
        "Cover the lamp and look for other light in `array/image`; then calibrate. Where some "
        "images have a pose, values `scene_...` may say what differs from the scene."
    ),
    "outlier": (
        "If it lasts, raise `velocity_walk_m_per_s` and `turn_walk_deg_per_s`, and look at the "
        "value `own_motion`."
    ),
    "too uncertain": "Bring the lamp into view, and correct what the estimator's diagnostics name.",
    "late frame": (
        "Reduce the load of the computer, and the delay of a network between array and estimator."
    ),
    "repeated stamp": _STAMPS,
    "stamp not later": (
        "Let the sender give each message a stamp of its own; look for a second publisher, or for "
        "a clock that was set back."
    ),
    "stamp ahead": "If it lasts, let the sender stamp by a synchronised clock.",
    "wrong frame": (
        "Set the same `beacon_frame` and `frame_prefix` for estimator and formation node."
    ),
    "no image": (
        "Let driver and feature node keep the stamp of the image; see the parameter `use_image`."
    ),
    "no table": "See the error of the node.",
    "no roll": (
        "Check the IMU's topic and clock, raise `max_imu_age_s`, or set `use_imu` to false."
    ),
    "no orientation": (
        "Remap `imu` to a topic with an orientation, such as that of its filter, or set `use_imu` "
        "to false."
    ),
    "not finite": "Check the publisher of the message; if it is this node, report it with a bag.",
    "out of bounds": _DRIVER,
    "bad attitude": _DRIVER,
    "wrong encoding": _DRIVER,
    "wrong size": (
        "Set `scene` to that of the mounted array; let only the feature node publish key "
        "parameters."
    ),
    "wrong step": _DRIVER,
    "truncated": _DRIVER,
    "wrong fields": "Remap `array/features` to the topic of the feature node.",
    "wrong field type": _DRIVER,
    "wrong field offsets": _DRIVER,
    "pose": _DRIVER,
    "covariance": _DRIVER,
    "rate": _DRIVER,
    "range": _DRIVER,
    "range std": "Correct the range's variance.",
    "false range": (
        "If it lasts, look for echoes and for a constant error of the sensor; see `learnt_...`."
    ),
    "late range": (
        "Reduce the load of the computer, check that all clocks agree, or raise `buffer_s`."
    ),
    "repeated range": "Give each range its own stamp.",
    "range without light": "If there is light, check that all clocks agree.",
    "late motion": "Check the delay of the modem, and that all clocks agree.",
    "motion": _DRIVER,
    "false motion": (
        "If it lasts, check the frame and the covariance of the leader's twist, and that it is the "
        "velocity through the water."
    ),
    "readings": "Report it with a bag.",
    "no leader": "Check that `leader/odometry` is published in time.",
    "no leader pose at the follower's stamp": "Raise `max_gap_s`; use one clock for both.",
    "no state": "Let `follow_state` name the topic of a formation node of this version.",
    "frames differ": "Publish all odometries in one frame.",
    "paused": "Check what sets the simulated clock, and the load of the computer.",
}

# Lasting conditions that prevent answers or make them worse. WARN.
WARNINGS = {
    "no input": (
        "Try `ros2 topic hz` on its inputs; names, namespace, `ROS_DOMAIN_ID` and QoS must agree."
    ),
    "no output": (
        "Wait for `settle_s`; if it lasts, look at `follow_state`, and report it with a bag."
    ),
    "several publishers": "Give each run a namespace or a `ROS_DOMAIN_ID` of its own.",
    "mismatch": (
        "Check what the text names, such as a detector, other lamps or the lamp's battery; then "
        "calibrate, or widen the scene's `prior`."
    ),
    "old stamps": "Set the clocks (NTP, PTP), or `use_sim_time` for a bag.",
    "future stamps": "Set the clocks (NTP, PTP); check which node publishes `/clock`.",
    "no clock": "Start what publishes `/clock`, or set `use_sim_time` to false.",
    "zero stamp": "Let the driver stamp each exposure.",
    "dark lamp": "Check whether the lamp is on, and whether something hides it.",
    "faulty detector": "Clean or repair it; until then name it in `effects.detector_faults`.",
    "coasting": "Check whether the lamp is on and what hides it.",
    "searching": (
        "Wait, or bring the leader's lamp into view. `~/engage` with false stops the follower."
    ),
    "lost": (
        "Bring the lamp into view, so that it is followed again, or call `~/search`; both need "
        "images."
    ),
    "slow station": (
        "Move `station_m` away, or lower `min_distance_m`, `light_timeout_s` or `stop_time_s`."
    ),
    "not engaged": "Call the node's service `~/engage` (std_srvs/SetBool) with true.",
    "follower waits": "Start the leader (`demo:=leader`), or let `leader_odometry` name its topic.",
    "left out": "Start that vehicle, or name in `others` only vehicles that are running.",
    "leader waits": "Wait until each follower has its light and no `fit` is being compiled.",
}

# Errors of the set-up: the node does not work until it is corrected. ERROR.
ERRORS = {
    "table": (
        "Build it with `uuv_array table`, or empty the parameter `table`; correct the grid in the "
        "scene's `table` if it has too few or too many rows."
    ),
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
