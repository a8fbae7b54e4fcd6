"""Modules that an extra of the package installs, imported when they are needed."""

import re
import sys
import sysconfig
from importlib import import_module
from importlib.metadata import requires
from pathlib import Path
from typing import Any

from uuv_optical_array.core.storage.files import PACKAGE

NEEDED_BY = {
    "bags": "bags need",
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
            f"{error}; {NEEDED_BY[extra]} the extra {extra}: {install_line(extra)}"
        ) from None


def install_line(extra: str) -> str:
    """Return the command that installs an extra's packages, not ours, which is on no index."""
    lines = (line.partition(";") for line in requires(PACKAGE) or ())
    names = [name.strip() for name, _, when in lines if re.search(rf"extra == .{extra}\b", when)]
    managed = Path(sysconfig.get_path("stdlib"), "EXTERNALLY-MANAGED").is_file()
    force = "--break-system-packages " if managed and sys.prefix == sys.base_prefix else ""
    return f"{sys.executable} -m pip install {force}" + " ".join(f"'{name}'" for name in names)
