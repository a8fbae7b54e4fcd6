"""The paths that a leader swims: commanded velocities over time, ready ones and those of a file."""

import bisect
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np

from uuv_optical_array.control.vehicles.vehicle import Vehicle
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity, check, hint
from uuv_optical_array.core.storage import tables
from uuv_optical_array.core.storage.files import user_path

# At a time, s, the velocity over ground, m/s, and the turn rate, rad/s, in the leader's own frame,
# shape ``(3,)`` each. The roll rate is zero.
LeaderPath: TypeAlias = Callable[[float], tuple[Array, Array]]

MINUTE_S = 60.0
LEADER_SPEED_M_PER_S = 0.5
# Start, duration (s) and peak rate (rad/s) of the manoeuvres of each minute.
TURN = (12.0, 20.0, np.radians(3.5))
BOW_DOWN = (32.0, 10.0, np.radians(2.0))
BOW_UP = (48.0, 10.0, -np.radians(2.0))


def _raised_cosine(t_s: float, start_s: float, duration_s: float, peak: float) -> float:
    """Return a smooth pulse; its integral is half of peak times duration."""
    phase = (t_s - start_s) / duration_s
    return peak * (1 - np.cos(2 * np.pi * phase)) / 2 if 0 < phase < 1 else 0.0


def leader_twist(t_s: float) -> tuple[Array, Array]:
    """Return the demonstration's command, as of `LeaderPath`.

    A minute is straight, a turn of 35 deg, 1.4 m down at a pitch of up to 10 deg, straight; the
    next turns back and comes up. A station 4.5 m behind swings sideways at up to 0.27 m/s.
    """
    minute, t_s = divmod(t_s, MINUTE_S)
    side = -1.0 if minute % 2 else 1.0
    pitch_rate = _raised_cosine(t_s, *BOW_DOWN) + _raised_cosine(t_s, *BOW_UP)
    yaw_rate = _raised_cosine(t_s, *TURN)
    return np.array([LEADER_SPEED_M_PER_S, 0, 0]), side * np.array([0, pitch_rate, yaw_rate])


_SPEED, _TURN = Quantity("", "m/s", -3, 3), Quantity("", "deg/s", -90, 90)
COLUMNS = {
    "t_s": Quantity("", "s", 0, 1e6),
    "surge_m_per_s": _SPEED,
    "sway_m_per_s": _SPEED,
    "heave_m_per_s": _SPEED,
    "pitch_rate_deg_per_s": _TURN,
    "yaw_rate_deg_per_s": _TURN,
}


def _held(rows: Sequence[Sequence[float]], period_s: float = math.inf) -> LeaderPath:
    """Return the path of rows as of `COLUMNS`, in their order, that begins anew each period."""
    times = [row[0] for row in rows]
    linear = [np.array(row[1:4]) for row in rows]
    angular = [np.radians([0.0, *row[4:6]]) for row in rows]

    def path(t_s: float) -> tuple[Array, Array]:
        row = bisect.bisect_right(times, t_s % period_s) - 1
        return (linear[row].copy(), angular[row].copy()) if row >= 0 else (np.zeros(3), np.zeros(3))

    return path


def _ready(period_s: float, *rows: Sequence[float]) -> LeaderPath:
    """Return the path of rows of time, surge, heave and yaw rate, which may end with the surge."""
    filled = ((*row, 0.0, 0.0)[:4] for row in rows)
    return _held([[t_s, surge, 0, heave, 0, yaw] for t_s, surge, heave, yaw in filled], period_s)


PATHS: dict[str, LeaderPath] = {
    "demonstration": leader_twist,
    "straight": _ready(MINUTE_S, (0, 0.5)),
    "circle": _ready(MINUTE_S, (0, 0.5, 0, 5)),  # to port, of a radius of 5.7 m
    "zigzag": _ready(  # between 30 deg to port and 30 deg to starboard
        40,
        (0, 0.5),
        (5, 0.5, 0, 6),
        (10, 0.5),
        (15, 0.5, 0, -6),
        (25, 0.5),
        (30, 0.5, 0, 6),
        (35, 0.5),
    ),
    "right_angles": _ready(20, (0, 0.5), (10, 0.5, 0, 20), (14.5, 0.5)),
    "stop_and_go": _ready(20, (0, 0.5), (10, 0)),
    "dash": _ready(30, (0, 0.5), (10, 1.2), (20, 0.5)),
    "dive": _ready(40, (0, 0.4), (10, 0.4, -0.3), (20, 0.4), (30, 0.4, 0.3)),
    "back_up": _ready(40, (0, 0.5), (20, 0), (25, -0.3), (35, 0)),
    "stand": _ready(MINUTE_S, (0, 0)),
}


def leader_path(name_or_file: str | Path) -> LeaderPath:
    """Return a ready path by its name (`PATHS`), or the path of a CSV file.

    The file's first line names the columns (`COLUMNS`): time from when the leader sets off, s;
    surge, sway and heave over ground, m/s; pitch and yaw rate, deg/s, by REP 103: positive to port,
    up, bow low, and bow to port. Each row holds until the next, the last for ever, and before the
    first the leader stands. It is read as `tables.read` does.

    ValueError, with file, line, value and bound, for any other table, or where neither a ready path
    nor a file has the name; OSError for a file that cannot be read.
    """
    if str(name_or_file) in PATHS:
        return PATHS[str(name_or_file)]
    file = user_path(name_or_file)
    if not file.is_file():
        cure = hint(name_or_file, PATHS, f"choose {', '.join(PATHS)}, or give a CSV file")
        raise ValueError(
            f"leader_path: {str(name_or_file)!r} is neither a ready path nor a file; {cure}"
        )
    return _held(_rows(file))


def _rows(file: Path) -> list[list[float]]:
    """Return the checked rows of a table, in the order of `COLUMNS`."""
    head, table = tables.read(file)
    if sorted(head) != sorted(COLUMNS):
        raise ValueError(
            f"{file}: columns {', '.join(head) or 'none'}; give the columns {','.join(COLUMNS)}"
        )
    rows: list[list[float]] = []
    for number, given in table:
        at = f"{file}: line {number}"
        rows.append([_number(given[name], name, at) for name in COLUMNS])
        if len(rows) > 1 and not rows[-1][0] > rows[-2][0]:
            raise ValueError(
                f"{at}: t_s: {rows[-1][0]:g} is not later than {rows[-2][0]:g} s of the row "
                "before; give rows in the order of time"
            )
    if not rows:
        raise ValueError(f"{file}: no row below the columns; give one at least")
    return rows


def _number(text: str, name: str, at: str) -> float:
    """Return a checked number of a column."""
    try:
        value: float | str = float(text)
    except ValueError:
        value = text  # which the check refuses
    number: float = check(Annotated[float, COLUMNS[name]], value, f"{at}: {name}")
    return number


def lead(leader: Vehicle, path_s: float, dt: float, path: LeaderPath = leader_twist) -> float:
    """Move the leader along its path by `dt`, against the current; return its new time there, s."""
    linear, angular = path(path_s + dt / 2)
    leader.step(linear - leader.rotation.T @ leader.sea.current, angular, dt)
    return path_s + dt
