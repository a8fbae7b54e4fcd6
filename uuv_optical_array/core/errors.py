"""Errors that more than one stage raises."""

from typing import Any


class NoPose(Exception):
    """No pose of this image can be trusted; the message says why, its kind before the colon."""


def expect(value: Any, kinds: type | tuple[type, ...], name: str, cure: str) -> None:
    """Raise ValueError where an argument of a public function is of another type."""
    if not isinstance(value, kinds):
        shown = repr(value) if isinstance(value, str) else f"of type {type(value).__name__}"
        raise ValueError(f"{name}: {shown}; give {cure}")
