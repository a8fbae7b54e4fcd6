"""The state of a follower as people and programs get it, and how long each lasted."""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from uuv_optical_array.control.following import STATES, State, StateName
from uuv_optical_array.core.messages import Refused

# Colour of each wherever it is shown, legible on a dark and on a light background.
COLOURS: Mapping[StateName, str] = MappingProxyType(
    {
        "waiting": "#8a94a6",
        "locked": "#2fa866",
        "coasting": "#d9a400",
        "searching": "#e8722a",
        "lost": "#e03a3a",
        "disengaged": "#8f7ad6",
    }
)
SINCE, LASTED, WHY = "since (s)", "for (s)", "reason"


def values_of(state: State, now_s: float) -> dict[str, str]:
    """Return what a ``diagnostic_msgs/DiagnosticStatus`` has beside the state's name.

    That is since when, s on the clock of the stamps, for how long at the present, s, and why.
    """
    lasted_s = max(now_s - state.since_s, 0.0)
    return {WHY: state.reason, SINCE: f"{state.since_s:.9f}", LASTED: f"{lasted_s:.1f}"}


def state_from_status(message: Any) -> State:
    """Return the state of a ``diagnostic_msgs/DiagnosticStatus``; Refused for what is none."""
    values = {pair.key: pair.value for pair in message.values}
    name = next((known for known in STATES if known == message.message), None)
    if name is None:
        raise Refused(f"no state: {message.message!r} is none of {', '.join(STATES)}")
    try:
        since_s = float(values[SINCE])
    except (KeyError, ValueError):
        since_s = math.nan
    if not math.isfinite(since_s):
        raise Refused(f"no state: {SINCE!r} is {values.get(SINCE)!r}, not a number of seconds")
    return State(name, since_s, values.get(WHY, ""))


class Spell(NamedTuple):
    """A time in one state, s, on the clock of a run."""

    name: StateName
    begin_s: float
    end_s: float


def spells(states: Sequence[State], begin_s: float, end_s: float) -> list[Spell]:
    """Return the times of a run in each state, in order, between its begin and end, s.

    - states: by ascending `since_s`; each lasts until the next.
    """
    ends = [*(state.since_s for state in states[1:]), end_s]
    found = []
    for state, until_s in zip(states, ends, strict=False):
        begin, end = max(state.since_s, begin_s), min(until_s, end_s)
        if end > begin:
            found.append(Spell(state.name, begin, end))
    return found


def in_words(times: Sequence[Spell]) -> str:
    """Say how long each state lasted in all: ``locked 56.3 s, coasting 3.1 s``."""
    total = {name: 0.0 for name in ("locked", *STATES)}
    for name, begin_s, end_s in times:
        total[name] += end_s - begin_s
    return ", ".join(f"{name} {seconds:.1f} s" for name, seconds in total.items() if seconds > 0)
