"""Causes of the texts that a node can show on ``/diagnostics``, by their kinds.

What to do about each stands in ``uuv_optical_array/nodes/shared/reasons.py``.
"""

CAUSES = {
    "no light": (
        "No detector reads `min_peak_counts` more than in darkness, or the light may be daylight: "
        "the lamp is off, out of sight or too far."
    ),
    "no pattern": (
        "All readings are the same, or each is 0 or full scale: a lamp too near, a shorted array "
        "or daylight."
    ),
    "above full scale": "A reading exceeds the scene's full scale.",
    "not five finite numbers": "The message has no valid key parameters.",
    "not of this array": "A key parameter is impossible for the scene's array.",
    "another image": "The key parameters are not those of the image with their stamp.",
    "frozen": "A frame is equal to one of the last 32, even in its noise.",
    "no match": (
        "No signature is within `max_angle_rad`: the pose is beyond the table, or the sea differs."
    ),
    "no fit": (
        "No pose could be fitted to the image: another lamp or sea, daylight, a shadow, dirty or "
        "dead detectors, exchanged wires, several lamps off, or a pitch near 60 deg or more."
    ),
    "outlier": (
        "The pose is too far from the track, or its lamp is not taken for the leader's: a "
        "reflection, another lamp, or a fast manoeuvre."
    ),
    "too uncertain": "The range is too uncertain to steer by: few or dim readings.",
    "late frame": (
        "A newer frame came first. The late pose is not published; within `buffer_s` it enters "
        "the track."
    ),
    "repeated stamp": "Two frames have the same stamp.",
    "stamp not later": "A stamp is repeated, missing, or in the wrong order.",
    "stamp ahead": (
        "The stamp of an image, a range or the leader's motion is more than 0.3 s ahead of the "
        "node's clock. An image or a range is taken all the same if it is the first, or the one "
        "before was ahead, too."
    ),
    "wrong frame": "The track is not in `beacon_frame`.",
    "no image": (
        "Key parameters came without an image of their stamp; or, from Python, an image has "
        "another shape or readings that are not finite."
    ),
    "no table": "The node could not be set up, for example as its signature table cannot be read.",
    "no roll": (
        "No `imu` message has come yet, and there is no pose; or the last one is more than "
        "`max_imu_age_s` from the image, and its roll is used as less certain."
    ),
    "no orientation": "The IMU gives no orientation.",
    "not finite": "NaN or infinity, in a message or, if `not published`, by this node.",
    "out of bounds": "A number is too large or too small; are its units m, m/s and rad/s?",
    "bad attitude": "The length of a quaternion differs from 1 by more than 0.01.",
    "wrong encoding": "The image is neither mono16 nor 16UC1.",
    "wrong size": (
        "The image does not have the scene's rows and columns, or there are several sets of key "
        "parameters."
    ),
    "wrong step": "The rows of the image have the wrong length.",
    "truncated": "The message has another number of bytes than its size states.",
    "wrong fields": "The fields are not those of key parameters.",
    "wrong field type": "A field is not one FLOAT64.",
    "wrong field offsets": "The key parameters do not follow each other from byte 0 on.",
    "pose": "The pose is out of bounds, or not later than the one before.",
    "covariance": (
        "The covariance is missing, not symmetric, not positive definite, nearly singular or out "
        "of bounds."
    ),
    "rate": "A rate of the pose is beyond 10 m/s or 6 rad/s.",
    "range": "The range is not from 1 mm to 10 km.",
    "range std": "The range's standard deviation is out of bounds.",
    "false range": "The range is too far from the track: an echo, or lamp or sea have changed.",
    "late range": "The range is more than `buffer_s` older than the newest frame of the track.",
    "repeated range": "From Python, two ranges have the same stamp; only the first is used.",
    "range without light": "No pose is near the range in time. A range alone gives none.",
    "late motion": "The message of the leader's motion is older than 3 s.",
    "motion": "The leader's motion is out of bounds.",
    "false motion": "The light contradicts the motion that the leader sends.",
    "readings": "The readings could not be linearised.",
    "no leader": "The leader's odometry is missing, or lags far behind the follower's.",
    "no leader pose at the follower's stamp": (
        "The leader's odometry has a gap, or its last 200 poses begin later."
    ),
    "no state": "The message is not that of a formation node.",
    "frames differ": "The odometries are not all in one frame.",
    "paused": (
        "The simulated clock jumped, or the node was held up for more than 1 s, or than five "
        "periods where these are longer; no vehicle moved."
    ),
    "no input": "The node received nothing that it could answer.",
    "no output": (
        "Poses arrived in the last second, but no command left: poses first have to agree for "
        "`settle_s`."
    ),
    "several publishers": "A topic has more than one publisher.",
    "mismatch": (
        "Many images differ from the scene by more than its prior; the text names the best "
        "explanation. Poses and track are not corrected for it."
    ),
    "old stamps": "A stamp is more than 5 s old: of another clock than the node's, or too late.",
    "future stamps": "A stamp is more than 1 s ahead: of another clock than the node's.",
    "no clock": "The node waits for simulated time.",
    "zero stamp": "A message has no stamp.",
    "dark lamp": "One of several lamps gives no light where the pose predicts some.",
    "faulty detector": (
        "A detector does not fit the others: dead, stuck, dirty, shaded or in a glint. The pose "
        "is estimated from the others."
    ),
    "coasting": "No pose steers; the follower goes on as its leader did.",
    "searching": (
        "The follower looks for its leader: no sign of it came for `coast_s`, no pose to steer by "
        "for the longer of `coast_s` and `search_time_s`, no light to steer by came from the "
        "start, or `~/search` was called."
    ),
    "lost": "The search ended after `search_time_s`, or because no image came for 2 s.",
    "slow station": (
        "The station is near the minimum distance, so the follower goes slowly, to stop in time "
        "if the light goes out."
    ),
    "not engaged": "The node does not steer, by `~/engage` or `start_engaged`, or by `when_lost`.",
    "follower waits": "The demonstration's follower has no leader.",
    "left out": (
        "The pose of another vehicle is missing at the stamp of an image; its lamp and body are "
        "not drawn."
    ),
    "leader waits": (
        "A follower still lacks its first command, its leader's light or its compiled fit."
    ),
    "table": (
        "The folder is missing, incomplete, damaged, or of another scene or version; or the table "
        "has fewer than two rows, or is too large for the memory."
    ),
    "scene": "No pose of the scene's table has light, or the table is too large for the memory.",
}
