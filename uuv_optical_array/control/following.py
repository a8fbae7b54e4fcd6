"""Whether a follower has its leader, and what it does about it: one state, from start to end.

- ``waiting``: no pose has steered yet.
- ``locked``: the leader's light steers, by the law of `formation`.
- ``coasting``: the light is gone. The follower goes on as the leader was moving, for as long as its
  turns are not likely to lead out of sight of the way that it had.
- ``searching``: it goes to where most of the leaders that may be by now would be seen from
  (`leader_belief`), with the bow to them, within limits of time, distance, depth and turn.
- ``lost``: the search has ended without light. The follower holds where it is, or does what the
  operator has set. Light that comes back is followed again.
- ``disengaged``: the follower is left to others.

Without light it knows its own way by its commands, or by a velocity that is measured. It keeps the
minimum distance to where the lamp was last seen, as the leader may have stopped there, and to where
it is going.

Light that comes back is not believed at once: a track that begins while the vehicles move, of few
and dim images, may be false. Poses have to agree for ``settle_s`` and know their range before they
steer; until then each is a glimpse that guides the search.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.control.formation import (
    FormationController,
    FormationSettings,
    KeepOff,
    LeaderTrack,
    bow_to,
)
from uuv_optical_array.control.leader_belief import Goal, LeaderBelief, SightSettings
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix, wrapped
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.tracking.motion import in_beacon
from uuv_optical_array.estimation.tracking.track import Outlier

StateName = Literal["waiting", "locked", "coasting", "searching", "lost", "disengaged"]
STATES: tuple[StateName, ...] = get_args(StateName)
LostAction = Literal["hold", "surface", "disengage"]

# A place is chosen anew so long after the last choice, where it is not reached, and where it is.
MOST_S, ARRIVED_S, ARRIVED_M = 25.0, 2.0, 1.0
IMAGES_S = 2.0  # without any image until a search would be blind
PASSING_M = 0.5  # beyond the minimum distance, at which a lamp that may have stopped is passed
# By how much it turns to light at the array's edge, rad; so long after the last pose of it, s.
TURN_RAD, PITCH_RAD, TURNING_S = 0.8, 0.2, 1.0
MOST_TURNED_RAD = 0.35  # standard deviation of the angles of a light that came back and steers
MOST_SPEED, MOST_TURN = 2.0, 0.6  # of a leader, m/s and rad/s: beyond them is noise
OTHER_M = 1.0  # from where the leader is expected, where a lamp may be another one
SURFACE_M_PER_S = 0.2
MEASURED_S = 1.0  # age beyond which a measured velocity is not used


@dataclass(frozen=True)
class SearchSettings(SightSettings):
    """What a follower does without light."""

    coast_s: Annotated[
        float, Quantity("without light until it searches; its leader may turn later", "s", 0, 60)
    ] = 8.0
    search_time_s: Annotated[
        float, Quantity("without light until the search ends; 0: none", "s", 0, 3600)
    ] = 90.0
    search_start_s: Annotated[
        float, Quantity("without light at the start until it searches; 0: never", "s", 0, 600)
    ] = 5.0
    search_distance_m: Annotated[
        float, Quantity("farthest from where the light went", "m", 0, 1000)
    ] = 40.0
    search_depth_m: Annotated[
        float, Quantity("farthest above and below where the light went", "m", 0, 100)
    ] = 3.0
    search_turn_deg: Annotated[
        float, Quantity("farthest from the heading at which the light went", "deg", 0, 180)
    ] = 150.0
    settle_s: Annotated[
        float, Quantity("for which poses agree before light that came back steers", "s", 0, 10)
    ] = 1.0
    when_lost: Annotated[
        LostAction, Quantity("what follows a search in vain: hold the place, rise, or disengage")
    ] = "hold"


class State(NamedTuple):
    """What the follower does.

    - name: one of `STATES`.
    - since_s: since when, s, on the clock of the stamps; nan before the first command.
    - reason: why, in words.
    """

    name: StateName
    since_s: float
    reason: str


class Following:
    """Keep station while there is light, and find the leader again when it is gone."""

    def __init__(
        self, settings: FormationSettings, search: SearchSettings = SearchSettings()
    ) -> None:
        self._law = FormationController(settings)
        self._begin()
        self.configure(settings, search)

    def _begin(self) -> None:
        self.state = State("waiting", math.nan, "no pose has come yet")
        self._dark: _Dark | None = None
        self._trusted = True  # whether poses steer without having to settle
        self._settling: list[float] = []  # stamps of the poses that agree
        self._image_s = -math.inf
        self._brightest: tuple[float, float] | None = None
        self._began_s = math.nan  # when the first image came
        self._twist: Array = np.zeros(5)  # commanded last
        self._measured: tuple[float, Array] | None = None

    def configure(
        self, settings: FormationSettings, search: SearchSettings = SearchSettings()
    ) -> None:
        """Use other settings from now on; what is known of the leader stays."""
        self._law.configure(settings)
        self._settings, self._search = settings, search

    def engage(self, wanted: bool, now_s: float) -> None:
        """Steer from the next pose on, or leave the follower to others; nothing is remembered."""
        self._law = FormationController(self._settings)
        self._begin()
        if not wanted:
            self.state = State("disengaged", now_s, "the follower is left to others")

    def looked(self, stamp_s: float, brightest: tuple[float, float] | None = None) -> None:
        """Note that an image was taken, s, whether it shows light or not.

        A search goes on only while images come, as it would be blind without. Where the light has
        no pose, it turns to its brightest place: to port and up of the array's middle, as shares
        of its half width, from -1 to 1; ``None``: there is no light.
        """
        self._image_s, self._brightest = stamp_s, brightest
        if math.isnan(self._began_s):
            self._began_s = stamp_s

    def moved(self, stamp_s: float, linear: ArrayLike, angular: ArrayLike) -> None:
        """Take the follower's measured velocity, m/s and rad/s, ``(3,)`` each, in its frame.

        While it comes, it takes the place of the commands in the dark. It is through the water, as
        these are: a current carries the leader, too.
        """
        self._measured = stamp_s, np.concatenate([linear, np.asarray(angular)[1:]]).astype(float)

    def search(self, now_s: float) -> None:
        """Search for the leader now, from where the follower is, and for the whole time."""
        if self._dark is None:
            self._go_dark(now_s, self._law.seen(now_s))
        assert self._dark is not None
        self._dark.search_from_s = self._dark.age_s
        self._to("searching", now_s, "it was told to")

    def update(
        self, stamp_s: float, pose: ArrayLike, covariance: ArrayLike, rate: ArrayLike
    ) -> None:
        """Take a relative pose and its rate.

        Arguments and errors are those of `FormationController.update`; without light also Outlier
        for a lamp where the leader cannot be yet.
        """
        if self._dark is None and self.state.name == "locked" and self._law.seen(stamp_s) is None:
            # No command has come since the light went.
            self._lose_light(stamp_s)
        dark = self._dark
        if dark is None:
            self._law.update(stamp_s, pose, covariance, rate)
            if self.state.name == "waiting" and self._settled(stamp_s):
                self._to("locked", stamp_s, "the leader's light steers")
            return
        pose, covariance = np.array(pose, dtype=float), np.array(covariance, dtype=float)
        if self.state.name == "coasting":
            dark.check(pose, covariance)
        try:
            self._law.update(stamp_s, pose, covariance, rate)
        except NoPose:
            self._settling.clear()
            dark.glimpse(pose, covariance)
            raise
        dark.glimpse(pose, covariance)
        if covariance[3:, 3:].trace() > MOST_TURNED_RAD**2:  # a heading to go by is to be known
            self._settling.clear()
        elif self._settled(stamp_s):
            self._to("locked", stamp_s, f"light came back {dark.found(pose)}")
            self._dark = None

    def _settled(self, stamp_s: float) -> bool:
        """Say whether poses up to this one have agreed for long enough."""
        timeout_s = self._settings.light_timeout_s
        if self._settling and not 0 <= stamp_s - self._settling[-1] <= timeout_s:
            self._settling.clear()
        self._settling.append(stamp_s)
        return stamp_s - self._settling[0] >= self._search.settle_s

    def command(self, now_s: float) -> tuple[Array, Array] | None:
        """Return the twist to command at the present, s; ``None`` where there is nothing to do.

        It is in the follower's frame, m/s and rad/s, shape ``(3,)`` each.
        """
        if self.state.name == "disengaged":
            return None
        if self._dark is None:
            if self.state.name == "waiting":
                self._begin_search(now_s)
                return None
            if self._law.seen(now_s) is not None:
                return self._sent(self._law.command(now_s))
            self._lose_light(now_s)
        dark = self._dark
        assert dark is not None
        dark.advance(now_s, self._own_twist(now_s))
        if not self._goes_on(now_s, dark):
            return np.zeros(3), np.zeros(3)
        return self._sent(self._driven(now_s, dark))

    def _lose_light(self, now_s: float) -> None:
        self._go_dark(now_s, self._law.last)
        self._to("coasting", now_s, "the light is gone; the leader is taken to go on")

    def _begin_search(self, now_s: float) -> None:
        """Search from the start, where images come that show no light."""
        start_s = self._search.search_start_s
        if start_s == 0 or not self._images_come(now_s) or self._law.seen(now_s) is not None:
            return
        if now_s - self._began_s > start_s:
            self._go_dark(now_s, None)
            self._to("searching", now_s, "no light since the start")

    def _images_come(self, now_s: float) -> bool:
        return abs(now_s - self._image_s) <= IMAGES_S

    def _goes_on(self, now_s: float, dark: "_Dark") -> bool:
        """Go on from coasting to searching, to its end; say whether the follower still steers."""
        name, s = self.state.name, self._search
        if name == "coasting" and dark.age_s > s.coast_s:
            name = "searching"
            self._to(name, now_s, "the leader may have turned; the likely places are looked at")
        if name != "searching":
            return True
        why = ""
        if dark.age_s - dark.search_from_s > s.search_time_s:
            why = f"no light for {s.search_time_s:g} s"
        elif not self._images_come(now_s):
            why = "no image comes, so that a search would be blind"
        if why:
            self._to("lost", now_s, f"{why}; it is told to {s.when_lost}")
            dark.held = dark.own.copy()
            if s.when_lost == "disengage":
                self._to("disengaged", now_s, f"{why}; the follower is left to others")
                return False
        return True

    def _driven(self, now_s: float, dark: "_Dark") -> tuple[Array, Array]:
        if self.state.name == "coasting":
            error, speed, to_body, lamps = dark.coast()
        elif self.state.name == "searching":
            error, speed, to_body, lamps = dark.search(now_s, self._brightest)
        else:
            rise = SURFACE_M_PER_S if self._search.when_lost == "surface" else 0.0
            error, speed, to_body, lamps = dark.hold(rise)
        return self._law.drive(now_s, error, speed, to_body, lamps)

    def _go_dark(self, now_s: float, track: LeaderTrack | None) -> None:
        self._settling.clear()
        self._dark = _Dark(self._settings, self._search, now_s, track, self._law)

    def _own_twist(self, now_s: float) -> Array:
        """Return the follower's own motion, as it is measured or else commanded."""
        if self._measured and abs(now_s - self._measured[0]) <= MEASURED_S:
            return self._measured[1]
        return self._twist

    def _sent(self, command: tuple[Array, Array] | None) -> tuple[Array, Array] | None:
        if command is not None:
            self._twist = np.concatenate([command[0], command[1][1:]])
        return command

    def _to(self, name: StateName, now_s: float, reason: str) -> None:
        self.state = State(name, now_s, reason)


class _Dark:
    """The time without light, in a frame that stays in the water: the lamp's, as the light went.

    - own: where the follower is by its own motion, ``(5,)``.
    - age_s: time without light, s; search_from_s: of it, when a search was told to begin.
    - held: where it was when it gave up.
    """

    def __init__(
        self,
        settings: FormationSettings,
        search: SearchSettings,
        now_s: float,
        track: LeaderTrack | None,
        law: FormationController,
    ) -> None:
        self._settings, self._search = settings, search
        self._station = np.array([*settings.station_m, 0.0, 0.0])
        self._now_s, self._planned_s, self._goal = now_s, -math.inf, Goal(-1, 0.0)
        self._glimpsed_s = -math.inf
        self.age_s, self.search_from_s, self._margin_m = 0.0, 0.0, 0.0
        self._stopped = track is not None  # whether a leader may be where the lamp was seen
        self._track = track
        if track is None:
            self.own = self._station.copy()
            self._belief = LeaderBelief.at_start(search)
        else:
            stamp_s = track.stamp_ns * 1e-9
            way = law.moved_since(track.stamp_ns, now_s)
            self.own = wrapped(track.pose + in_beacon(track.pose, way))
            turn = np.clip(-track.leader_rate[3:], -MOST_TURN, MOST_TURN)
            speed = -track.leader_rate[:3] - _turning(turn, track.pose[:3])
            speed = np.clip(speed, -MOST_SPEED, MOST_SPEED)
            self._belief = LeaderBelief.of_motion(search, speed, turn)
            self._margin_m = track.margin_m
            self.age_s = max(now_s - stamp_s, 0.0)  # a clock may be set back
            self._belief.pass_time(self.age_s)
        self._start, self.held = self.own.copy(), self.own.copy()
        self._stayed = self.own[:3].copy()

    def advance(self, now_s: float, twist: Array) -> None:
        """Move on to the present, s, by the follower's own motion, ``(5,)``."""
        step_s = min(max(now_s - self._now_s, 0.0), 1.0)
        self._now_s = now_s
        self.own = wrapped(self.own + step_s * in_beacon(self.own, twist))
        self.age_s += step_s
        self._belief.advance(step_s, self.own)

    def check(self, pose: Array, covariance: Array) -> None:
        """Raise Outlier for a lamp that is farther off than the leader's is likely to be by now."""
        place, _ = self._belief.seen_at(self.own, pose)
        off = place - self._belief.likeliest()[0]
        assert self._track is not None
        most_m = self._track.reach_m(covariance, off, self.age_s)
        if np.linalg.norm(off) > most_m:
            raise Outlier(
                f"outlier: a lamp {np.linalg.norm(off):.3g} m from where the leader is expected, "
                f"more than {most_m:.2g} m; another lamp, or the leader left its way"
            )

    def glimpse(self, pose: Array, covariance: Array) -> None:
        """Let a pose that is not trusted yet guide the search."""
        goal = self._belief.glimpse(self.own, pose, covariance)
        self._glimpsed_s = self._now_s
        if goal is not None:
            self._goal, self._planned_s = goal, self._now_s

    def found(self, pose: Array) -> str:
        """Say after how long a pose came, and how far its lamp is from where it was expected."""
        place, _ = self._belief.seen_at(self.own, pose)
        off_m = float(np.linalg.norm(place - self._belief.likeliest()[0]))
        where = f", {off_m:.1f} m from where the leader was expected" if self._stopped else ""
        doubt = "; it may be another lamp" if self._stopped and off_m > OTHER_M else ""
        return f"after {self.age_s:.1f} s{where}{doubt}"

    def coast(self) -> tuple[Array, Array, Array, list[KeepOff]]:
        """Return what `FormationController.drive` takes, towards where the station would be."""
        return self._towards(self._belief.newest)

    def _towards(self, k: int) -> tuple[Array, Array, Array, list[KeepOff]]:
        """Return what steers to the station behind a hypothesis of the leader."""
        place, heading = self._belief.places[k], self._belief.headings[k]
        speed, turn = self._belief.motion(k)
        at = rotation_matrix(*heading)
        rel = wrapped(np.concatenate([at.T @ (self.own[:3] - place), self.own[3:] - heading]))
        to_body = rotation_matrix(rel[PITCH], rel[YAW]).T
        moving = np.concatenate([speed + _turning(turn, rel[:3]), turn])
        lamps = [self._lamp(place, at @ speed), *self._last_seen()]
        return wrapped(self._station - rel), moving, to_body, lamps

    def search(
        self, now_s: float, brightest: tuple[float, float] | None
    ) -> tuple[Array, Array, Array, list[KeepOff]]:
        """Return the same, towards the place from which the leader is seen most likely.

        Towards light without a pose, whose `brightest` place is as of `Following.looked`, it turns.
        """
        if brightest is not None and now_s - self._glimpsed_s > TURNING_S:
            to_port, up = brightest
            error = np.array([0.0, 0.0, 0.0, -PITCH_RAD * up, TURN_RAD * to_port])
            lamps = self._last_seen()
            return error, np.zeros(5), rotation_matrix(*self.own[3:]).T, lamps
        goal = self._place(now_s)
        k, s = self._goal.hypothesis, self._search
        moving: Array = np.zeros(3)
        if k >= 0:
            speed, turn = self._belief.motion(k)
            at = rotation_matrix(*self._belief.headings[k])
            moving = at @ (speed + _turning(turn, self._goal.trail * self._station[:3]))
        seen = k if k >= 0 else self._belief.in_sight(goal)
        place = self._belief.places[seen]
        ahead = rotation_matrix(*self._belief.headings[seen]) @ self._belief.motion(seen)[0]
        goal, passing = self._around(goal)
        way = goal - self._start[:3]
        length = float(np.linalg.norm(way))
        if length > s.search_distance_m:
            goal = self._start[:3] + s.search_distance_m / length * way
            moving = np.zeros(3)
        low, high = self._start[2] - s.search_depth_m, self._start[2] + s.search_depth_m
        if not low <= goal[2] <= high:
            goal[2], moving[2] = min(max(goal[2], low), high), 0.0
        pitch, yaw = bow_to(place - self.own[:3])
        most = math.radians(s.search_turn_deg)
        turned = math.remainder(yaw - self._start[YAW], 2 * math.pi)
        yaw = self._start[YAW] + min(max(turned, -most), most)
        pitch = min(max(pitch, -0.3), 0.3)
        error = wrapped(np.array([*goal, pitch, yaw]) - self.own)
        speed5 = np.array([*(np.zeros(3) if passing else moving), 0.0, 0.0])
        to_body = rotation_matrix(*self.own[3:]).T
        lamps = [self._lamp(place, ahead), *self._last_seen()]
        return error, speed5, to_body, lamps

    def _place(self, now_s: float) -> Array:
        """Return the place to look from, chosen anew once it was reached or takes too long."""
        place: Array = self._stayed
        for _ in range(2):
            place = self._stayed
            if self._goal.hypothesis >= 0:
                place = self._belief.place_of(self._goal, self._station)
            arrived = float(np.linalg.norm(place - self.own[:3])) < ARRIVED_M
            if now_s < self._planned_s + (ARRIVED_S if arrived else MOST_S):
                break
            self._planned_s, self._stayed = now_s, self.own[:3].copy()
            fastest = self._settings.max_surge_m_per_s
            self._goal = self._belief.goal(self.own, self._station, fastest)
        return place

    def hold(self, rise_m_per_s: float) -> tuple[Array, Array, Array, list[KeepOff]]:
        """Return the same, towards where the search ended, or upwards."""
        goal = self.held.copy()
        if rise_m_per_s:
            goal[2] = self.own[2]
        speed = np.array([0.0, 0.0, rise_m_per_s, 0.0, 0.0])
        return wrapped(goal - self.own), speed, rotation_matrix(*self.own[3:]).T, []

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
        ahead_m = -float(way @ self.own[:3])
        beside = self.own[:3] + ahead_m * way  # from the lamp to the nearest place of the way
        if not 0 < ahead_m < length or float(np.linalg.norm(beside)) >= least_m:
            return goal, False
        # To the side on which the way leads past, level; to port where it leads through.
        port = np.array([-way[1], way[0], 0.0]) / max(math.hypot(way[0], way[1]), 1e-6)
        side = port * math.copysign(1.0, float(beside @ port) + 0.1)
        to_side = least_m * side - self.own[:3]
        off_m = float(np.linalg.norm(to_side))
        if off_m < PASSING_M:
            return goal, False
        return self.own[:3] + length / off_m * to_side, True

    def _last_seen(self) -> list[KeepOff]:
        return [self._lamp(np.zeros(3), np.zeros(3))] if self._stopped else []

    def _lamp(self, place: Array, velocity: Array) -> KeepOff:
        off = self.own[:3] - place
        range_m = float(np.linalg.norm(off))
        away = off / range_m if range_m > 0 else np.array([-1.0, 0.0, 0.0])
        to_body = rotation_matrix(*self.own[3:]).T
        return KeepOff(range_m - self._margin_m, to_body @ away, -float(away @ velocity))


def _turning(turn: Array, place: Array) -> Array:
    """Return the velocity of a place that turns by a pitch and yaw rate, rad/s, ``(3,)``."""
    return np.cross([0.0, *turn], place)
