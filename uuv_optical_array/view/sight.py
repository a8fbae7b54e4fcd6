"""What the page shows of one instant, and of those before it in its charts."""

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from uuv_optical_array.control.following import State
from uuv_optical_array.core.geometry import IN_DEGREES, Array, wrapped
from uuv_optical_array.core.settings import Place
from uuv_optical_array.estimation.pipeline import Answer

WINDOW_S = 60.0  # that the charts show


@dataclass(frozen=True)
class Sight:
    """One instant; ``None``: not known."""

    t_s: float  # since the start
    image: Array | None = None
    true_pose: Array | None = None  # of the follower in ``beacon``, m and rad
    pose: Array | None = None  # as estimated
    covariance: Array | None = None
    note: str = ""  # why there is no pose, or what is wrong
    leader: tuple[Array, Array] | None = None  # the lamp's position and rotation in the world
    station_m: Place | None = None  # the follower's commanded position in ``beacon``
    state: State | None = None  # what the follower does, since a time as `t_s`
    lit: tuple[bool, ...] | None = None  # whether each lamp has power

    def stds(self) -> Array:
        """Return the standard deviations of the estimate, m and deg, nan without one, ``(5,)``."""
        if self.covariance is None:
            return np.full(5, np.nan)
        return np.sqrt(self.covariance.diagonal()) * IN_DEGREES

    def errors(self) -> Array:
        """Return estimate less truth, m and deg, nan where either is not known, ``(5,)``."""
        if self.pose is None or self.true_pose is None:
            return np.full(5, np.nan)
        return wrapped(self.pose - self.true_pose) * IN_DEGREES


def note_on(answer: Answer) -> str:
    """Say why an image has no pose, or which of its readings were left out."""
    reason = answer.reason
    if reason:
        return reason if reason.startswith("no light") else f"refused: {reason}"
    return answer.estimate.fault if answer.estimate else ""


def sight_of(
    answer: Answer, t_s: float, image: Array, true_pose: Array | None, **others: Any
) -> Sight:
    """Return an instant by the answer to its image, tracked; `others` are as in `Sight`."""
    track = answer.track
    tracked = (None, None) if track is None else (track.pose, track.covariance)
    return Sight(t_s, image, true_pose, *tracked, **{"note": note_on(answer), **others})


class Window:
    """The last `WINDOW_S` of sights, which the charts show."""

    def __init__(self) -> None:
        self._rows: deque[Array] = deque()
        self.has_truth = False

    def add(self, sight: Sight) -> bool:
        """Add a sight; one that is not later than the last clears the window: return whether."""
        begins = not self._rows or bool(sight.t_s <= self._rows[-1][0])
        if begins:
            self.clear()
        self.has_truth |= sight.true_pose is not None
        pose = np.full(5, np.nan) if sight.pose is None else sight.pose * IN_DEGREES
        value = sight.errors() if self.has_truth else pose
        peak = np.nan if sight.image is None else sight.image.max()
        self._rows.append(np.concatenate([[sight.t_s], value, 3 * sight.stds(), [peak]]))
        while self._rows[0][0] < sight.t_s - WINDOW_S:
            self._rows.popleft()
        return begins

    def poses(self) -> tuple[int, int]:
        """Return how many of the sights have a pose, and how many there are."""
        return sum(not np.isnan(row[6]) for row in self._rows), len(self._rows)

    def clear(self) -> None:
        """Remove all sights."""
        self._rows.clear()
        self.has_truth = False

    def bands(self, dof: int) -> tuple[Array, Array, Array, Array]:
        """Return time, value and its band of 3 sigma, low and high, of a degree of freedom.

        The value is the error, its band about 0, or without truth the estimate, about itself.
        """
        rows = np.array(self._rows).reshape(-1, 12)
        t_s, value, width = rows[:, 0], rows[:, 1 + dof], rows[:, 6 + dof]
        middle = np.zeros(len(rows)) if self.has_truth else value
        return t_s, value, middle - width, middle + width

    def peaks(self) -> tuple[Array, Array]:
        """Return time and the reading of the brightest detector, counts."""
        rows = np.array(self._rows).reshape(-1, 12)
        return rows[:, 0], rows[:, 11]
