"""Errors that more than one stage raises."""


class NoPose(Exception):
    """No pose of this image can be trusted; the message says why, its kind before the colon."""
