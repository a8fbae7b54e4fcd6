"""What a follower does without light: by which of its motions it goes, to where, and how far.

All places are in a frame that stays in the water: that of the lamp when its track began. If no
instrument of the follower measures the vertical, its z counts as up, as if the leader was level
then. One limit of depth, from where light steered last, holds in all states, because surface and
bottom are as near while a follower coasts as while it searches. `steering` keeps it, so that no
goal, attitude or lamp to keep off leads beyond it.
"""

import math
from copy import copy
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np

from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.leader.belief import Goal, LeaderBelief
from uuv_optical_array.control.leader.motion import LIKELY, Glow, LeaderMotion, turning
from uuv_optical_array.control.leader.other_lamp import OtherLamp, within_reach
from uuv_optical_array.control.leader.sight import SightSettings
from uuv_optical_array.control.leader.told_motion import Told
from uuv_optical_array.control.steering import Aim, KeepOff, bow_to, polar
from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix, wrapped
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.signature.faint_light import BEFORE_S

LostAction = Literal["hold", "surface", "disengage"]

# Times after which another place is chosen, not reached and reached, and what counts as reached.
MOST_S, ARRIVED_S, ARRIVED_M = 25.0, 2.0, 1.0
GLIMPSE_S = 8.0  # time for which a glimpse guides the search if no other follows
PASSING_M = 0.5  # beyond the minimum distance, at which a lamp that may have stopped is passed
STEADY_RAD = 0.3  # turn that leaves of a slope of daylight less than shows as faint light
POSED_S = 1.0  # time for which a glimpsed pose says more than where the light is brightest
SURE_M = 1.0  # standard deviation of where the leader is, m, beyond which a pose has to settle
OTHER_M = 1.0  # from where the leader is expected, where a lamp may be another one
DOUBT = "it may be another lamp"
UP: Array = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class SearchSettings(SightSettings):
    """What a follower does without light."""

    coast_s: Annotated[
        float,
        Quantity("time without a sign of the leader after which the follower searches", "s", 0, 60),
    ] = 8.0
    search_time_s: Annotated[
        float,
        Quantity(
            "longest search, counted from the last sign of the leader before it; without one, or "
            "by ~/search, from its own start; 0: no search",
            "s",
            0,
            3600,
        ),
    ] = 90.0
    search_start_s: Annotated[
        float,
        Quantity(
            "time from the first image after which it searches if no light has steered; 0: never",
            "s",
            0,
            600,
        ),
    ] = 5.0
    search_distance_m: Annotated[
        float,
        Quantity(
            "largest distance of a search from where the follower last saw or heard its leader",
            "m",
            0,
            1000,
        ),
    ] = 40.0
    search_depth_m: Annotated[
        float,
        Quantity(
            "largest change of depth from where light last steered, except to surface", "m", 0, 100
        ),
    ] = 3.0
    search_turn_deg: Annotated[
        float,
        Quantity(
            "largest turn of a search from the heading at which the follower last saw or heard its "
            "leader",
            "deg",
            0,
            180,
        ),
    ] = 150.0
    settle_s: Annotated[
        float,
        Quantity(
            "time for which poses must agree before they begin to steer, unless the leader is "
            "surely there",
            "s",
            0,
            10,
        ),
    ] = 1.0
    when_lost: Annotated[
        LostAction,
        Quantity("action after a search without success: hold the place, rise, or disengage"),
    ] = "hold"


class Seen(NamedTuple):
    """What is known of a leader as its light goes.

    - motion: by all poses that steered; last: the same, as of the last of them.
    - covariance: of the last of them, ``(5, 5)``.
    - margin_m: possible error of the range of the last, m.
    - lit: that range, m, and the peak of its image, as of `Glow`; ``None``: it is not known.
    """

    motion: LeaderMotion
    last: LeaderMotion
    covariance: Array
    margin_m: float
    lit: tuple[float, float] | None


class Darkness:
    """The time without a pose to steer by, in a frame that stays in the water.

    The frame is that of the lamp when its track began.

    - motion: of leader and follower; a leader that was never seen is taken to be at its place.
    - age_s: time without a pose to steer by, s; search_from_s: of it, from when on a search counts.
    - held: where the follower was when it gave up.
    """

    def __init__(
        self,
        settings: FormationSettings,
        search: SearchSettings,
        now_s: float,
        seen: Seen | None = None,
    ) -> None:
        """Begin with what was seen last, if anything was."""
        self._settings, self._search, self._lit = settings, search, seen and seen.lit
        self._station = np.array([*settings.station_m, 0.0, 0.0])
        self._now_s, self._planned_s, self._goal = now_s, -math.inf, Goal(-1, 0.0)
        self._glimpsed_s = self._posed_s = math.inf  # never
        self._glow: Glow | None = None  # of the newest image
        self.search_from_s = 0.0
        self._belief = LeaderBelief.at_start(search)
        self.motion = LeaderMotion(now_s, self._station, np.eye(5))
        self._last = copy(self.motion)  # as something of the leader's light was seen last
        self._margin_m = 0.0
        self._stray_m = 0.0  # largest distance of poses from the expected leader
        self._stopped = seen is not None  # whether the leader may be where it was seen
        if seen is not None:
            self.motion, self._last, self._margin_m = seen.motion, seen.last, seen.margin_m
        # Since something of the leader's light was seen, rad; whole turns count, too.
        self._turned = math.remainder(self.own[YAW] - self._last.own[YAW], 2 * math.pi)
        self.age_s = self.motion.unseen_s
        # Since the light went, and its mean over the images that faint light is compared with, rad.
        self._swung = self._swung_before = 0.0
        self._up = UP
        self._above_m, self._risen_at = 0.0, self._last.own[:3].copy()  # since light steered last
        self._heard_s = now_s - self.age_s  # of what was seen or told last
        self.held = self.own.copy()
        self._stayed = self.own[:3].copy()

    @property
    def leader(self) -> LeaderMotion | None:
        """The leader's motion; ``None``: it was never seen."""
        return self.motion if self._stopped else None

    @property
    def own(self) -> Array:
        """Where the follower is by its own motion, ``(5,)``."""
        return self.motion.own

    @property
    def unseen_s(self) -> float:
        """Time since something of the leader's light was seen, s."""
        return self.motion.unseen_s

    def advance(self, now_s: float, twist: Array, up: Array | None = None) -> None:
        """Move on to the present, s, by the follower's own motion, ``(5,)``.

        `up` is a unit vector in its axes, ``(3,)``; ``None``: it is not measured.
        """
        before = self.own[YAW]
        step_s = self.motion.advance(now_s, twist)
        turn = math.remainder(self.own[YAW] - before, 2 * math.pi)
        self._turned += turn
        self._swung += turn
        self._up = UP if up is None else self._to_body.T @ up
        self._above_m += float(self._up @ (self.own[:3] - self._risen_at))
        self._risen_at = self.own[:3].copy()
        self._now_s = now_s
        self.age_s += step_s
        share = step_s / max(min(self.age_s, BEFORE_S), 1e-9)
        self._swung_before += share * (self._swung - self._swung_before)
        self._belief.advance(step_s, self.own)

    def resume(self, covariance: Array) -> None:
        """Count the leader as seen now, with this covariance, ``(10, 10)``."""
        self.motion.covariance = covariance.copy()
        self.motion.unseen_s = 0.0
        self._note_seen()

    def look(self, glow: Glow | None, coasting: bool) -> None:
        """Use where an image is brightest; a coasting follower takes it for its leader's light."""
        self._glow = glow
        if coasting and glow is not None:
            self.motion.face(glow)
            self._note_seen()

    def hear(self, told: Told | None) -> None:
        """Use the leader's own motion; it counts as seen while that determines where it is."""
        if told is None or told.stamp_s <= self._heard_s:
            return
        self._heard_s = told.stamp_s
        known = self.motion.hear(told.twist, told.aged(self._now_s - told.stamp_s))
        beam_m = float(np.linalg.norm(self._station[:3])) * math.sin(
            math.radians(self._search.sight_deg)
        )
        if known and self.motion.place_std_m < beam_m:
            self.motion.unseen_s = 0.0
            self._note_seen()

    def expected(self, pose: Array, covariance: Array) -> bool:
        """Say whether a pose is where the leader surely is; Outlier where it cannot be by now."""
        self.motion.check(pose, covariance)
        self._stray_m = max(self._stray_m, self.motion.off_m(pose))
        likely = self.motion.expects(pose, covariance, LIKELY)
        sure = likely and self.motion.place_std_m < SURE_M
        self.motion.see(pose, covariance)
        self._note_seen()
        return sure

    def see_both(self, other: OtherLamp, pose: Array, covariance: Array) -> None:
        """Correct where the leader is by a pose of the light of its lamp and another one."""
        other.see_both(pose, covariance, self.motion, self._search)
        self._note_seen()

    def _note_seen(self) -> None:
        if self.unseen_s == 0:
            self._last, self._turned = copy(self.motion), 0.0

    def within_reach(self, pose: Array, covariance: Array) -> bool:
        """Say whether the leader can plausibly have reached where a pose has it."""
        off, spread = self.motion.off(pose, covariance)
        return within_reach(off, spread + self.motion.covariance[:5, :5], self.age_s)

    def begin_search(self, from_s: float, other: OtherLamp | None = None) -> None:
        """Search, by a time from `age_s` 0 on, s: the leader may have gone anywhere since.

        It may be in company with another lamp that was seen beside it.
        """
        self.search_from_s = from_s
        self._goal, self._planned_s = Goal(-1, 0.0), -math.inf
        if self._stopped:
            self._belief = LeaderBelief.of_motion(self._search, self._last, other is not None)
            self._belief.pass_time(self.unseen_s)
        if other is not None:
            self._goal, self._planned_s = self.accompany(other), self._now_s

    def accompany(self, other: OtherLamp) -> Goal:
        """Take where a leader in company with another lamp would be; return the place behind it."""
        place, heading = other.beside(self.own)
        return self._belief.accompany(place, heading, other.motion.speed, other.motion.turn)

    def glimpse(self, pose: Array, covariance: Array) -> None:
        """Let a pose that does not steer yet guide the search."""
        self._goal = self._belief.glimpse(self.own, pose, covariance, self._light(self._glow))
        self._glimpsed_s = self._posed_s = self._planned_s = self._now_s

    @property
    def steady(self) -> bool:
        """Whether the bow points where it did, so that daylight from one side lights it alike."""
        return abs(self._swung - self._swung_before) < STEADY_RAD

    def face(self, glow: Glow) -> None:
        """Let light that gives no pose guide the search."""
        if abs(self._now_s - self._posed_s) <= POSED_S:
            return
        self._belief.face(self.own, glow, self._light(glow))
        if self._now_s - self._planned_s >= ARRIVED_S:
            self._planned_s = -math.inf  # it may be seen from another place now
        self._glimpsed_s = self._now_s

    def _light(self, glow: Glow | None) -> float | None:
        """Return how bright a light is, as of `SightSettings.on_axis`; ``None``: unknown."""
        if glow is None or self._lit is None:
            return None
        range_m, peak = self._lit
        return float(self._search.on_axis(range_m)) + math.log(max(glow.peak, 1e-9) / peak)

    def found(self, pose: Array, others: bool) -> str:
        """Say after how long a pose came, and how far its lamp is from where it was expected.

        It may be another one where that is far, and where `others` were seen.
        """
        after = f"after {self.age_s:.1f} s"
        if not self._stopped:
            return after
        off_m = max(self._stray_m, self.motion.off_m(pose))
        doubt = others or off_m > OTHER_M + self.motion.place_std_m
        return f"{after}, {off_m:.1f} m from where the leader was expected" + f"; {DOUBT}" * doubt

    def coast(self) -> Aim:
        """Return what steers to where the station would be, by the leader's last motion."""
        leader = self.motion
        at = leader.rotation
        rel = leader.pose
        to_body = rotation_matrix(rel[PITCH], rel[YAW]).T
        moving = np.concatenate([leader.speed + turning(leader.turn, rel[:3]), leader.turn])
        lamps = [self._lamp(leader.place, at @ leader.speed), *self._last_seen()]
        return Aim(wrapped(self._station - rel), moving, to_body, lamps, self._depths())

    def search(self, now_s: float) -> Aim:
        """Return the same, towards the place from which the leader is seen most likely."""
        goal = self._place(now_s)
        k, s = self._goal.hypothesis, self._search
        moving: Array = np.zeros(3)
        if k >= 0:
            speed, turn = self._belief.motion(k)
            at = rotation_matrix(*self._belief.headings[k])
            moving = at @ (speed + turning(turn, self._goal.trail * self._station[:3]))
        seen = k if k >= 0 else self._belief.in_sight(goal)
        place = self._belief.places[seen]
        ahead = rotation_matrix(*self._belief.headings[seen]) @ self._belief.motion(seen)[0]
        goal, passing = self._around(goal)
        start = self._last.own
        way = goal - start[:3]
        length = float(np.linalg.norm(way))
        if length > s.search_distance_m:
            goal = start[:3] + s.search_distance_m / length * way
            moving = np.zeros(3)
        pitch, yaw = bow_to(place - self.own[:3])
        pitch = min(max(pitch, -0.3), 0.3)
        error = wrapped(np.array([*goal, pitch, 0.0]) - self.own)
        error[YAW] = self._turn_to(math.remainder(yaw - start[YAW], 2 * math.pi))
        if passing:
            moving = np.zeros(3)
        lamps = [self._lamp(place, ahead), *self._last_seen()]
        moving = np.append(moving, [0.0, 0.0])
        return Aim(error, moving, self._to_body, lamps, self._depths(), straight=True)

    def _turn_to(self, turned: float) -> float:
        """Return what is left to turn, within the limit, from the last heading in the light, rad.

        It goes back the way that it came, so that no tether is wound up.
        """
        most = math.radians(self._search.search_turn_deg)
        return min(max(turned, -most), most) - self._turned

    def _place(self, now_s: float) -> Array:
        """Return the place to look from, chosen anew once it was reached or takes too long."""
        if self._glimpsed_s < now_s - GLIMPSE_S:
            self._glimpsed_s = math.inf
            self._belief.forget_glimpse()
            self._planned_s = -math.inf
        place = self._chosen()
        arrived = float(np.linalg.norm(place - self.own[:3])) < ARRIVED_M
        if now_s < self._planned_s + (ARRIVED_S if arrived else MOST_S):
            return place
        self._planned_s, self._stayed = now_s, self.own[:3].copy()
        fastest = self._settings.max_surge_m_per_s
        self._goal = self._belief.goal(self.own, self._station, fastest)
        return self._chosen()

    def _chosen(self) -> Array:
        if self._goal.hypothesis < 0:
            return self._stayed
        return self._belief.place_of(self._goal, self._station)

    def hold(self, rise_m_per_s: float) -> Aim:
        """Return the same, towards where the search ended, or upwards through all depths."""
        error, depths = wrapped(self.held - self.own), self._depths()
        if rise_m_per_s:
            error[:3] -= error[:3] @ self._up * self._up
            depths = depths[1:]
        speed = np.append(rise_m_per_s * self._up, [0.0, 0.0])
        return Aim(error, speed, self._to_body, [], depths)

    def _depths(self) -> list[KeepOff]:
        """Return the depths that it must not reach, the upper one first."""
        up, most_m = self._to_body @ self._up, self._search.search_depth_m
        return [KeepOff(most_m - self._above_m, -up), KeepOff(most_m + self._above_m, up)]

    @property
    def _to_body(self) -> Array:
        """Rotation from the frame in the water to the follower's, ``(3, 3)``."""
        return rotation_matrix(*self.own[3:]).T

    def _around(self, goal: Array) -> tuple[Array, bool]:
        """Return a goal that leads past the lamp that may have stopped, where it is in the way."""
        if not (self._stopped and self._settings.min_distance_m):
            return goal, False
        least_m = self._settings.min_distance_m + self._margin_m + PASSING_M
        to_goal = goal - self.own[:3]
        length = float(np.linalg.norm(to_goal))
        if length < PASSING_M:
            return goal, False
        way = to_goal / length
        from_lamp = self.own[:3] - self._last.place
        ahead_m = -float(way @ from_lamp)
        beside = from_lamp + ahead_m * way  # from the lamp to the nearest place of the way
        if not 0 < ahead_m < length or float(np.linalg.norm(beside)) >= least_m:
            return goal, False
        # To the side on which the way leads past, level; to port where it leads through.
        port = np.array([-way[1], way[0], 0.0]) / max(math.hypot(way[0], way[1]), 1e-6)
        side = port * math.copysign(1.0, float(beside @ port) + 0.1)
        to_side = least_m * side - from_lamp
        off_m = float(np.linalg.norm(to_side))
        if off_m < PASSING_M:
            return goal, False
        return self.own[:3] + length / off_m * to_side, True

    def _last_seen(self) -> list[KeepOff]:
        """Return the lamp where it was seen last, as the leader may have stopped there since."""
        if not self._stopped:
            return []
        lit_m = -math.inf
        if self._glow is not None and self._lit is not None:
            # A lamp that is seen is not nearer than its brightness allows.
            lit_m = self._glow.nearest_m(*self._lit)
        return [self._lamp(self._last.place, np.zeros(3), lit_m)]

    def _lamp(self, place: Array, velocity: Array, least_m: float = -math.inf) -> KeepOff:
        """Return a lamp to keep off, which is no nearer than a range, m."""
        range_m, away = polar(self.own[:3] - place)
        room_m = self._settings.room_m(max(range_m - self._margin_m, least_m))
        return KeepOff(room_m, self._to_body @ away, -float(away @ velocity))
