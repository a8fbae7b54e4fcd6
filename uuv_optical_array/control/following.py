"""Whether a follower has its leader, and what it does about it: one state, from start to end.

- ``waiting``: no pose has steered yet.
- ``locked``: the leader's light steers, by the law of `formation`.
- ``coasting``: there is no pose to steer by. The follower goes on as the leader was moving,
  corrected by what is seen of its light and by the motion that it sends (`leader.motion`). Without
  both it does so only until the leader may have turned out of sight.
- ``searching``: it goes to where most hypotheses of the leader would be seen from
  (`leader.belief`), with the bow towards them, within limits of time, distance, depth and turn.
- ``lost``: the search has ended without light. The follower holds where it is, or does what the
  operator has set. Light that comes back is followed again.
- ``disengaged``: the follower is left to others.

Without light it knows its own way by its commands, or by a velocity that is measured. It keeps the
minimum distance to where the lamp was last seen, as the leader may have stopped there, and to where
it is going.

Light that comes back is not believed at once: a track that begins while the vehicles move, of few
and dim images, may be false. Unless the leader is surely there, poses must agree for ``settle_s``
and have a known range before they steer; until then each guides the search. So does light without a
pose, also light that no single image shows, unless the follower has turned.

If the leader's lamp goes out beside an equal one, that one is not followed but kept apart
(`other_lamp`): the light falls suddenly, and what is left is not where the leader is expected.
While the track adapts to it, its poses change nothing of what is known of the leader. In the dark
the leader is assumed to go on beside that lamp while this is possible. If the light grows suddenly,
a second lamp is lit: the follower goes on to where the leader would be. Poses of the light of both
lie between the two, show where they are, and steer only where the leader's is much brighter. The
reason of the state names the doubt. After two lamps have merged and parted, a pose is refused until
the leader may be there.
"""

import math
from copy import copy
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.control.darkness import DOUBT, Darkness, SearchSettings, Seen
from uuv_optical_array.control.formation import FormationController, nanoseconds
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.leader.lamps import LEFT_S, Lamps
from uuv_optical_array.control.leader.motion import Glow, LeaderMotion
from uuv_optical_array.control.leader.other_lamp import goes_on
from uuv_optical_array.control.leader.settling import Settling
from uuv_optical_array.control.leader.told_motion import Message
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.tracking.measurement import checked_pose
from uuv_optical_array.estimation.tracking.track import Outlier

StateName = Literal["waiting", "locked", "coasting", "searching", "lost", "disengaged"]
STATES: tuple[StateName, ...] = get_args(StateName)
DEFAULT_SEARCH = SearchSettings()
IMAGES_S = 2.0  # time without any image after which a search would be blind
MOST_TURNED_RAD = 0.35  # standard deviation of the angles of a light that came back and steers
SURFACE_M_PER_S = 0.2
MEASURED_S = 1.0  # age beyond which a measured velocity is not used


class State(NamedTuple):
    """What the follower does.

    - name: one of `STATES`.
    - since_s: since when, s, on the clock of the stamps; nan before the first command.
    - reason: why, in words.
    """

    name: StateName
    since_s: float
    reason: str


class OwnMotion(NamedTuple):
    """The follower's own motion by its instruments, or its commands.

    - stamp_s: of it, s.
    - twist: through the water, m/s and rad/s, ``(5,)``.
    - up: a unit vector in its axes, ``(3,)``; ``None``: it is not known.
    """

    stamp_s: float
    twist: Array
    up: Array | None


class Following:
    """Keep station while there is light, and find the leader again when it is gone."""

    def __init__(
        self, settings: FormationSettings, search: SearchSettings = DEFAULT_SEARCH
    ) -> None:
        self._law = FormationController(settings)
        self._begin()
        self.configure(settings, search)

    def _begin(self) -> None:
        self.state = State("waiting", math.nan, "no pose has come yet")
        self._dark: Darkness | None = None
        self._settling = Settling()
        self._image_s = -math.inf
        self._glow: Glow | None = None  # of the newest image
        self._refused_s = -math.inf  # stamp of the last pose that is not the leader's
        self._seen: Seen | None = None  # of the leader, by poses that steered
        self._lamps = Lamps()
        self._began_s = math.nan  # when the first image came
        self._twist: Array = np.zeros(5)  # commanded last
        self._measured: OwnMotion | None = None
        self._any_lamp = False  # whether it was told to search, and takes what it finds

    def configure(
        self, settings: FormationSettings, search: SearchSettings = DEFAULT_SEARCH
    ) -> None:
        """Use other settings from now on; what is known of the leader stays."""
        self._law.configure(settings)
        self._settings, self._search = settings, search

    def engage(self, wanted: bool, now_s: float) -> None:
        """Steer once new poses agree, or leave the follower to others; nothing is remembered."""
        self._law = FormationController(self._settings)
        self._begin()
        if wanted:
            self.state = State("waiting", now_s, "no pose has come since it was engaged")
        else:
            self.state = State("disengaged", now_s, "the follower is left to others")

    def looked(self, stamp_s: float, glow: Glow | None = None) -> None:
        """Note that an image was taken, s, and where it is brightest; ``None``: it shows no light.

        A search goes on only while images come, because it is blind without them. Without a pose to
        steer by, light corrects where the leader is expected, and guides a search.
        """
        self._image_s, self._glow = stamp_s, glow
        self._watch_lamps(stamp_s, glow)
        self._settling.look(stamp_s)
        if math.isnan(self._began_s):
            self._began_s = stamp_s
        if glow is not None:
            self._guide(stamp_s, glow)

    def glimmered(self, stamp_s: float, glow: Glow) -> None:
        """Let light that no single image shows, at a stamp, s, guide a search that does not turn.

        Where the follower turns, daylight that comes from one side changes like such light.
        """
        if self._dark is not None and self._dark.steady:
            self._guide(stamp_s, glow)

    def _guide(self, stamp_s: float, glow: Glow) -> None:
        """Let light without a pose guide a search."""
        refused = abs(stamp_s - self._refused_s) <= self._settings.light_timeout_s
        if self._dark is not None and self.state.name == "searching" and not refused:
            self._advance(self._dark, stamp_s)
            self._dark.face(glow)

    def _watch_lamps(self, stamp_s: float, glow: Glow | None) -> None:
        """Say where a lamp seems to have gone out; go on beside another where one was lit."""
        if self.state.name == "disengaged":
            return
        change = self._lamps.look(stamp_s, glow, self._dark is None)
        other, dark = self._lamps.other, self._dark
        if change == "out" and self.state.name == "locked" and DOUBT not in self.state.reason:
            reason = f"{self.state.reason}; light fell at once, so {DOUBT}"
            self.state = self.state._replace(reason=reason)
        if change != "lit" or other is None or dark is None:
            return
        if other.motion.unseen_s < LEFT_S and other.lead(dark.motion):
            dark.resume(other.motion.covariance)
            self._to("coasting", stamp_s, "a second lamp was lit; the leader may be beside it")

    def moved(
        self, stamp_s: float, linear: ArrayLike, angular: ArrayLike, up: Array | None = None
    ) -> None:
        """Take the follower's measured velocity, m/s and rad/s, ``(3,)`` each, in its frame.

        While it comes, it replaces the commands in the dark. Like these it is relative to the
        water: a current carries the leader, too. `up`, a unit vector in its frame, ``(3,)``,
        determines how far it has risen or sunk.
        """
        twist = np.concatenate([linear, np.asarray(angular)[1:]]).astype(float)
        self._measured = OwnMotion(stamp_s, twist, up)

    def leader_moves(self, now_s: float, message: Message) -> None:
        """Use a message of the leader's own motion at the present, s.

        It is combined with what the light shows; without light a coasting follower uses it alone.
        Three consecutive messages must agree with the light before one counts. Errors are those of
        `ToldMotion.take`.
        """
        self._law.leader.take(now_s, message)

    def search(self, now_s: float) -> None:
        """Search for the leader now, from where the follower is, and for the whole time.

        Whatever lamp it finds is followed.
        """
        if self._dark is None:
            self._go_dark(now_s, self._seen)
        assert self._dark is not None
        self._dark.begin_search(self._dark.age_s)
        self._seen = self._lamps.other = None
        self._any_lamp = True
        self._to("searching", now_s, "it was told to")

    def update(
        self,
        stamp_s: float,
        pose: ArrayLike,
        covariance: ArrayLike,
        rate: ArrayLike,
        rate_covariance: ArrayLike | None = None,
    ) -> None:
        """Take a relative pose and its rate.

        Arguments and errors are those of `FormationController.update`; also Outlier for a lamp
        beyond the minimum distance where the leader cannot be.
        """
        nanoseconds("pose: stamp", stamp_s)
        pose, _ = checked_pose(pose, covariance)
        covariance = np.array(covariance, dtype=float)
        if self._dark is None and self.state.name == "locked" and self._law.seen(stamp_s) is None:
            # No command has come since the light went.
            self._lose_light(stamp_s)
        dark, sure = self._dark, False
        try:
            if dark is not None:
                sure = self._expected(dark, stamp_s, pose, covariance)
            elif self.state.name == "locked":
                self._check(stamp_s, pose, covariance)
        except Outlier:
            self._refused_s = stamp_s
            raise
        try:
            self._law.update(stamp_s, pose, covariance, rate, rate_covariance)
        except NoPose:
            self._settling.clear()
            raise
        self._note_seen(stamp_s, pose, covariance)
        if self.state.name in ("locked", "disengaged"):
            return
        timeout_s, settle_s = self._settings.light_timeout_s, self._search.settle_s
        if dark is not None and covariance[3:, 3:].trace() > MOST_TURNED_RAD**2:
            self._settling.clear()  # the heading must be known to steer by it
        elif self._settling.take(stamp_s, timeout_s, settle_s) or sure:
            found = "the leader's light steers"
            if dark is not None:
                found = f"light came back {dark.found(pose, self._lamps.met)}"
            self._to("locked", stamp_s, found)
            self._dark, self._any_lamp = None, False

    def _expected(self, dark: Darkness, stamp_s: float, pose: Array, covariance: Array) -> bool:
        """Correct where the leader is by a pose in the dark; say whether it surely is the leader's.

        Outlier for one that is not, while the follower coasts; else it guides the search.
        """
        self._advance(dark, stamp_s)
        if dark.leader is not None and not self._any_lamp:
            reached = dark.within_reach(pose, covariance)
            self._hold_apart(stamp_s, pose, covariance, dark.leader, reached)
        if self.state.name == "coasting":
            return dark.expected(pose, covariance)
        dark.glimpse(pose, covariance)
        return False

    def _check(self, stamp_s: float, pose: Array, covariance: Array) -> None:
        """Raise Outlier for a pose beyond the minimum distance that does not go on from the last.

        Whatever the leader does, a lamp that goes on from the last pose is its own.
        """
        last, far = self._law.last, np.linalg.norm(pose[:3]) > self._settings.min_distance_m
        if self._seen is None or last is None or stamp_s * 1e9 <= last.stamp_ns or not far:
            return
        expected, since_s = pose - self._law.off(stamp_s, pose), stamp_s - last.stamp_ns * 1e-9
        reached = goes_on(expected, pose, covariance + self._seen.covariance, since_s)
        if self._lamps.other is not None or not reached or self._lamps.taken_up(stamp_s):
            self._hold_apart(stamp_s, pose, covariance, self._seen.motion, reached)

    def _hold_apart(
        self, stamp_s: float, pose: Array, covariance: Array, leader: LeaderMotion, reached: bool
    ) -> None:
        """Raise Outlier for a pose of another lamp, as where the leader cannot have reached it."""
        leaders = [leader, *([self._seen.motion] if self._seen else [])]  # a light that settles
        lamps, dark, twist = self._lamps, self._dark, self._own_twist(stamp_s)
        for motion in leaders:
            motion.advance(stamp_s, twist)
        lamps.advance(stamp_s, twist)
        sight = self._search if self.state.name == "coasting" else None
        whose = lamps.whose(stamp_s, pose, covariance, leaders, reached, sight)
        if whose == "leader":
            return
        if whose == "both" and lamps.other is not None and dark is not None:
            dark.see_both(lamps.other, pose, covariance)
        if whose == "other" and lamps.other is not None and dark is not None:
            lamps.other.lead(dark.motion)
            if self.state.name == "searching":
                dark.accompany(lamps.other)
        raise leader.outlier(pose)

    def _note_seen(self, stamp_s: float, pose: Array, covariance: Array) -> None:
        """Learn the leader's motion, and how bright its lamp is, from a pose.

        Poses that have not settled are counted again from one that agrees with none of them.
        """
        track, motion = self._law.last, self._seen.motion if self._seen else None
        assert track is not None
        if motion is not None:
            motion.advance(stamp_s, self._own_twist(stamp_s))
        if motion is not None and motion.expects(pose, covariance):
            if not self._lamps.taken_up(stamp_s):
                motion.see(pose, covariance)
        else:
            motion = LeaderMotion(stamp_s, pose, covariance)
            self._settling.clear()
        lit = None
        if self._glow is not None:
            lit = float(np.linalg.norm(pose[:3])), self._glow.peak
        self._seen = Seen(motion, copy(motion), covariance, track.margin_m, lit)

    def command(self, now_s: float) -> tuple[Array, Array] | None:
        """Return the twist to command at the present, s; ``None`` where there is nothing to do.

        It is in the follower's frame, m/s and rad/s, shape ``(3,)`` each.
        """
        if self.state.name == "disengaged":
            return None
        self._lamps.advance(now_s, self._own_twist(now_s))
        if self._dark is None:
            if self.state.name == "waiting":
                self._begin_search(now_s)
                return None
            if self._law.seen(now_s) is not None:
                if self._seen:
                    self._seen.motion.advance(now_s, self._own_twist(now_s))
                return self._sent(self._law.command(now_s))
            self._lose_light(now_s)
        dark = self._dark
        assert dark is not None
        self._advance(dark, now_s)
        # Where poses of the light are not the leader's, neither is the light.
        refused = abs(now_s - self._refused_s) <= self._settings.light_timeout_s
        glow = self._glow if self.images_come(now_s) and not refused else None
        dark.look(glow, self.state.name == "coasting")
        if self.state.name == "coasting":
            dark.hear(self._law.leader.told(now_s))
        if not self._goes_on(now_s, dark):
            return np.zeros(3), np.zeros(3)
        return self._sent(self._driven(now_s, dark))

    def _lose_light(self, now_s: float) -> None:
        self._go_dark(now_s, self._seen)
        self._to("coasting", now_s, f"no pose steers; the leader is taken to go on{self._beside()}")

    def _begin_search(self, now_s: float) -> None:
        """Search from the start, where images come that show no light."""
        start_s = self._search.search_start_s
        if start_s == 0 or not self.images_come(now_s) or self._law.seen(now_s) is not None:
            return
        if now_s - self._began_s > start_s:
            self._go_dark(now_s, None)
            self._to("searching", now_s, "no light to steer by since it waits")

    def _beside(self) -> str:
        """Say of another lamp that is in sight."""
        other = self._lamps.other
        seen = other is not None and other.motion.unseen_s < IMAGES_S
        return "; the lamp in sight is where the leader could not get, and not followed" * seen

    def images_come(self, now_s: float) -> bool:
        """Return whether an image came of late, without which a search is blind."""
        return abs(now_s - self._image_s) <= IMAGES_S

    def _goes_on(self, now_s: float, dark: Darkness) -> bool:
        """Go on from coasting to searching, to its end; say whether the follower still steers."""
        name, s = self.state.name, self._search
        most_s = max(s.coast_s, s.search_time_s)  # without a pose, whatever is seen
        if name == "coasting" and (dark.unseen_s > s.coast_s or dark.age_s > most_s):
            name = "searching"
            dark.begin_search(dark.age_s - dark.unseen_s, self._lamps.other)
            self._seen = None  # what comes back has to settle
            why = "the leader may have turned; the likely places are looked at"
            self._to(name, now_s, why + self._beside())
        if name != "searching":
            return True
        why = ""
        if dark.age_s - dark.search_from_s > s.search_time_s:
            why = f"no light for {s.search_time_s:g} s"
        elif not self.images_come(now_s):
            why = "no image comes, so that a search would be blind"
        if why:
            self._to("lost", now_s, f"{why}; it is told to {s.when_lost}{self._beside()}")
            dark.held = dark.own.copy()
            if s.when_lost == "disengage":
                self._to("disengaged", now_s, f"{why}; the follower is left to others")
                return False
        return True

    def _driven(self, now_s: float, dark: Darkness) -> tuple[Array, Array]:
        if self.state.name == "coasting":
            aim = dark.coast()
        elif self.state.name == "searching":
            aim = dark.search(now_s)
        else:
            aim = dark.hold(SURFACE_M_PER_S if self._search.when_lost == "surface" else 0.0)
        return self._law.drive(now_s, aim)

    def _go_dark(self, now_s: float, seen: Seen | None) -> None:
        self._settling.clear()
        self._dark = Darkness(self._settings, self._search, now_s, seen)
        self._advance(self._dark, now_s)

    def _advance(self, dark: Darkness, now_s: float) -> None:
        _, twist, up = self._own_motion(now_s)
        dark.advance(now_s, twist, up)

    def _own_twist(self, now_s: float) -> Array:
        return self._own_motion(now_s).twist

    def _own_motion(self, now_s: float) -> OwnMotion:
        """Return the follower's own motion, as it is measured or else commanded."""
        if self._measured and abs(now_s - self._measured.stamp_s) <= MEASURED_S:
            return self._measured
        return OwnMotion(now_s, self._twist, None)

    def _sent(self, command: tuple[Array, Array] | None) -> tuple[Array, Array] | None:
        if command is not None:
            self._twist = np.concatenate([command[0], command[1][1:]])
        return command

    def _to(self, name: StateName, now_s: float, reason: str) -> None:
        self.state = State(name, now_s, reason)
