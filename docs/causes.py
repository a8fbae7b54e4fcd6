"""Causes of the texts that a node can show on ``/diagnostics``, by their kinds.

What to do about each stands in ``uuv_optical_array/nodes/shared/reasons.py``.
"""

_OLD_CLOCK = "The stamps are of another clock than the node's."

CAUSES = {
    "no light": "No detector reads `min_peak_counts`: lamp off, hidden or too far.",
    "no pattern": (
        "All detectors read the same, dark or full scale: lamp too near, array shorted, daylight."
    ),
    "above full scale": "A reading exceeds the scene's converter.",
    "not five finite numbers": "These are no key parameters.",
    "not of this array": "A key parameter is impossible for the scene's array.",
    "another image": "The key parameters are not those of the image with their stamp.",
    "frozen": "One of the last 32 frames comes again, down to its noise.",
    "no match": "No signature is within `max_angle_rad`: beyond the table, or another sea.",
    "no fit": "Another lamp or sea, daylight, or dirty, dead or mirrored detectors.",
    "outlier": "Too far from the track: a reflection, another lamp, or too fast a manoeuvre.",
    "too uncertain": "The range is too uncertain to steer by: `mismatch`, or dark images.",
    "late frame": (
        "A newer one came first; it is tracked if within `buffer_s`, and not published."
    ),
    "repeated stamp": "Two frames have it.",
    "stamp not later": "A stamp is repeated, not given, or in the wrong order.",
    "stamp ahead": "A single stamp is ahead of the clock.",
    "wrong frame": "The track is not in `beacon_frame`.",
    "no image": "Key parameters came without an image of their stamp.",
    "no table": "It could not be read.",
    "no roll": (
        "No `imu` message is near the image in time. The last roll is taken to hold, ever less "
        "certain; before the first there is no pose."
    ),
    "no orientation": "The IMU gives none.",
    "not finite": "NaN or infinity, in a message or, if `not published`, by this node.",
    "out of bounds": "A number is too large; are its units m, m/s and rad/s?",
    "bad attitude": "A quaternion does not have the length 1.",
    "wrong encoding": "Not mono16.",
    "wrong size": "Not that of the scene's array.",
    "wrong step": "The rows of the image have the wrong length.",
    "truncated": "The message has not as many bytes as it says.",
    "wrong fields": "Not those of key parameters.",
    "wrong field type": "Not FLOAT64.",
    "wrong field offsets": "The key parameters do not follow each other.",
    "pose": "Out of bounds, or not later than the one before.",
    "covariance": "Not given, not positive definite or out of bounds.",
    "range": "Not a distance in m.",
    "range std": "Not a standard deviation in m.",
    "false range": "Too far from what the track knows: an echo, or a lamp or sea that changed.",
    "late range": "It is older than `buffer_s`, and not used.",
    "repeated range": "Two ranges have one stamp; the first is used.",
    "range without light": "No image is near it in time. A range alone gives no pose.",
    "late motion": "What the leader tells of its motion is older than 3 s.",
    "motion": "The leader's is out of bounds.",
    "false motion": "Light and what the leader tells of its motion contradict each other.",
    "readings": "They could not be linearised.",
    "no leader": "Its odometry lags far behind the follower's.",
    "no leader pose at the follower's stamp": "Its odometry has a gap or begins later.",
    "no state": "The message is not that of a formation node.",
    "frames differ": "The odometries are in two frames.",
    "paused": (
        "The simulated clock jumped, or the node had no time for seconds; no vehicle moved."
    ),
    "no input": "Nothing came that the node could answer.",
    "no output": "Poses come, and do not steer yet: they have to agree for `settle_s` at first.",
    "several publishers": "Two nodes publish on one topic.",
    "mismatch": (
        "Many images differ from the scene by more than its prior, best explained by what the text"
        " names. Poses and what the track learns stay as they are."
    ),
    "old stamps": _OLD_CLOCK,
    "future stamps": _OLD_CLOCK,
    "no clock": "The node waits for simulated time.",
    "zero stamp": "A message has no stamp.",
    "dark lamp": "One of several lamps shows nothing, though by the pose it should.",
    "faulty detector": "One is dead, stuck, dirty or in a glint. The pose is that of the others.",
    "coasting": "No pose steers; the follower goes on as its leader did, by what light there is.",
    "searching": "No light steered for `coast_s`, or from the start, or `~/search` was called.",
    "lost": "The search ended without light, or no image came in it.",
    "slow station": (
        "The station is so near the minimum distance that the follower is slowed, to stop in time "
        "when the light goes."
    ),
    "not engaged": "It was told not to steer, by `~/engage` or by `start_engaged`.",
    "follower waits": "The demonstration's follower has no leader.",
    "left out": "Another vehicle's odometry is missing: the image lacks its lamp and its body.",
    "leader waits": "A follower's first command, or its compiled fit, is missing.",
    "table": "Its folder is missing, damaged or of another scene.",
    "scene": "No pose of its table has light.",
}
