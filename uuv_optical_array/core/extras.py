"""What an extra of the package installs, imported when it is needed."""

from importlib import import_module
from typing import Any

from uuv_optical_array.core.storage.files import PACKAGE

# Extra: what needs it.
NEEDED_BY = {
    "bags": "bags need",
    "cluster": "work in chunks needs",
    "view": "the view needs",
    "ros": "without a sourced ROS 2 this needs",
}


class NotInstalled(ValueError):
    """What is asked for needs an extra that is not installed; the text says which."""


def needs(extra: str, module: str) -> Any:
    """Import a module that only an extra installs, or one of ours that imports such.

    Parameters
    ----------
    extra
        One of `NEEDED_BY`.
    module
        Full name.

    Raises
    ------
    NotInstalled
        Where it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        if (error.name or "").partition(".")[0] == PACKAGE:
            raise  # a fault of ours
        raise NotInstalled(
            f"{error}; {NEEDED_BY[extra]} the extra: pip install '{PACKAGE}[{extra}]'"
        ) from None
