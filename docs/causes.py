"""Causes of the texts that a node can show on ``/diagnostics``, by their kinds.

What to do about each stands in ``uuv_optical_array/nodes/shared/reasons.py``.
"""

_OLD_CLOCK = "The stamps come from another clock than the node's."

CAUSES = {
    "no light": "No detector reads `min_peak_counts`: the lamp is off, hidden or too far away.",
    "no pattern": (
        "All detectors read the same, dark or full scale: lamp too near, array shorted, daylight."
    ),
    "above full scale": "A reading is larger than the scene's converter can give.",
    "not five finite numbers": "These are no key parameters.",
    "not of this array": "A key parameter is impossible for an array of the scene's size.",
    "another image": "The key parameters are not those of the image with their stamp.",
    "frozen": "The readings of one of the last 32 frames come again, down to their noise.",
    "no match": (
        "No signature is within `max_angle_rad`: beyond the table, or the sea is not the scene."
    ),
    "no fit": (
        "No pose explains it: another lamp or sea, daylight, dirty, dead or mirrored detectors."
    ),
    "outlier": (
        "The pose is too far from the track: a reflection, or a manoeuvre too fast for it."
    ),
    "too uncertain": (
        "The range is too uncertain to steer by: images not of the scene (`mismatch`), or dark."
    ),
    "late frame": (
        "It came after a newer one; its pose is not published, but tracked if within `buffer_s`."
    ),
    "repeated stamp": "Two frames have one stamp.",
    "stamp not later": "The stamp is repeated or in the wrong order.",
    "stamp ahead": "The stamp is ahead of the clock, and the one before was not.",
    "wrong frame": "A track is not in `beacon_frame`.",
    "no image": "Key parameters came, and no image with their stamp.",
    "no table": "The signature table could not be read.",
    "no roll": "No `imu` message is near the image in time.",
    "no orientation": "The IMU says that it gives no orientation.",
    "not finite": (
        "A message holds NaN or infinity; where it is `not published`, this node computed it."
    ),
    "out of bounds": "A number is too large; are its units m, m/s and rad/s?",
    "bad attitude": "A quaternion does not have the length 1.",
    "wrong encoding": "The image is not mono16.",
    "wrong size": "Image or cloud has not the scene's size.",
    "wrong step": "The rows of the image have the wrong length.",
    "truncated": "The message has fewer or more bytes than it says.",
    "wrong fields": "The cloud is not one of key parameters.",
    "wrong field type": "The key parameters are not FLOAT64.",
    "wrong field offsets": "The key parameters do not follow each other.",
    "pose": "A pose is out of bounds, or not later than the one before.",
    "covariance": "A covariance is not positive definite or is out of bounds.",
    "readings": "Readings could not be linearised.",
    "no leader": "The leader's odometry lags far behind the follower's.",
    "no leader pose at the follower's stamp": "Its odometry has a gap or begins later.",
    "frames differ": "The odometries are in two frames.",
    "no input": "Nothing came that the node could answer.",
    "several publishers": "Two nodes publish on one topic, as where two runs are mixed.",
    "mismatch": (
        "Many images together differ from the scene by more than its prior allows, best explained"
        " by what the text names. The track is then so uncertain that the follower stops."
    ),
    "old stamps": _OLD_CLOCK,
    "future stamps": _OLD_CLOCK,
    "no clock": "The node waits for simulated time.",
    "zero stamp": "A message has no stamp.",
    "dark lamp": "One of several lamps is dark, though by the pose it should show.",
    "faulty detector": (
        "A detector is dead, stuck, dirty or in a glint. The pose is that of the others."
    ),
    "not engaged": (
        "`formation_node` was told to steer nothing, by `~/engage` or by `start_engaged`."
    ),
    "follower waits": "The demonstration's follower is alone and waits for a leader.",
    "leader waits": "The leader waits for a follower's first command, or its compiled fit.",
    "table": "The folder of the signature table is missing, damaged or of another scene.",
    "scene": "No pose of its table has light.",
}
