"""Sections of parameter files that are meant for a node, and do not reach it.

ROS takes a name without a slash for one in the root, and ignores in silence what fits no node
(https://github.com/ros2/rcl/issues/954).
"""

import re
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from uuv_optical_array.core.storage import yaml_text

_given: list[str] = []  # arguments that ROS was started with


def note_arguments(args: Sequence[str] | None) -> None:
    """Keep the arguments that ROS is started with; ``None``: those of the process."""
    _given[:] = sys.argv if args is None else args


def astray(node: str) -> list[str]:
    """Return what is wrong with sections that end in the name of a node but do not reach it.

    The name is the full one, such as ``/rov/formation_node``.
    """
    own = node.rpartition("/")[2]
    found = []
    for option, file in pairwise(_given):
        if option != "--params-file":
            continue
        for section in _sections(_read(file)):
            if section.rpartition("/")[2] == own and not _reaches(section, node):
                found.append(
                    f"{file}: the section {section} does not reach {node}; call it /**/{own}"
                )
    return found


def _read(file: str) -> Any:
    try:
        return yaml_text.read(Path(file))
    except (OSError, ValueError):  # which ROS has reported
        return {}


def _sections(values: Any, above: str = "") -> Iterator[str]:
    """Yield the names of sections, which may stand one in the other."""
    for name, inner in values.items() if isinstance(values, dict) else ():
        whole = f"{above}/{name}" if above else str(name)
        if isinstance(inner, dict) and "ros__parameters" in inner:
            yield whole
        elif name != "ros__parameters":
            yield from _sections(inner, whole)


def _reaches(section: str, node: str) -> bool:
    """Say whether a section is for a node: ``*`` is one part of its name, ``**`` any number."""
    pattern = "".join(
        r"(/\w+)*" if part == "**" else "/" + part.replace("*", r"\w+")
        for part in section.strip("/").split("/")
    )
    return re.fullmatch(pattern, node) is not None
