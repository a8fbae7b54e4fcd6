"""A leader and a follower that does what it is told, by exact poses and no images."""

import numpy as np
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.darkness import SearchSettings
from uuv_optical_array.control.following import Following
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.leader.motion import Glow
from uuv_optical_array.core.errors import NoPose

TICK_S, LIT_S = 0.2, 8.0
STD_M = 0.01
OPEN = FormationSettings(min_distance_m=0.0)
SHORT = SearchSettings(coast_s=4.0, search_time_s=10.0)
TIMEOUT_S = OPEN.light_timeout_s


class Pursuit:
    """A leader at a steady twist, and a follower that does what it is told; both exact.

    The leader is level, or has its bow down by a `bow`, rad.

    Poses are sent while there is `light`, as of a lamp that is `aside` of the leader's, m.
    """

    def __init__(
        self, speed=(0.5, 0.0, 0.0), turn=0.0, formation=OPEN, search=SHORT, station_off=(0, 0, 0)
    ):
        self.following = Following(formation, search)
        self.formation = formation
        self.speed, self.turn = np.array(speed, dtype=float), turn
        self.leader, self.heading, self.bow = np.zeros(3), 0.0, 0.0
        self.own = np.add(formation.station_m, station_off)
        self.attitude = np.zeros(2)  # pitch and yaw
        self.twist = np.zeros(5)
        self.tick = 0
        self.light, self.images, self.aside = True, True, np.zeros(3)
        self.peak = None  # of the image, whose middle is brightest; none: it shows no light
        self.std_m = STD_M  # of poses, as they say
        self.commanded, self.refused, self.states = None, None, []

    @property
    def now(self):
        return self.tick * TICK_S

    @property
    def state(self):
        return self.following.state.name

    def to_leader(self):
        return Rotation.from_euler("ZY", [self.heading, self.bow]).inv()

    def to_world(self):
        return Rotation.from_euler("ZYX", [self.attitude[1], self.attitude[0], 0.0])

    def place(self):
        """Return the follower's place in the leader's frame."""
        return self.to_leader().apply(self.own - self.leader)

    def off_station(self):
        return float(np.linalg.norm(self.place() - self.formation.station_m))

    def step(self):
        following, now = self.following, self.now
        if self.images:
            following.looked(now, None if self.peak is None else Glow(0.0, 0.0, self.peak))
        self.refused = None
        if self.light:
            place = self.place() - self.aside
            own = self.to_leader().apply(self.to_world().apply(self.twist[:3]))
            past = own - self.speed - self.turn * np.array([-place[1], place[0], 0.0])
            rate = [*past, self.twist[3], self.twist[4] - self.turn]
            pose = [*place, self.attitude[0] - self.bow, self.attitude[1] - self.heading]
            try:
                following.update(now, pose, self.std_m**2 * np.eye(5), rate)
            except NoPose as reason:
                self.refused = reason
        self.commanded = following.command(now)
        linear, angular = self.commanded or (np.zeros(3), np.zeros(3))
        self.twist = np.concatenate([linear, angular[1:]])
        # Each by the middle of the step.
        self.attitude += self.twist[3:] * TICK_S / 2
        self.own = self.own + self.to_world().apply(linear) * TICK_S
        self.attitude += self.twist[3:] * TICK_S / 2
        halfway = Rotation.from_euler("ZY", [self.heading + self.turn * TICK_S / 2, self.bow])
        self.leader = self.leader + halfway.apply(self.speed) * TICK_S
        self.heading += self.turn * TICK_S
        self.tick += 1
        if not self.states or self.states[-1] != self.state:
            self.states.append(self.state)

    def run(self, seconds):
        for _ in range(round(seconds / TICK_S)):
            self.step()
        return self

    def until(self, name):
        """Run until a state, a minute at most."""
        end = self.now + 60
        while self.state != name:
            assert self.now < end
            self.step()
        return self


def dark(lit_s=LIT_S, **changes):
    """Return a pursuit whose light has just gone, and the stamp of its last pose."""
    pursuit = Pursuit(**changes).run(lit_s)
    assert pursuit.state == "locked"
    pursuit.light = False
    return pursuit, pursuit.now - TICK_S
