"""Where a leader may be after its light went, and from where it would most likely be seen.

When the light goes, the lamp is at the origin of a frame that stays in the water, and the leader
moves as it did last. From then on a fan of hypotheses spreads: each has the leader's speed or, as
one that stopped, none, and a turn rate that goes from the last one to one of its own within
`TURN_S`. Some of those that stopped go on after a while, beside their old way. Their weights tell
how likely they are:

- by a prior, which is that of how leaders turn (`TURNS`), stop (`STOPPED`) and pause (`PAUSED`);
- less and less while the follower would see the lamp of a hypothesis, and no light comes. A lamp
  may stay dark, so that this counts little at first, and places that were found dark may be looked
  at again later.

So a search goes from the likely places to the others, wider as they spread, and comes back. A
glimpse of light, whose pose is not to be trusted yet, adds a hypothesis and weighs the others: by
the pose, and by how bright each would be. In dim light a pose knows little more than on which side
the lamp is, and its brightness says that it is at the edge of the beam. Light without a pose weighs
the others by where on the array it is brightest, and moves each a little to where it fits best.
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.control.leader.motion import (
    EDGE_RAD,
    MIDDLE_STD,
    TURN_S,
    Glow,
    LeaderMotion,
    seen_at,
    slopes,
)
from uuv_optical_array.control.leader.sight import NEAREST_M, SightSettings, bows_of
from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix, wrapped

# Turn rates that a leader may change to, deg/s, and their prior, of yaw and of pitch.
TURNS = (np.array([-6.0, -3.0, -1.5, 0.0, 1.5, 3.0, 6.0]), 2.5)
CLIMBS = (np.array([-1.5, 0.0, 1.5]), 1.0)
MOST_PITCH = 0.3  # rad; beyond it no leader climbs on
TURNING_S = 10.0  # after which a leader that turned goes straight on, and a drift ends
PERSIST = (1.0, 0.3)  # shares of the last turn rate with which hypotheses begin
# Probabilities that a leader without light has changed its speed, each to one of these, m/s: it
# stopped, or stopped and went aside, up, down or back; and that it went on after that.
STOPPED, PAUSED = 0.15, 0.15
# That it goes on beside another lamp that was seen beside it as its own light went.
COMPANY = 0.5
DRIFTS = np.array([[0, 0, 0], [0, 0.3, 0], [0, -0.3, 0], [0, 0, 0.25], [0, 0, -0.25], [-0.5, 0, 0]])
DARK_S = 30.0  # time constant of the probability that the lamp still gives no light
LOOK_S = 4.0  # of looking at a lit lamp without seeing it, which makes it unlikely by e
AGAIN_S = 60.0  # after which what was seen dark counts again
LEAST = 0.02  # weight, of its prior, that a glimpse elsewhere leaves
# Standard deviation of the logarithm of the expected light, and how many of them count at most,
# because clouds take light, too.
LIGHT_STD, MOST_STDS = 0.7, 4.0
ARRAY_DEG = 70.0  # off the bow, to where detectors see
# Variances of a leader's place and heading beside a hypothesis, m^2 and rad^2, and the standard
# deviation of a glimpse's place, m, beyond which it is vague.
BESIDE, VAGUE_M = np.diag([0.25, 0.25, 0.25, 0.01, 0.01]), 1.0
ARRIVAL_S = 20.0  # a place that is reached this much later is worth 1 / e
# Leaders between the hypotheses: m aside and up, rad of yaw, about half of what these are apart
# when a drift ends, and how many such standard deviations they are from one.
STEPS = np.array(list(product((-1, 0, 1), repeat=3)))
BETWEEN = STEPS * np.array([1.5, 1.25, math.radians(10.0)])
# How many likely leaders are considered, from how far behind, in stations, and for how long; the
# factor by which another place must be better than staying.
LIKELY, TRAIL, LOOKS_S, STAYS = 24, 2.0, 8.0, 1.1
# Starts: where the lamp may be beside the place where a follower on station would see it.
ASIDE_M, AHEAD_M, ABOVE_M = (-6.0, -3.0, 0.0, 3.0, 6.0), (-3.0, 0.0, 4.0, 8.0), (-1.5, 0.0, 1.5)
TURNED_DEG = (-120.0, -60.0, 0.0, 60.0, 120.0)
START_STD = np.array([5.0, 3.5, 1.5, math.radians(60.0)])  # ahead, aside, above, turned


class Goal(NamedTuple):
    """A place to look from: `trail` stations behind a hypothesis; -1: where the follower is."""

    hypothesis: int
    trail: float


class LeaderBelief:
    """A fan of hypotheses of the leader, in a frame that stays in the water.

    - places, headings: of each lamp, m, ``(n, 3)``, and pitch and yaw of the leader, ``(n, 2)``.
    - weights: ``(n,)``, > 0.
    - age_s: time since the light went, s.
    """

    def __init__(
        self,
        settings: SightSettings,
        prior: Array,
        starts: Array,
        speeds: Array,
        rates: Array,
        turns: Array,
    ) -> None:
        """Begin with hypotheses.

        - prior: ``(n,)``; starts: places, m, pitch and yaw, rad, ``(n, 5)``.
        - speeds: in a leader's axes, m/s, ``(n, 3)``.
        - rates, turns: of pitch and yaw, rad/s, now and later, ``(n, 2)``.
        """
        self._settings = settings
        # One more for a glimpse; until there is one, it is the likeliest once more.
        best = int(prior.argmax())

        def with_glimpse(rows: Array) -> Array:
            return np.concatenate([rows, rows[best : best + 1]])

        self._prior = np.append(prior, LEAST * prior.min())
        self.weights = self._prior.copy()
        starts = with_glimpse(starts)
        self._places, self._headings = starts[:, :3].copy(), starts[:, 3:].copy()
        self._put(np.zeros((len(starts), 3)))
        self._speeds, self._rates = with_glimpse(speeds), with_glimpse(rates)
        self._turns = with_glimpse(turns)
        self._after_drift = self._speeds.copy()  # after `TURNING_S`
        self._company: int | None = None  # the hypothesis of a leader beside another lamp
        self.age_s = 0.0

    @classmethod
    def of_motion(
        cls, settings: SightSettings, leader: LeaderMotion, company: bool = False
    ) -> "LeaderBelief":
        """Return what is known of a leader as its light goes; it may be in `company`."""
        (turns, turn_std), (climbs, climb_std) = TURNS, CLIMBS
        grids = np.meshgrid(climbs, turns, PERSIST, indexing="ij")
        climb, yaw, persist = (grid.ravel() for grid in grids)
        going = np.exp(-((yaw / turn_std) ** 2 + (climb / climb_std) ** 2) / 2)
        drifts = np.vstack([DRIFTS, DRIFTS])
        drifting = np.repeat([STOPPED, PAUSED], len(DRIFTS)) / len(DRIFTS)
        prior = np.concatenate([(1 - STOPPED - PAUSED) / going.sum() * going, drifting])
        still = np.zeros((len(drifts), 2))
        later = np.vstack([np.radians(np.stack([climb, yaw], axis=1)), still])
        rates = np.vstack([np.outer(persist, leader.turn), still])
        speeds = np.vstack([np.tile(leader.speed, (len(climb), 1)), drifts])
        starts = np.tile(np.concatenate([leader.place, leader.heading]), (len(prior), 1))
        if company:  # as those that go straight on, until `accompany` says where
            straight = int(going.argmax())
            prior = np.append((1 - COMPANY) * prior, COMPANY)
            starts, speeds, rates, later = (
                np.concatenate([rows, rows[straight : straight + 1]])
                for rows in (starts, speeds, rates, later)
            )
        self = cls(settings, prior, starts, speeds, rates, later)
        self._after_drift[len(going) : len(going) + len(DRIFTS)] = 0.0
        self._after_drift[len(going) + len(DRIFTS) : len(going) + len(drifts)] = leader.speed
        self._company = len(prior) - 1 if company else None
        return self

    @classmethod
    def at_start(cls, settings: SightSettings) -> "LeaderBelief":
        """Return what is known before any light: the follower may be near its station, or not."""
        grids = np.meshgrid(AHEAD_M, ASIDE_M, ABOVE_M, np.radians(TURNED_DEG), indexing="ij")
        off = np.stack([grid.ravel() for grid in grids], axis=1)
        prior = np.exp(-((off / START_STD) ** 2).sum(axis=1) / 2)
        starts = np.insert(off, 3, 0.0, axis=1)
        none = np.zeros((len(prior), 2))
        return cls(settings, prior / prior.sum(), starts, np.zeros((len(prior), 3)), none, none)

    def _put(self, beside: Array) -> None:
        """Put each leader beside its hypothesis, by so much, ``(n, 3)``."""
        self._beside = beside
        self.places, self.headings = self._aside(beside)

    def _aside(self, beside: Array) -> tuple[Array, Array]:
        """Return places and headings of leaders beside all hypotheses, as of `BETWEEN`."""
        aside, up, yaw = np.moveaxis(beside[..., None], -2, 0)
        at = rotation_matrix(*self._headings.T)
        places = self._places + aside * at[:, :, 1] + up * at[:, :, 2]
        return places, self._headings + np.concatenate([0.0 * yaw, yaw], axis=-1)

    def advance(self, step_s: float, own: Array) -> None:
        """Let time pass, s, in which the follower, at `own`, ``(5,)``, saw no light."""
        seen = self._settings.sees(own[:3], self.places, self.headings)
        lit = 1 - math.exp(-self.age_s / DARK_S)
        self.weights[seen & _ahead(own, self.places)] *= math.exp(-step_s * lit / LOOK_S)
        self.weights += (self._prior - self.weights) * (1 - math.exp(-step_s / AGAIN_S))
        self.pass_time(step_s)

    def accompany(self, place: Array, heading: Array, speed: Array, turn: Array) -> Goal:
        """Take where a leader in company would be, and how it moves; return the place behind it.

        Arguments are those of `LeaderMotion`. Where no company is known of nothing changes.
        """
        k = self._company
        if k is None:
            return Goal(-1, 0.0)
        self._places[k], self._headings[k], self._beside[k] = place, heading, 0.0
        self._speeds[k], self._after_drift[k] = speed, speed
        self._rates[k], self._turns[k] = turn, turn
        self._put(self._beside)
        return Goal(k, 1.0)

    def pass_time(self, step_s: float) -> None:
        """Let time pass, s, without looking."""
        self.age_s += step_s
        kept = math.exp(-step_s / TURN_S)
        turns = self._turns if self.age_s < TURNING_S else 0.0
        if self.age_s >= TURNING_S:
            self._speeds = self._after_drift
        self._rates = kept * self._rates + (1 - kept) * turns
        self._places, self._headings = self._after(step_s, self._places, self._headings)
        self._put(self._beside)

    def _after(self, time_s: float | Array, places: Array, headings: Array) -> tuple[Array, Array]:
        """Return places and headings after a time, s; rates change little meanwhile.

        Of several times, ``(m, 1, 1)``, they are ``(m, n, 3)`` and ``(m, n, 2)``.
        """
        ahead_s = time_s / 2
        turned = headings + self._rates * ahead_s
        turned[..., 0] = np.clip(turned[..., 0], -MOST_PITCH, MOST_PITCH)
        arc = np.sinc(self._rates[:, 1:] * ahead_s / math.pi)  # chord over arc
        turns = rotation_matrix(turned[..., 0], turned[..., 1])
        ways = np.einsum("...nij,nj->...ni", turns, self._speeds)
        headings = headings + self._rates * time_s
        headings[..., 0] = np.clip(headings[..., 0], -MOST_PITCH, MOST_PITCH)
        return places + ways * time_s * arc, headings

    def glimpse(self, own: Array, pose: Array, covariance: Array, light: float | None) -> Goal:
        """Weight the hypotheses by a pose that is not trusted yet; return the place behind it.

        What the pose leaves open, such as the heading in dim light, is that of the hypotheses that
        it fits. A vague place is viewed from farther away.

        - own: where the follower is, ``(5,)``; `pose`, `covariance`: as of a track.
        - light: of its image, as of `SightSettings.on_axis`; ``None``: it is not known.
        """
        self._put(0.0 * self._beside)
        place, heading = seen_at(own, pose)
        sees = slopes(pose, heading)
        spread = sees @ covariance @ sees.T
        off = np.concatenate([self.places - place, self.headings - heading], axis=1)
        off[:, YAW] = np.remainder(off[:, YAW] + math.pi, 2 * math.pi) - math.pi
        distance = np.einsum("ni,ij,nj->n", off, np.linalg.inv(4 * spread + BESIDE), off)
        if light is not None:
            distance += self._darker(own, self.places, self.headings, light)
        likelihood = np.exp(-distance / 2)
        self.weights = self._prior * np.maximum(likelihood, LEAST)
        fits = (self._prior * np.maximum(likelihood, LEAST**2))[:-1]
        fits /= fits.sum()
        mean = fits @ off[:-1]
        about = off[:-1] - mean
        known = about.T @ (fits[:, None] * about) + BESIDE
        gain = spread @ np.linalg.inv(spread + known)
        self._places[-1] = place + (gain @ mean)[:3]
        self._headings[-1] = wrapped(heading + (gain @ mean)[3:], 1)
        self._put(self._beside)
        self.weights[-1] = self._prior.sum()
        vague = np.linalg.eigvalsh((gain @ known)[:3, :3])[-1] > VAGUE_M**2
        return Goal(len(self.weights) - 1, TRAIL if vague else 1.0)

    def face(self, own: Array, glow: Glow, light: float | None) -> None:
        """Weight the hypotheses by where the array is lit brightest, in place of a pose.

        Each is moved beside where it was to where it would light the array most like it.
        """
        count = len(self._prior)
        places, headings = self._aside(np.repeat(BETWEEN[:, None], count, axis=1))
        places, headings = places.reshape(-1, 3), headings.reshape(-1, 2)
        distance = self._unlike(own, places, headings, glow)
        if light is not None:
            distance += self._darker(own, places, headings, light)
        distance = distance.reshape(-1, count) + np.square(STEPS).sum(axis=1, keepdims=True)
        self._put(BETWEEN[distance.argmin(axis=0)])
        self.weights = self._prior * np.maximum(np.exp(-distance.min(axis=0) / 2), LEAST)

    def _unlike(self, own: Array, places: Array, headings: Array, glow: Glow) -> Array:
        """Return how improbable the brightest place of the array is, as a squared distance.

        It is towards the lamp, and towards the axis of its beam, where this is brighter.
        """
        to_lamps = places - own[:3]
        ranges = np.maximum(np.linalg.norm(to_lamps, axis=1), NEAREST_M)
        bows = bows_of(headings)
        to_axes = to_lamps - np.einsum("ni,ni->n", bows, to_lamps)[:, None] * bows
        body = rotation_matrix(own[PITCH], own[YAW])
        ways = ((to_lamps + to_axes) / (2 * ranges[:, None])) @ body[:, 1:]
        off = np.clip(ways / EDGE_RAD, -1.0, 1.0) - [glow.to_port, glow.up]
        behind = MOST_STDS**2 * ~_ahead(own, places)
        return np.asarray(np.square(off * EDGE_RAD / MIDDLE_STD).sum(axis=1) + behind)

    def _darker(self, own: Array, places: Array, headings: Array, light: float) -> Array:
        """Return how improbable a light is of lamps, as a squared distance."""
        off = np.abs(self._settings.light(own[:3], places, headings) - light)
        return np.asarray(np.square(np.minimum(off / LIGHT_STD, MOST_STDS)))

    def forget_glimpse(self) -> None:
        """Discard what was glimpsed as false."""
        self.weights = self._prior.copy()
        self._put(0.0 * self._beside)

    def goal(self, own: Array, station: Array, speed_m_per_s: float) -> Goal:
        """Return the place from which most leaders would be seen, and soon, for a while.

        It is where the follower is, or behind one of the likely leaders: at its station, or so many
        stations behind (`TRAIL`), from where the view is wider.
        """
        likely = np.argsort(-self.weights)[:LIKELY].tolist()
        goals = [Goal(k, trail) for k in likely for trail in (1.0, TRAIL)]
        places = np.array([self.place_of(goal, station) for goal in goals])
        arrivals_s = np.linalg.norm(places - own[:3], axis=1) / speed_m_per_s
        arrivals_s = np.minimum(arrivals_s, ARRIVAL_S)
        ways = [rotation_matrix(*self.headings[k]) @ self._speeds[k] for k in likely]
        velocities = np.repeat(ways, 2, axis=0)
        places += arrivals_s[:, None] * velocities
        # All at once, and staying first: one by one they would take ten times as long.
        worths = self._worths(
            np.vstack([own[:3], places]),
            np.vstack([np.zeros(3), velocities]),
            np.append(0.0, arrivals_s),
        )
        worths *= np.append(STAYS, np.exp(-arrivals_s / ARRIVAL_S))
        return [Goal(-1, 0.0), *goals][int(worths.argmax())]

    def _worths(self, places: Array, velocities: Array, arrivals_s: Array) -> Array:
        """Return the weight of the leaders that are seen from moving places, at arrival and on.

        - places, velocities: m and m/s, ``(m, 3)``; arrivals_s, returned: ``(m,)``.
        """
        worths = np.zeros(len(places))
        for later_s in (0.0, LOOKS_S):
            time_s = (arrivals_s + later_s)[:, None, None]
            lamps, headings = self._after(time_s, self.places, self.headings)
            at = (places + later_s * velocities)[:, None]
            worths += self._settings.sees(at, lamps, headings) @ self.weights / 2
        return worths

    def place_of(self, goal: Goal, station: Array) -> Array:
        """Return the place of a goal behind a leader by now, m, ``(3,)``.

        It is the station, or farther off on the axis of the lamp, where the view is widest.
        """
        k, trail = goal
        behind = station[:3]
        if trail > 1.0:
            behind = np.array([-trail * float(np.linalg.norm(behind)), 0.0, 0.0])
        return self.places[k] + rotation_matrix(*self.headings[k]) @ behind

    def in_sight(self, place: Array) -> int:
        """Return the likeliest leader of those that would be seen from a place, or of all."""
        seen = self._settings.sees(place, self.places, self.headings)
        return int(np.argmax(self.weights * (seen if seen.any() else 1.0)))

    def motion(self, k: int) -> tuple[Array, Array]:
        """Return speed, m/s, ``(3,)``, and pitch and yaw rate, rad/s, of a hypothesis, its axes."""
        return self._speeds[k], self._rates[k]


def _ahead(own: Array, places: Array) -> NDArray[np.bool_]:
    """Say on which places the array of a follower at `own`, ``(5,)``, looks, ``(n,)``."""
    to_places = places - own[:3]
    bow = rotation_matrix(own[PITCH], own[YAW])[:, 0]
    least = math.cos(math.radians(ARRAY_DEG)) * np.linalg.norm(to_places, axis=1)
    return np.asarray(to_places @ bow > least)
