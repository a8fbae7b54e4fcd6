"""The most probable parameters of a calibration, how sure they are, and how well they agree."""
