"""What a follower does as its leader's light goes and comes back, by exact poses and no images."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from uuv_optical_array.control.darkness import DOUBT, SearchSettings
from uuv_optical_array.control.following import (
    IMAGES_S,
    MEASURED_S,
    SURFACE_M_PER_S,
    Following,
)
from uuv_optical_array.control.formation import RANGE_STDS
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.leader.lamps import LIT
from uuv_optical_array.control.leader.motion import CHANCE, CHANGE, Glow
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.tracking.track import Outlier

TICK_S, LIT_S = 0.1, 8.0
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
            past = own - self.speed - np.cross([0, 0, self.turn], place)
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


def test_the_states_come_in_order_each_at_its_time():
    pursuit, last_s = dark()
    begun = [pursuit.now]
    for name in ("coasting", "searching", "lost"):
        pursuit.until(name)
        begun.append(pursuit.following.state.since_s)
        assert pursuit.following.state.reason
    at = last_s + np.array([TIMEOUT_S, SHORT.coast_s, SHORT.search_time_s])
    late = begun[1:] - at
    assert (late > -1e-9).all()
    assert (late < 1.5 * TICK_S).all()
    assert pursuit.states == ["waiting", "locked", "coasting", "searching", "lost"]
    assert pursuit.run(30).state == "lost"


def test_no_pose_steers_before_those_of_the_start_have_settled():
    pursuit = Pursuit()
    while pursuit.state == "waiting":
        pursuit.step()
    assert pursuit.following.state.since_s == pytest.approx(SHORT.settle_s, abs=1e-9)
    assert pursuit.now < SHORT.settle_s + 2 * TICK_S
    # Until then it was left alone.
    assert not pursuit.own[1:].any()
    assert pursuit.own[0] - OPEN.station_m[0] <= OPEN.max_acceleration_m_per_s2 * TICK_S**2


@pytest.mark.parametrize("speed", [(0.5, 0.0, 0.0), (0.9, 0.1, -0.1), (0.0, 0.0, 0.0)])
def test_while_it_coasts_it_keeps_the_station_of_a_leader_that_goes_straight_on(speed):
    pursuit, _ = dark(speed=speed, lit_s=5.0, search=replace(SHORT, coast_s=20.0))
    pursuit.run(TIMEOUT_S + TICK_S)
    before, since = pursuit.off_station(), pursuit.now
    while pursuit.now < 20:
        pursuit.step()
        # What it was off decays by the gain, once the command has settled.
        decays = math.exp(-OPEN.position_gain_per_s * max(pursuit.now - since - 2.0, 0.0))
        assert pursuit.off_station() < before * decays + 0.01
    assert pursuit.state == "coasting"
    assert np.abs(pursuit.twist[:3] - speed).max() < 0.01


def test_a_follower_that_has_lost_its_leader_holds_where_the_search_ended():
    pursuit, _ = dark()
    pursuit.until("lost")
    ended, way = pursuit.own.copy(), TICK_S * np.linalg.norm(pursuit.twist[:3])
    pursuit.run(30)
    assert pursuit.own == pytest.approx(ended, abs=way + 0.05)  # a tick before it was told
    assert np.abs(pursuit.twist[:3]).max() < 0.01


def test_when_lost_it_surfaces_where_it_is_told_to():
    pursuit, _ = dark(search=replace(SHORT, when_lost="surface"))
    pursuit.until("lost")
    ended, way = pursuit.own.copy(), TICK_S * np.linalg.norm(pursuit.twist[:3])
    pursuit.run(20)
    before = pursuit.own.copy()
    pursuit.run(10)
    assert pursuit.own[:2] == pytest.approx(ended[:2], abs=way + 0.05)
    assert pursuit.own[2] - before[2] == pytest.approx(10 * SURFACE_M_PER_S, rel=0.02)


def test_when_lost_it_disengages_where_it_is_told_to():
    pursuit, _ = dark(search=replace(SHORT, when_lost="disengage"))
    pursuit.until("disengaged")
    assert not pursuit.twist.any()
    pursuit.step()
    assert pursuit.commanded is None


def test_light_where_the_leader_is_sure_to_be_steers_at_once():
    pursuit, _ = dark()
    pursuit.until("coasting").run(1.0)
    pursuit.light, first_s = True, pursuit.now
    pursuit.until("locked")
    assert pursuit.following.state.since_s == pytest.approx(first_s, abs=1e-9)


@pytest.mark.parametrize("name", ["searching", "lost"])
def test_light_that_came_back_steers_once_it_has_settled(name):
    pursuit, _ = dark()
    pursuit.until(name)
    pursuit.speed = np.zeros(3)  # where the follower sees it, not where it was expected
    pursuit.leader = pursuit.own - OPEN.station_m
    pursuit.heading = float(pursuit.attitude[1])
    pursuit.light, first_s = True, pursuit.now
    pursuit.until("locked")
    assert pursuit.following.state.since_s == pytest.approx(first_s + SHORT.settle_s, abs=1e-9)
    assert "light came back after" in pursuit.following.state.reason
    pursuit.run(20)
    assert pursuit.off_station() < 0.05


@pytest.mark.parametrize(("period", "settles"), [(2, True), (3, False)])
def test_poses_of_fewer_than_half_of_the_images_do_not_settle(period, settles):
    """Every other image, or every third: the first and the last of them are poses."""
    pursuit = Pursuit()
    while pursuit.now < 10.0:
        pursuit.light = pursuit.tick % period == 0
        pursuit.step()
    assert (pursuit.state == "locked") == settles


@pytest.mark.parametrize(("refused", "settles"), [(0, True), (2, False)])
def test_images_that_a_busy_estimator_leaves_out_are_not_refused(refused, settles):
    """It takes the newest image, for three ticks, and refuses some between two poses."""
    follower, taken_s, left = Following(OPEN, SHORT), -1.0, 0
    for tick in range(150):
        follower.looked(tick * TICK_S)
        if tick % 3 == 0:
            if taken_s >= 0 and left == 0:
                pose = [*OPEN.station_m, 0, 0]
                follower.update(taken_s, pose, STD_M**2 * np.eye(5), np.zeros(5))
            left = refused if left == 0 else left - 1
            taken_s = tick * TICK_S
        follower.command(tick * TICK_S)
    assert (follower.state.name == "locked") == settles


def test_light_in_glimpses_farther_apart_than_the_timeout_never_settles():
    pursuit, _ = dark()
    pursuit.until("searching")
    pursuit.leader, pursuit.speed = pursuit.own - OPEN.station_m, np.zeros(3)
    while pursuit.state == "searching":
        pursuit.light = pursuit.tick % 13 == 0  # each 1.3 s
        pursuit.step()
    assert pursuit.state == "lost"


def test_strays_of_which_no_two_agree_never_steer():
    pursuit, _ = dark()
    rng = np.random.default_rng(4)
    pursuit.light = True
    for k in range(round((SHORT.search_time_s + 5.0) / TICK_S)):
        pursuit.aside = np.array([9.0, (-1) ** k * rng.uniform(7.5, 15), 0.0])
        pursuit.step()
    assert pursuit.states == ["waiting", "locked", "coasting", "searching", "lost"]


@pytest.mark.parametrize(("aside", "words"), [(1.5, "a lamp 1.5"), (8.0, "a lamp 8")])
def test_a_lamp_that_jumps_is_not_followed_while_the_leader_cannot_be_there(aside, words):
    """An equal lamp beside ours, which goes out; the leader would have to go there at once."""
    (pursuit, _), (without, _) = dark(), dark()
    pursuit.light, pursuit.aside = True, np.array([0.0, aside, 0.0])
    for _ in range(round(TIMEOUT_S / TICK_S)):
        pursuit.step()
        without.step()
        assert isinstance(pursuit.refused, Outlier)
        assert words in str(pursuit.refused)
        np.testing.assert_allclose(pursuit.twist, without.twist, atol=1e-12)


def test_an_equal_lamp_is_held_apart_to_the_end_of_the_search_and_ours_is_found_again():
    """Beside ours, which is out for 10 s; it goes along, so that the leader might be there."""
    pursuit, _ = dark()
    pursuit.light, pursuit.aside = True, np.array([0.0, 1.5, 0.0])
    for _ in range(round(10 / TICK_S)):
        pursuit.step()
        assert isinstance(pursuit.refused, Outlier)
        if pursuit.state != "locked":
            assert "not followed" in pursuit.following.state.reason
    assert pursuit.states == ["waiting", "locked", "coasting", "searching", "lost"]
    pursuit.aside = np.zeros(3)
    pursuit.until("locked").run(20)
    assert DOUBT in pursuit.following.state.reason
    assert pursuit.off_station() < 0.1


@pytest.mark.parametrize(
    ("left", "later", "found"), [(0.5, 0.5, False), (1.0, 1.0, True), (0.5, 1.02 * LIT * 0.5, True)]
)
def test_a_lamp_is_held_apart_where_one_went_out_and_until_another_is_lit(left, later, found):
    """Of the light's peak some is left as the lamp jumps; later it is another."""
    pursuit = Pursuit(search=SHORT)
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.peak, pursuit.aside = 100.0 * left, np.array([0.0, 1.5, 0.0])
    pursuit.until("coasting").run(1.0)
    pursuit.peak = 100.0 * later
    pursuit.run(SHORT.search_time_s)
    assert pursuit.states[-1] == ("locked" if found else "lost")
    if found:
        assert DOUBT in pursuit.following.state.reason


def beside(seconds=6.0, peak=10.0, turn=0.0):
    """Return a pursuit whose lamp went out `seconds` ago, 1.5 m beside another, which is dimmer.

    From then on the leader turns.
    """
    pursuit = Pursuit(search=replace(SHORT, search_time_s=30.0))
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.turn = turn
    pursuit.peak, pursuit.aside = peak, np.array([0.0, 1.5, 0.0])
    return pursuit.run(seconds)


@pytest.mark.parametrize(("after_s", "apart"), [(1.5, True), (2.5, False)])
def test_what_a_lamp_left_is_told_from_the_leader_by_where_that_is_expected(after_s, apart):
    """Poses come again so long after; hard acceleration would have taken the leader there.

    Later the track has taken it up, and it is followed once the leader may be there.
    """
    pursuit = Pursuit()
    pursuit.peak, pursuit.std_m = 100.0, 0.03
    pursuit.run(LIT_S)
    pursuit.peak, pursuit.light, pursuit.aside = 10.0, False, np.array([0.0, 1.5, 0.0])
    pursuit.run(after_s)
    pursuit.light = True
    pursuit.run(SHORT.coast_s + SHORT.settle_s + 1.0)
    assert pursuit.state == ("searching" if apart else "locked")
    assert apart == ("another lamp" in str(pursuit.refused))


def test_light_whose_poses_are_refused_does_not_keep_a_follower_coasting():
    """It is not where the leader may be; that was wrong, and the search finds its leader."""
    pursuit = Pursuit()
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.aside = np.array([0.0, 6.0, 0.0])
    pursuit.run(2 * TIMEOUT_S)
    assert (pursuit.state, "another lamp" in str(pursuit.refused)) == ("coasting", True)
    pursuit.run(SHORT.coast_s + 2 * TIMEOUT_S)
    assert pursuit.states[-2:] == ["searching", "locked"]
    assert DOUBT in pursuit.following.state.reason


def test_a_sharp_pose_after_vague_ones_may_be_as_far_from_these_as_they_err():
    """0.8 m at a standard deviation of 0.3 m, where the leader alone does not get in a tick."""
    pursuit = Pursuit().run(LIT_S)
    pursuit.std_m, pursuit.aside = 0.3, np.array([0.0, 0.8, 0.0])
    pursuit.run(1.0)
    pursuit.std_m, pursuit.aside = STD_M, np.zeros(3)
    for _ in range(10):
        pursuit.step()
        assert pursuit.refused is None
    assert pursuit.state == "locked"


def test_a_lamp_that_dims_at_once_looks_farther_off_and_is_no_other():
    pursuit = Pursuit()
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.peak, pursuit.aside = 50.0, np.array([0.5, 0.0, 0.0])
    for _ in range(30):
        pursuit.step()
        assert pursuit.refused is None
    assert pursuit.state == "locked"


def test_while_the_track_takes_up_what_is_left_it_tells_nothing_of_the_leader():
    """It comes over to the other lamp little by little, as if the leader went there."""
    pursuit = Pursuit()
    pursuit.peak, pursuit.std_m = 100.0, 0.03
    pursuit.run(LIT_S)
    pursuit.peak = 10.0
    for tick in range(15):
        pursuit.aside = np.array([0.0, 0.1 * (tick + 1), 0.0])
        pursuit.step()
        if pursuit.refused:
            break
    assert "another lamp" in str(pursuit.refused)


def test_without_light_of_its_own_it_goes_on_beside_a_lamp_in_company():
    """That turns with the leader from when its light is gone."""
    pursuit = beside(0.5)
    pursuit.turn = 0.05
    alone, _ = dark()
    alone.turn = 0.05
    pursuit.until("coasting").run(2.5)
    alone.until("coasting").run(2.5)
    assert pursuit.state == alone.state == "coasting"
    assert pursuit.off_station() < alone.off_station() / 2


def test_another_lamp_is_known_again_after_a_time_in_which_nothing_was_seen():
    pursuit = beside(3.0)
    assert "another lamp" in str(pursuit.refused)
    pursuit.light, pursuit.peak = False, None
    pursuit.run(20.0)
    assert pursuit.state == "searching"
    pursuit.light, pursuit.peak = True, 10.0
    pursuit.step()
    assert "another lamp" in str(pursuit.refused)


def share_of_other(pursuit, other, sigma_rad=0.18):
    """Return the share of an equal lamp, at a place in the leader's frame, m, in the light."""
    lights = []
    for lamp in (np.zeros(3), other):
        x, y, z = pursuit.place() - lamp
        off = math.atan2(math.hypot(y, z), -x)
        lights.append(math.exp(-((off / sigma_rad) ** 2) / 2) / (x * x + y * y + z * z))
    return lights[1] / sum(lights)


@pytest.mark.parametrize("turn", [0.0, 0.06])
def test_beside_a_second_lamp_that_is_lit_it_steers_by_what_is_nearly_our_light(turn):
    """A pose is of a place between the two. A leader that turned is not where it is expected."""
    other = np.array([0.0, 1.5, 0.0])
    pursuit = beside(seconds=8.0, turn=turn)
    assert pursuit.state == "searching"
    pursuit.peak, begun = 100.0, pursuit.now
    while pursuit.state != "locked":
        share = share_of_other(pursuit, other)
        pursuit.aside = share * other
        pursuit.step()
        assert pursuit.now < begun + 10
        if pursuit.state == "coasting":
            assert "a second lamp was lit" in pursuit.following.state.reason
    assert pursuit.states[-2:] == ["coasting", "locked"]
    assert share < 0.3
    pursuit.aside = np.zeros(3)
    pursuit.run(10)
    assert pursuit.off_station() < 0.1
    assert DOUBT in pursuit.following.state.reason


def test_a_second_lamp_engages_nobody_whose_search_has_ended():
    pursuit = Pursuit(search=replace(SHORT, search_time_s=2.0, when_lost="disengage"))
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.peak, pursuit.aside = 10.0, np.array([0.0, 1.5, 0.0])
    pursuit.until("disengaged")
    pursuit.peak = 100.0
    assert pursuit.run(1.0).state == "disengaged"


def test_a_leader_that_backs_up_hard_in_the_light_is_followed_all_the_way():
    """Brakes from 0.5 m/s and goes astern at 1 m/s within a second: no jump, and no other lamp."""
    pursuit = Pursuit().run(LIT_S)
    farthest = 0.0
    for tick in range(round(12 / TICK_S)):
        pursuit.speed = np.array([max(0.5 - 1.5 * tick * TICK_S, -1.0), 0.0, 0.0])
        pursuit.step()
        farthest = max(farthest, pursuit.off_station())
        assert pursuit.refused is None
        assert pursuit.state == "locked"
    assert farthest < 1.5  # of 4.5 m
    assert pursuit.off_station() < 0.2


@pytest.mark.parametrize(("share", "taken"), [(0.5, True), (2.5, False)])
def test_a_lamp_where_the_leader_cannot_be_by_now_is_another_one(share, taken):
    """Aside of a leader that goes straight on, and may have turned or sped up since."""
    pursuit, last_s = dark()
    pursuit.run(3.0)
    assert pursuit.state == "coasting"
    since = pursuit.now - last_s
    may_be_off = CHANGE[1] ** 2 * since**3 / 3
    aside = share * math.sqrt(chdtri(3, CHANCE) * may_be_off)
    pursuit.light, pursuit.aside = True, np.array([0.0, aside, 0.0])
    pursuit.step()
    assert taken == (pursuit.refused is None)
    if not taken:
        assert isinstance(pursuit.refused, Outlier)
        assert "another lamp" in str(pursuit.refused)


@pytest.mark.parametrize(("share", "doubted"), [(0.8, False), (0.6, True)])
def test_light_that_falls_at_once_may_be_that_of_another_lamp_also_where_it_goes_on(share, doubted):
    pursuit = Pursuit()
    pursuit.peak = 200.0
    pursuit.run(LIT_S)
    since_s = pursuit.following.state.since_s
    pursuit.peak *= share
    pursuit.run(1.0)
    assert pursuit.state == "locked"
    assert pursuit.following.state.since_s == since_s
    assert doubted == ("it may be another lamp" in pursuit.following.state.reason)


@given(
    st.tuples(st.floats(0.0, 1.2), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)),
    st.floats(-0.12, 0.12),
    st.floats(-6.0, -3.0),
)
@example((0.5, 0.0, 0.0), 0.0, -3.0)
@settings(max_examples=8)
def test_in_the_dark_it_keeps_off_where_the_lamp_was_and_within_the_limits(speed, turn, x):
    formation = FormationSettings((x, 0.0, 0.0), min_distance_m=2.0)
    search = SearchSettings(search_distance_m=15.0, search_time_s=35.0)
    pursuit = Pursuit(speed, turn, formation, search, (-1.0, 0.0, 0.0))
    pursuit.std_m = 0.1
    pursuit.run(LIT_S)
    lamp, pursuit.light = pursuit.leader - halfway_back(pursuit), False
    pursuit.run(TIMEOUT_S)
    start = pursuit.own.copy()
    least_m = formation.min_distance_m + RANGE_STDS * pursuit.std_m
    rest_m = formation.max_surge_m_per_s**2 / (2 * formation.max_acceleration_m_per_s2)
    rest_m += formation.max_surge_m_per_s * formation.smoothing_s
    for _ in range(round(38 / TICK_S)):
        pursuit.step()
        assert np.linalg.norm(pursuit.own - lamp) > least_m - 0.05
        assert np.linalg.norm(pursuit.own - start) < search.search_distance_m + rest_m
    assert pursuit.state == "lost"


def halfway_back(pursuit):
    """Return what the leader went since the last pose."""
    middle = Rotation.from_euler("z", pursuit.heading - pursuit.turn * TICK_S / 2)
    return middle.apply(pursuit.speed) * TICK_S


def test_a_follower_that_is_left_to_others_commands_nothing_until_it_is_engaged():
    pursuit, _ = dark()
    pursuit.following.engage(False, pursuit.now)
    pursuit.light = True
    for _ in range(30):
        pursuit.step()
        assert (pursuit.state, pursuit.commanded) == ("disengaged", None)
    pursuit.following.engage(True, pursuit.now)
    engaged_s = pursuit.now
    assert pursuit.state == "waiting"
    pursuit.until("locked")
    assert pursuit.following.state.since_s == pytest.approx(engaged_s + SHORT.settle_s, abs=1e-9)


def test_a_search_ends_where_no_images_come():
    pursuit, _ = dark()
    pursuit.until("searching")
    pursuit.images, last_s = False, pursuit.now - TICK_S
    pursuit.until("lost")
    late_s = pursuit.following.state.since_s - last_s - IMAGES_S
    assert -1e-9 < late_s < 1.5 * TICK_S
    assert "no image comes" in pursuit.following.state.reason


@pytest.mark.parametrize("measured", [True, False])
def test_a_measured_velocity_takes_the_place_of_the_commands_in_the_dark(measured):
    """A follower that is held fast knows by it how far the leader has gone on."""
    pursuit, last_s = dark(speed=(0.2, 0.0, 0.0), search=replace(SHORT, coast_s=20.0))
    off = []
    while pursuit.now < last_s + 8.0:
        if measured:
            pursuit.following.moved(pursuit.now, [0, 0, 0], [0, 0, 0])
        pursuit.step()
        off.append(pursuit.twist[0])
    # The station went on at 0.2 m/s since the last pose; the command lags by its smoothing.
    gone_m = 0.2 * (8.0 - OPEN.smoothing_s) * measured
    assert off[-1] == pytest.approx(0.2 + OPEN.position_gain_per_s * gone_m, abs=0.02)
    # Once nothing is measured, its commands count again: no more is missing.
    pursuit.run(MEASURED_S + 1.0)
    later = pursuit.twist[0]
    pursuit.run(2.0)
    assert pursuit.twist[0] < later + 0.01
