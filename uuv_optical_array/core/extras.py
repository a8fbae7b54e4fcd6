"""Modules that an extra of the package installs, imported when they are needed."""

from importlib import import_module
from typing import Any

from uuv_optical_array.core.storage.files import PACKAGE

# What needs each extra.
NEEDED_BY = {
    "bags": "bags need",
    "fast": "tracing photons needs",
    "cluster": "a signature table on disk needs",
    "view": "the view needs",
    "ros": "without a sourced ROS 2 this needs",
}


class NotInstalled(ValueError):
    """An extra that is needed is not installed; the text says which."""


def needs(extra: str, module: str) -> Any:
    """Import a module that needs an extra of `NEEDED_BY`; `NotInstalled` where it is missing."""
    try:
        return import_module(module)
    except ImportError as error:
        if (error.name or "").partition(".")[0] == PACKAGE:
            raise  # an error in this package
        raise NotInstalled(
            f"{error}; {NEEDED_BY[extra]} the extra: pip install '{PACKAGE}[{extra}]'"
        ) from None
