"""Where a leader without light may be: closed forms of its way, and what looking tells of it."""

import math
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.leader.belief import (
    AGAIN_S,
    ARRAY_DEG,
    ARRIVAL_S,
    BESIDE,
    DARK_S,
    LEAST,
    LIKELY,
    LOOK_S,
    LOOKS_S,
    MOST_PITCH,
    STAYS,
    TRAIL,
    TURNING_S,
    Goal,
    LeaderBelief,
)
from uuv_optical_array.control.leader.motion import TURN_S, Glow, LeaderMotion, seen_at
from uuv_optical_array.control.leader.sight import SightSettings

SIGHT = SightSettings(sight_m=15.0, sight_deg=20.0)
HALF = SIGHT.sight_m / 2  # where the edge of the beam is `sight_deg` off its axis
STATION = np.array([-HALF, 0.0, 0.0, 0.0, 0.0])
ASTERN = STATION  # where the follower sees a lamp at the origin


def of(prior, starts, speeds=None, rates=None, turns=None):
    """Return a belief of such hypotheses, at rest where nothing else is told."""
    none = np.zeros((len(prior), 2))
    return LeaderBelief(
        SIGHT,
        np.array(prior, dtype=float),
        np.array(starts, dtype=float),
        np.zeros((len(prior), 3)) if speeds is None else np.array(speeds, dtype=float),
        none if rates is None else np.array(rates, dtype=float),
        none if turns is None else np.array(turns, dtype=float),
    )


def at(x, y=0.0, z=0.0, pitch=0.0, yaw=0.0):
    return [x, y, z, pitch, yaw]


def gone(speed):
    """Return a leader that was at the origin as its light went, at a speed."""
    motion = LeaderMotion(0.0, np.zeros(5), 1e-4 * np.eye(5))
    motion.speed = np.array(speed, dtype=float)
    return motion


@pytest.mark.parametrize("turn", [0.1, -0.25])
def test_a_steady_turn_is_an_arc(turn):
    belief = of([1.0], [at(1.0, 2.0, 3.0)], [[0.6, 0, 0]], [[0, turn]], [[0, turn]])
    for _ in range(round(0.8 * TURNING_S / 0.1)):
        belief.pass_time(0.1)
    turned = 0.8 * TURNING_S * turn
    arc = 0.6 / turn * np.array([math.sin(turned), 1 - math.cos(turned), 0.0])
    np.testing.assert_allclose(belief.places[0], np.add(arc, [1, 2, 3]), rtol=1e-9)
    np.testing.assert_allclose(belief.headings[0], [0, turned], atol=1e-12)


def test_a_turn_goes_over_to_another_and_ends():
    belief, step = of([1.0], [at(0)], [[0.5, 0, 0]], [[0, 0.1]], [[0, -0.05]]), 0.005
    for _ in range(round(6.0 / step)):
        belief.pass_time(step)
    left = math.exp(-6.0 / TURN_S)
    expected = -0.05 * 6.0 + 0.15 * TURN_S * (1 - left)
    assert belief.headings[0, 1] == pytest.approx(expected, abs=1e-3)
    assert belief.motion(0)[1][1] == pytest.approx(-0.05 + 0.15 * left, abs=1e-3)
    for _ in range(round((TURNING_S + 10 * TURN_S) / 0.2)):
        belief.pass_time(0.2)
    assert belief.motion(0)[1] == pytest.approx([0, 0], abs=1e-4)


def test_a_leader_climbs_by_its_pitch_and_no_steeper_than_leaders_do():
    climbing = of([1.0], [at(0, pitch=-0.2, yaw=0.3)], [[0.5, 0, 0]])
    climbing.pass_time(4.0)
    way = 2.0 * np.array([math.cos(0.2) * math.cos(0.3), math.cos(0.2) * math.sin(0.3)])
    np.testing.assert_allclose(climbing.places[0], [*way, 2.0 * math.sin(0.2)], rtol=1e-12)
    steep = of([1.0], [at(0)], [[0.5, 0, 0]], [[0.2, 0]], [[0.2, 0]])
    for _ in range(80):
        steep.pass_time(0.1)
    assert steep.headings[0, 0] == MOST_PITCH


def test_a_straight_leader_may_turn_to_either_side_alike_and_each_may_have_stopped():
    belief = LeaderBelief.of_motion(SIGHT, gone((0.5, 0, 0)))
    belief.pass_time(0.0)
    assert belief.weights.sum() == pytest.approx(1.0, abs=1e-3)
    for _ in range(60):
        belief.pass_time(0.1)
    for axis in (1, 2):
        assert belief.weights @ belief.places[:, axis] == pytest.approx(0, abs=1e-9)
        assert np.ptp(belief.places[:, axis]) > 0.5
    assert belief.places[:, 0].max() <= 0.5 * 6.0 + 1e-9
    assert (np.linalg.norm(belief.places, axis=1) < 1e-9).any()


# What hides a lamp that would be seen from `ASTERN`: each by a little, and not quite.
EDGE = math.radians(SIGHT.sight_deg)
BOW = math.radians(ARRAY_DEG)


@pytest.mark.parametrize(
    ("lamp", "yaw", "seen"),
    [
        (at(0), 0.0, True),
        (at(HALF - 0.1), 0.0, True),
        (at(HALF + 0.1), 0.0, False),
        (at(0, yaw=EDGE - 0.02), 0.0, True),
        (at(0, yaw=EDGE + 0.02), 0.0, False),
        (at(0, z=HALF * math.tan(EDGE + 0.02)), 0.0, False),
        (at(0, yaw=math.pi), 0.0, False),
        (at(0), BOW - 0.02, True),
        (at(0), -BOW - 0.02, False),
    ],
)
def test_looking_in_vain_tells_only_against_lamps_that_would_be_seen(lamp, yaw, seen):
    belief = of([0.6, 0.4], [lamp, at(-30.0)])
    belief.pass_time(20 * DARK_S)  # by now the lamp is lit again
    before = belief.weights.copy()
    for _ in range(10):
        belief.advance(0.1, np.add(ASTERN, [0, 0, 0, 0, yaw]))
    assert belief.weights[1] == before[1]
    kept = belief.weights[0] / before[0]
    # Less what comes back meanwhile.
    assert kept == pytest.approx(math.exp(-1.0 / LOOK_S) if seen else 1.0, abs=1.0 / AGAIN_S)


def test_dark_that_has_just_begun_tells_little():
    belief = of([1.0], [at(0)])
    for _ in range(10):
        belief.advance(0.1, ASTERN)
    # The integral of t / DARK_S / LOOK_S over a second.
    assert belief.weights[0] == pytest.approx(1 - 0.5 / (DARK_S * LOOK_S), abs=3e-3)


def test_what_was_seen_dark_is_never_ruled_out_and_counts_again_later():
    belief = of([0.6, 0.4], [at(0), at(-30.0)])
    belief.pass_time(20 * DARK_S)
    for _ in range(round(20 * LOOK_S / 0.1)):
        belief.advance(0.1, ASTERN)
    # What looking takes and what comes back are as much.
    assert LEAST * 0.6 <= belief.weights[0] < 0.6 * (LOOK_S / AGAIN_S + 0.02)
    left = belief.weights[0]
    belief.advance(AGAIN_S, np.add(ASTERN, [0, 0, 0, 0, math.pi]))
    assert 0.6 - belief.weights[0] == pytest.approx((0.6 - left) / math.e)


@pytest.mark.parametrize(("far_m", "first"), [(10.0, False), (60.0, True)])
def test_the_place_from_which_more_is_seen_is_looked_at_first_unless_it_is_far(far_m, first):
    """One lamp of weight 0.4 ahead, two of 0.3 beside each other, both seen from either's place."""
    starts = [at(10.0, 0.0), at(-far_m, -0.3), at(-far_m, 0.3)]
    near = np.array([-5.0, 0.0, 0.0, 0.0, 0.0])
    goal = of([0.4, 0.3, 0.3], starts).goal(ASTERN, near, 1.0)[0]
    assert (goal in (0, 3)) == first  # the fourth is the likeliest once more
    apart = [at(10.0, 0.0), at(-far_m, -30.0), at(-far_m, 30.0)]
    assert of([0.4, 0.3, 0.3], apart).goal(ASTERN, near, 1.0)[0] in (0, 3)


def pose_of(own, lamp):
    """Return the pose at which a follower sees a lamp, by SciPy's rotations; both are level."""
    turn = Rotation.from_euler("z", lamp[4]).inv()
    return np.array([*turn.apply(np.subtract(own[:3], lamp[:3])), own[3], own[4] - lamp[4]])


@pytest.mark.parametrize("nearest", [0, 1, 2])
def test_a_glimpse_moves_the_weight_to_the_hypothesis_that_it_fits(nearest):
    starts = np.array([at(0), at(4.0, 3.0, yaw=0.5), at(2.0, -5.0, 1.0, yaw=-0.7)])
    prior = np.array([0.7, 0.2, 0.1])
    belief, own = of(prior, starts), np.array([-5.0, 1.0, 0.5, 0.1, 0.2])
    pose = pose_of(own, starts[nearest])
    place, heading = seen_at(own, pose)
    np.testing.assert_allclose([*place, heading[1]], starts[nearest][[0, 1, 2, 4]], atol=1e-12)
    belief.glimpse(own, pose, 0.01 * np.eye(5), None)
    of_prior = belief.weights[:3] / prior
    assert of_prior[nearest] == pytest.approx(1.0)
    assert (np.delete(of_prior, nearest) < 0.1).all()
    # And what was seen is the first of all, though nobody thought of it.
    assert belief.weights.argmax() == 3
    np.testing.assert_allclose(belief.places[3], starts[nearest][:3], atol=0.02)


def test_what_a_glimpse_leaves_open_is_as_the_hypotheses_have_it():
    """Two normal densities in one: the sum of their informations, by slopes taken from steps."""
    own = np.array([-6.0, 1.0, 0.5, 0.1, 0.2])
    known, lamp = np.array(at(0.3, -0.2, 0.1, 0.05, 0.1)), at(1.0, 0.5, -0.3, 0.0, -0.2)
    pose = pose_of(own, lamp)
    root = np.random.default_rng(3).normal(size=(5, 5))
    covariance = root @ root.T + 0.1 * np.eye(5)
    belief = of([1.0], [known])
    belief.glimpse(own, pose, covariance, None)

    def water(pose):
        return np.concatenate(seen_at(own, pose))

    steps = 1e-6 * np.eye(5)
    slopes = np.stack([(water(pose + step) - water(pose - step)) / 2e-6 for step in steps], axis=1)
    seen = np.linalg.inv(slopes @ covariance @ slopes.T)
    prior = np.linalg.inv(BESIDE)
    expected = np.linalg.solve(seen + prior, seen @ water(pose) + prior @ known)
    np.testing.assert_allclose([*belief.places[-1], *belief.headings[-1]], expected, atol=1e-6)


def test_a_heading_across_half_a_turn_is_no_other():
    lamp = at(0, yaw=math.pi - 0.01)
    belief = of([1.0], [at(0, yaw=0.01 - math.pi)])
    belief.glimpse(np.array(at(7.0)), pose_of(np.array(at(7.0)), lamp), np.eye(5), None)
    assert abs(belief.headings[-1, 1]) > math.pi - 0.011


@pytest.mark.parametrize("trail", [1.0, TRAIL])
def test_a_vague_glimpse_is_looked_at_from_farther(trail):
    spread = 0.01 if trail == 1.0 else 400.0
    hypotheses = [at(0, y) for y in (-4.0, 4.0)]
    belief = of([0.5, 0.5], hypotheses)
    goal = belief.glimpse(ASTERN, pose_of(ASTERN, at(0, 4.0)), spread * np.eye(5), None)
    assert goal == (2, trail)


@pytest.mark.parametrize("dim", [False, True])
def test_dim_light_is_of_a_lamp_at_its_beams_edge(dim):
    """A pose that knows nothing, and an image as bright as one of two lamps would make it."""
    lamps = [at(0), at(0, yaw=EDGE)]
    belief = of([0.5, 0.5], lamps)
    light = 0.0 if dim else float(SIGHT.on_axis(HALF))
    belief.glimpse(ASTERN, pose_of(ASTERN, at(0, yaw=EDGE / 2)), 1e4 * np.eye(5), light)
    assert belief.headings[-1, 1] == pytest.approx(EDGE * dim, abs=0.01)


def in_the_water(own, ways, ranges):
    """Return places on lines from a follower at `own`, rad down and to port, and its heading."""
    rays = [Rotation.from_euler("ZY", way[::-1]).apply([1.0, 0.0, 0.0]) for way in ways]
    rays = np.array(rays) * np.reshape(ranges, (-1, 1))
    places = own[:3] + Rotation.from_euler("ZY", own[:2:-1]).apply(rays)
    return np.concatenate([places, np.tile([0.0, own[4]], (len(ways), 1))], axis=1)


@pytest.mark.parametrize(("to_port", "up"), [(1.0, 0.0), (-0.8, 0.0), (0.0, 0.9), (0.2, -1.0)])
@pytest.mark.parametrize("attitude", [(0.0, 0.0), (-0.1, 2.0)])
def test_light_without_a_pose_is_of_the_lamp_that_lights_that_side(to_port, up, attitude):
    """Of lamps that are ahead, on both sides, and behind, each far from the others."""
    own = np.array([1.0, -2.0, 0.5, *attitude])
    ways = [(-0.3 * up, 0.3 * to_port), (0.3 * up, -0.3 * to_port), (0.0, 0.0), (0.0, math.pi)]
    lamps, prior = in_the_water(own, ways, 16.0), np.array([0.1, 0.3, 0.2, 0.4])
    belief = of(prior, lamps)
    belief.face(own, Glow(to_port, up, 1.0), None)
    of_prior = belief.weights[:4] / prior
    assert of_prior.argmax() == 0
    assert (of_prior[1:] < 0.9 * of_prior[0]).all()
    np.testing.assert_allclose(belief.places[0], lamps[0, :3], atol=1e-9)


@pytest.mark.parametrize("side", [-1, 1])
def test_light_grows_towards_the_axis_of_a_lamp_that_is_ahead(side):
    """A lamp whose bow points to port has its beam's axis to starboard of who looks at it."""
    prior = np.array([0.4, 0.3, 0.3])
    belief = of(prior, [at(0), at(0, yaw=side * 0.6), at(0, yaw=-side * 0.6)])
    belief.face(ASTERN, Glow(-side * 1.0, 0.0, 1.0), None)
    assert (belief.weights[:3] / prior).argmax() == 1


def test_light_in_the_middle_is_of_a_lamp_ahead_and_not_behind():
    belief = of([0.2, 0.8], [at(0), at(4 * ASTERN[0])])
    belief.face(ASTERN, Glow(0.0, 0.0, 1.0), None)
    assert belief.weights[:2].argmax() == 0


def test_light_without_a_pose_is_of_the_lamp_that_is_as_bright():
    lamps = np.array([at(-0.2 * HALF), at(0.7 * HALF)])
    for k, light in enumerate(SIGHT.light(ASTERN[:3], lamps[:, :3], lamps[:, 3:])):
        belief = of([0.5, 0.5], lamps)
        belief.face(ASTERN, Glow(0.0, 0.0, 1.0), float(light))
        assert belief.weights[:2].argmax() == k
        np.testing.assert_array_equal(belief.places[k], lamps[k, :3])


def test_light_at_the_arrays_edge_is_of_any_lamp_beyond():
    prior = np.array([0.7, 0.3])
    belief = of(prior, in_the_water(ASTERN, [(0.0, 0.5), (0.0, 1.0)], 40.0))
    belief.face(ASTERN, Glow(1.0, 0.0, 1.0), None)
    np.testing.assert_allclose(belief.weights[:2], prior)


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_light_without_a_pose_may_be_of_a_leader_between_the_hypotheses(heading):
    """Of all, each a step aside, up and in yaw or not, it is the one that fits best."""
    turn = Rotation.from_euler("z", heading)
    own = np.array([*turn.apply(ASTERN[:3]), 0.0, heading])
    lamps = np.array([[*turn.apply([0.0, 0.4, -0.3]), 0.0, heading], at(30.0)])
    belief = of([0.1, 0.9], lamps)
    glow, light = Glow(-1.0, 0.6, 1.0), 0.0
    belief.face(own, glow, light)
    found = {}
    for aside, up, yaw in product((-1, 0, 1), repeat=3):
        place = np.array([0.0, 0.4 + 1.5 * aside, -0.3 + 1.25 * up])
        behind = Rotation.from_euler("z", math.radians(10.0 * yaw)).inv().apply(ASTERN[:3] - place)
        range_m = np.linalg.norm(behind)
        off_axis = math.degrees(math.acos(-behind[0] / range_m)) / SIGHT.sight_deg
        bright = SIGHT.on_axis(range_m) - SIGHT.on_axis(HALF) * off_axis**2
        across = behind * [0, -1, -1]  # to the axis, as the leader has it
        across = Rotation.from_euler("z", math.radians(10.0 * yaw)).apply(across)
        way = (place - ASTERN[:3] + across)[1:] / 2 / range_m
        off = np.clip(way / 0.3, -1, 1) - [glow.to_port, glow.up]
        square = (
            (off @ off) * 4 + min(abs(bright - light) / 0.7, 4) ** 2 + aside**2 + up**2 + yaw**2
        )
        found[square] = [*turn.apply(place), 0.0, heading + math.radians(10.0 * yaw)]
    best = found[min(found)]
    for _ in range(3):  # not a step each time
        np.testing.assert_allclose([*belief.places[0], *belief.headings[0]], best, atol=1e-9)
        belief.face(own, glow, light)
    assert abs(best[4] - heading) > 0.1
    assert belief.weights[0] == pytest.approx(0.1 * max(math.exp(-min(found) / 2), LEAST))
    belief.forget_glimpse()
    np.testing.assert_array_equal(belief.places[:2], lamps[:, :3])
    belief.face(own, glow, light)
    belief.glimpse(own, pose_of(own, lamps[0]), np.eye(5), None)
    np.testing.assert_array_equal(belief.places[:2], lamps[:, :3])


def test_a_leader_beside_a_hypothesis_goes_on_as_that_does():
    belief = of([1.0], [at(0)], [[0.5, 0, 0]], [[0, 0.1]], [[0, 0.1]])
    twin = of([1.0], [at(0)], [[0.5, 0, 0]], [[0, 0.1]], [[0, 0.1]])
    belief.face(ASTERN, Glow(-1.0, 0.6, 1.0), 0.0)
    for _ in range(20):
        belief.pass_time(0.1)
        twin.pass_time(0.1)
    apart = Rotation.from_euler("z", twin.headings[0, 1]).inv().apply(belief.places - twin.places)
    assert np.abs(apart[0]).max() > 1.0
    before = of([1.0], [at(0)])
    before.face(ASTERN, Glow(-1.0, 0.6, 1.0), 0.0)
    np.testing.assert_allclose(apart[0], before.places[0], atol=1e-9)
    np.testing.assert_allclose(belief.headings - twin.headings, before.headings, atol=1e-9)


def test_a_leader_that_pauses_goes_on_beside_its_old_way():
    speed = np.array([0.5, 0.0, 0.0])
    belief = LeaderBelief.of_motion(SIGHT, gone(speed))
    for _ in range(round(3 * TURNING_S / 0.1)):
        belief.pass_time(0.1)
    # 0.3 m/s to port while it pauses; the fan's step in which a drift ends is of either.
    beside = np.array([0.5 * 2 * TURNING_S, 0.3 * TURNING_S, 0.0])
    rests = np.array([0.0, 0.3 * TURNING_S, 0.0])
    for place in (beside, rests):
        assert np.linalg.norm(belief.places - place, axis=1).min() < 0.1


def test_before_any_light_the_leader_is_likeliest_where_the_station_is_its():
    belief = LeaderBelief.at_start(SIGHT)
    best = belief.weights.argmax()
    assert not belief.places[best].any()
    assert not belief.headings[best].any()
    assert belief.weights @ belief.places[:, 1] == pytest.approx(0, abs=1e-9)


def seen_weight(belief, place, velocity, after_s):
    """Return the weight of the leaders seen from a moving place at once and `LOOKS_S` later."""
    weight = 0.0
    speeds, rates = map(np.array, zip(*map(belief.motion, range(len(belief.weights))), strict=True))
    for later_s in (0.0, LOOKS_S):
        time_s = after_s + later_s
        halfway = belief.headings + rates * time_s / 2
        halfway[:, 0] = np.clip(halfway[:, 0], -MOST_PITCH, MOST_PITCH)
        half_turn = np.maximum(np.abs(rates[:, 1] * time_s / 2), 1e-9)
        chords = time_s * np.sin(half_turn) / half_turn
        ways = Rotation.from_euler("ZY", halfway[:, ::-1]).apply(speeds)
        off = place + later_s * velocity - belief.places - ways * chords[:, None]
        headings = belief.headings + rates * time_s
        headings[:, 0] = np.clip(headings[:, 0], -MOST_PITCH, MOST_PITCH)
        astern = Rotation.from_euler("ZY", headings[:, ::-1]).inv().apply(off)
        off_deg = np.degrees(np.arctan2(np.hypot(*astern.T[1:]), -astern[:, 0]))
        ranges = np.linalg.norm(astern, axis=1)
        fall = SIGHT.on_axis(HALF) * (off_deg / SIGHT.sight_deg) ** 2
        weight += belief.weights[SIGHT.on_axis(ranges) > fall].sum() / 2
    return weight


@pytest.mark.parametrize("seed", [*range(20), 103, 139])  # by the last two it hardly stays
def test_where_to_look_from_is_the_best_of_all_places_one_by_one(seed):
    """By SciPy's rotations: it stays, or goes behind one of the likely leaders, near or far."""
    rng, fastest = np.random.default_rng(seed), 0.6
    leader = gone(rng.uniform([-0.2, -0.3, -0.3], [1.0, 0.3, 0.3]))
    leader.turn, leader.heading = rng.uniform(-0.1, 0.1, 2), rng.uniform([-0.3, -3], [0.3, 3])
    belief = LeaderBelief.of_motion(SIGHT, leader)
    belief.pass_time(rng.uniform(0.0, 15.0))
    belief.weights *= rng.uniform(0.0, 1.0, len(belief.weights)) ** 3
    station = np.array([*rng.uniform([-9, -2, -1], [-4, 2, 1]), 0.0, 0.0])
    own = np.array([*rng.uniform([-15, -15, -2], [15, 15, 2]), 0.0, 0.0])
    if seed % 2:  # beside a place to look from
        own[:3] = belief.place_of(Goal(rng.integers(50), TRAIL), station) + rng.normal(0, 1, 3)
    worths = {Goal(-1, 0.0): STAYS * seen_weight(belief, own[:3], np.zeros(3), 0.0)}
    for k in np.argsort(-belief.weights)[:LIKELY].tolist():
        turn = Rotation.from_euler("ZY", belief.headings[k][::-1])
        velocity = turn.apply(belief.motion(k)[0])
        astern = np.array([-TRAIL * np.linalg.norm(station[:3]), 0.0, 0.0])
        for trail, behind in ((1.0, station[:3]), (TRAIL, astern)):
            place = belief.places[k] + turn.apply(behind)
            after_s = min(np.linalg.norm(place - own[:3]) / fastest, ARRIVAL_S)
            seen = seen_weight(belief, place + after_s * velocity, velocity, after_s)
            worths[Goal(k, trail)] = math.exp(-after_s / ARRIVAL_S) * seen
    assert worths[belief.goal(own, station, fastest)] == pytest.approx(max(worths.values()))
