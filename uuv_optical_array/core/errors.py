"""Errors that more than one stage raises."""


class NoPose(Exception):
    """There is no honest pose for this image; the message says why, its kind before the colon."""
