"""What happened in a run: truth and estimates by stamp, and how well they agree."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from uuv_optical_array.control.follow_states import Spell, in_words, spells
from uuv_optical_array.control.following import State
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array
from uuv_optical_array.core.settings import Place


@dataclass
class FollowRecord:
    """A run as it was seen on the topics, by stamps in seconds from the leader's start.

    - station_m: commanded station in the lamp's frame, m.
    - leader_path, follower_path: positions in the world, m, shape ``(3,)`` each.
    - truth, estimates: relative poses of the follower, m and rad, shape ``(5,)`` each.
    - images: of the array, counts.
    - states: of the follower, ascending; the first may have begun before the start.
    - sea: by what the sea differs from the scene, in words.
    """

    station_m: Place
    leader_path: dict[float, Array] = field(default_factory=dict)
    follower_path: dict[float, Array] = field(default_factory=dict)
    truth: dict[float, Array] = field(default_factory=dict)
    estimates: dict[float, Array] = field(default_factory=dict)
    images: dict[float, Array] = field(default_factory=dict)
    states: list[State] = field(default_factory=list)
    sea: str = ""

    def errors(self) -> tuple[Array, Array]:
        """Return the stamps, shape ``(m,)``, and estimate less truth there, shape ``(m, 5)``."""
        stamps = [stamp for stamp in self.estimates if stamp in self.truth]
        errors = [self.estimates[stamp] - self.truth[stamp] for stamp in stamps]
        return np.array(stamps), np.reshape(errors, (-1, 5))

    def station_errors(self) -> tuple[Array, Array]:
        """Return the stamps and how far the follower truly was off its station, ``(m, 5)``."""
        station = np.array([*self.station_m, 0.0, 0.0])
        errors = [pose - station for pose in self.truth.values()]
        return np.array(list(self.truth)), np.reshape(errors, (-1, 5))

    def longest_dark_s(self) -> float:
        """Return the longest time without a pose, from the start to the last odometry, s."""
        if not self.truth:
            return np.inf
        stamps = sorted({min(self.truth), max(self.truth), *self.estimates})
        return float(np.max(np.diff(stamps), initial=0.0)) if self.estimates else np.inf

    def spells(self) -> list[Spell]:
        """Return the times in each state, in order, from the start to the last odometry, s."""
        return spells(self.states, 0.0, max(self.truth, default=0.0))

    def lost(self) -> str:
        """Return how the leader was lost at the end, or an empty text; a gap that ended is none."""
        if not self.truth:
            return "it never set off; the log says what it waited for"
        if not self.estimates:
            return "not one pose was estimated"
        if not self.states:
            return "the follower never told its state"
        state = self.states[-1]
        if state.name != "locked":
            return f"{state.name} from {max(state.since_s, 0.0):.1f} s to the end: {state.reason}"
        distance = np.linalg.norm(self.station_errors()[1][-1, :3])
        if distance > np.linalg.norm(self.station_m) / 2:
            return f"the follower ended {distance:.1f} m off its station"
        return ""

    def summary(self) -> str:
        """Return a table of RMS errors by degree of freedom, counts, and times in each state."""
        rows = [f"{'':14}" + "".join(f"{name:>10}" for name in DOF_NAMES)]
        for title, (_, errors) in (("estimate", self.errors()), ("station", self.station_errors())):
            if len(errors):
                rms = zip(np.sqrt((errors**2).mean(axis=0)) * IN_DEGREES, DOF_UNITS, strict=True)
                cells = "".join(f"{value:6.2f} {unit:3}" for value, unit in rms)
                rows.append(f"{title + ' RMS':14}{cells}")
        rows.append(
            f"{len(self.errors()[0])} poses from {len(self.truth)} images; "
            f"longest time without one {self.longest_dark_s():.2f} s"
        )
        if times := self.spells():
            rows.append(in_words(times))
        return "\n".join(rows)


def position_at(path: Mapping[float, Array], stamps_s: Array) -> Array:
    """Return the positions on a path at stamps within it, linear between its own, ``(n, 3)``."""
    known, places = np.array(list(path)), np.array(list(path.values()))
    return np.stack([np.interp(stamps_s, known, axis) for axis in places.T], axis=1)


def least_distance(paths: Sequence[Mapping[float, Array]]) -> float:
    """Return the least distance between any two of several paths, m; infinite for none at once."""
    least = np.inf
    for one, other in combinations(filter(None, paths), 2):
        stamps = np.array([stamp for stamp in one if min(other) <= stamp <= max(other)])
        if len(stamps):
            apart = position_at(one, stamps) - position_at(other, stamps)
            least = min(least, float(np.linalg.norm(apart, axis=1).min()))
    return least
