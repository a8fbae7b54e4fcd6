"""Every text that a node can show on ``/diagnostics``: cause and cure.

The kind of a text stands before its colon; a topic's name and a comma may come before the kind.
"""

from typing import NamedTuple


class Reason(NamedTuple):
    """Why a text appears, and what to do about it."""

    cause: str
    cure: str


_DRIVER = "The node that publishes the topic does not keep to the table of topics."
_STAMPS = "Give each exposure its own stamp; look for a second publisher on `array/image`."
_OLD_CLOCK = "The stamps come from another clock than the node's."

# Frames that get no pose, and messages that are not used. WARN.
REFUSALS = {
    "no light": Reason(
        "No detector reads `min_peak_counts`: the lamp is off, out of sight or too far away.",
        "Look at `array/image`. Bring the lamp into view; check its supply and the window.",
    ),
    "no pattern": Reason(
        "All detectors read the same, dark or full scale: lamp too near, array shorted, daylight.",
        "Look at `array/image`; back off from the lamp; check the array's cable and gain.",
    ),
    "above full scale": Reason(
        "A reading is larger than the scene's converter can give.",
        "Correct `effects.adc` of the scene to the converter that is mounted.",
    ),
    "not five finite numbers": Reason(
        "These are no key parameters.", "Restart the feature node; check its input."
    ),
    "not of this array": Reason(
        "A key parameter is impossible for an array of the scene's size.",
        "Set the same `scene` for the feature and the estimator node.",
    ),
    "another image": Reason(
        "The key parameters are not those of the image with their stamp.", _STAMPS
    ),
    "frozen": Reason(
        "The same readings come again with new stamps, down to their noise.",
        "Restart the array's driver; check its cable.",
    ),
    "no match": Reason(
        "No signature is within `max_angle_rad`: beyond the table, or the sea is not the scene.",
        "Come closer to the station; else calibrate, or widen the scene's `table`.",
    ),
    "no fit": Reason(
        "No pose explains it: another lamp or sea, daylight, dirty, dead or mirrored detectors.",
        "Cover the lamp and look at `array/image`; then calibrate. `scene_...` says what differs.",
    ),
    "outlier": Reason(
        "The pose is too far from the track: a reflection, or a manoeuvre that is too fast for it.",
        "If it lasts, raise `velocity_walk_m_per_s` and `turn_walk_deg_per_s`; see `own_motion`.",
    ),
    "too uncertain": Reason(
        "The range is too uncertain to steer by: images not of the scene (`mismatch`), or dark.",
        "Look at the estimator's diagnostics, and cure what they name.",
    ),
    "late frame": Reason(
        "It came after a newer one. Its pose is not published, but tracked if within `buffer_s`.",
        "Look for load and for a network between the array and the estimator.",
    ),
    "repeated stamp": Reason("Two frames have one stamp.", _STAMPS),
    "stamp not later": Reason(
        "The stamp is not later than the one before: repeated, or in the wrong order.",
        "Look for a second publisher and for a clock that is set back. It recovers by itself.",
    ),
    "stamp ahead": Reason(
        "The stamp is ahead of the clock, and the one before was not.",
        "If it lasts, let the driver stamp each exposure by a clock that is synchronised.",
    ),
    "wrong frame": Reason(
        "A track is not in `beacon_frame`: it is not of this estimator.",
        "Set the same `beacon_frame` and `frame_prefix` for the estimator and the formation node.",
    ),
    "no image": Reason(
        "Key parameters came, and no image with their stamp.",
        "Let the array's driver and the feature node keep one stamp; see `use_image`.",
    ),
    "no table": Reason("The signature table could not be read.", "See the error `table ...`."),
    "no roll": Reason(
        "No `imu` message is near the image in time.",
        "Check the IMU's topic and clock, or raise `max_imu_age_s`; else set `use_imu` to false.",
    ),
    "no orientation": Reason(
        "The IMU says that it gives no orientation.",
        "Remap `imu` to the topic of its filter, or set `use_imu` to false.",
    ),
    "not finite": Reason(
        "A message holds NaN or infinity; where it is `not published`, this node computed it.",
        "Check the node that publishes it; if it is this one, report it with a bag.",
    ),
    "out of bounds": Reason("A number is too large; are its units m, m/s and rad/s?", _DRIVER),
    "bad attitude": Reason("A quaternion does not have the length 1.", _DRIVER),
    "wrong encoding": Reason("The image is not mono16.", _DRIVER),
    "wrong size": Reason(
        "Image or cloud has not the scene's size.", "Name the scene of the mounted array."
    ),
    "wrong step": Reason("The rows of the image have the wrong length.", _DRIVER),
    "truncated": Reason("The message has fewer or more bytes than it says.", _DRIVER),
    "wrong fields": Reason("The cloud is not one of key parameters.", "Remap `array/features`."),
    "wrong field type": Reason("The key parameters are not FLOAT64.", _DRIVER),
    "wrong field offsets": Reason("The key parameters do not follow each other.", _DRIVER),
    "pose": Reason("A pose is out of bounds, or not later than the one before.", _DRIVER),
    "covariance": Reason("A covariance is not positive definite or is out of bounds.", _DRIVER),
    "readings": Reason("Readings could not be linearised.", "Report it with a bag."),
    "no leader": Reason(
        "The leader's odometry lags far behind the follower's.", "Check `leader/odometry`."
    ),
    "no leader pose at the follower's stamp": Reason(
        "Its odometry has a gap or begins later.", "Raise `max_gap_s`; use one clock for both."
    ),
    "frames differ": Reason("The odometries are in two frames.", "Publish both in one frame."),
}

# Lasting conditions that prevent answers or make them worse. WARN.
WARNINGS = {
    "no input": Reason(
        "Nothing came that the node could answer.",
        "Try `ros2 topic hz` upstream; names, namespace, `ROS_DOMAIN_ID` and QoS must agree.",
    ),
    "several publishers": Reason(
        "Two nodes publish on a topic that must have one publisher: two runs are mixed.",
        "Give each run a namespace or a `ROS_DOMAIN_ID` of its own.",
    ),
    "mismatch": Reason(
        "Many images together differ from the scene by more than its prior allows; the "
        "text names the best explanation. The track is then so uncertain that the follower stops.",
        "Look at what is named: detector, other lamps, the lamp's battery; then calibrate, or "
        "widen the scene's `prior`.",
    ),
    "old stamps": Reason(_OLD_CLOCK, "Set the clocks (NTP, PTP), or `use_sim_time` for a bag."),
    "future stamps": Reason(_OLD_CLOCK, "Set the clocks (NTP, PTP); check who publishes `/clock`."),
    "no clock": Reason(
        "The node waits for simulated time.",
        "Start what publishes `/clock`, such as the simulator, or set `use_sim_time` to false.",
    ),
    "zero stamp": Reason("A message has no stamp.", "Let the driver stamp each exposure."),
    "dark lamp": Reason(
        "One of several lamps is dark, though by the pose of the others it should show.",
        "Look whether it is switched on, and whether something hides it.",
    ),
    "faulty detector": Reason(
        "A detector is dead, stuck, dirty or in a glint. The pose is that of the others.",
        "Clean or repair the detector; until then name it in `effects.detector_faults`.",
    ),
    "not engaged": Reason(
        "`formation_node` was told to steer nothing, by `~/engage` or by `start_engaged`.",
        "Call its service `~/engage` (std_srvs/SetBool) with true.",
    ),
    "follower waits": Reason(
        "The demonstration's follower is alone and starts behind the leader that it finds.",
        "Start the leader (`demo:=leader`), or let `leader_odometry` name its topic.",
    ),
    "leader waits": Reason(
        "The demonstration's leader waits for a follower's first command, or its compiled fit.",
        "It sets off when each `estimator_node` has a pose and its `fit` is compiled.",
    ),
}

# Errors of the set-up: the node does not work until it is corrected. ERROR.
ERRORS = {
    "table": Reason(
        "The folder of the signature table is missing, damaged or of another scene.",
        "Build it with `uuv_array table`, or empty the parameter `table`.",
    ),
    "scene": Reason("No pose of its table has light.", "Correct the scene's `table` or its lamp."),
}

REASONS = {**REFUSALS, **WARNINGS, **ERRORS}


def kind_of(text: str) -> str:
    """Return the kind of a text, a key of `REASONS`; empty for a text of none."""
    head = text.partition(":")[0]
    for kind in (head, head.rpartition(", ")[2], head.partition(" ")[0]):
        if kind in REASONS:
            return kind
    return ""
