"""What light that grows or falls at once tells of lamps."""

import numpy as np
import pytest

from uuv_optical_array.control.leader.lamps import LEFT_S, LIT, LIT_IMAGES, Lamps
from uuv_optical_array.control.leader.motion import Glow, LeaderMotion
from uuv_optical_array.control.leader.other_lamp import OtherLamp
from uuv_optical_array.control.leader.sight import SightSettings
from uuv_optical_array.estimation.tracking.track import Outlier

STATION = np.array([-4.5, 0.0, 0.0, 0.0, 0.0])
ASIDE = STATION - np.array([0.0, 1.5, 0.0, 0.0, 0.0])  # of a lamp to port of the leader's
SURE = 1e-4 * np.eye(5)


def watched(*peaks, steers=True):
    """Return lamps after images of such peaks a tenth of a second apart, and what the last told."""
    lamps, told = Lamps(), None
    for tick, peak in enumerate(peaks):
        told = lamps.look(tick / 10, None if peak is None else Glow(0, 0, peak), steers)
    return lamps, told


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_fall_counts_beyond_each_of_the_last_images(share):
    before = [130.0, 100.0, 120.0, 110.0][: LIT_IMAGES + 1]
    least = min(before[-LIT_IMAGES:])
    assert watched(*before, share * least / LIT)[1] == ("out" if share < 1 else None)


@pytest.mark.parametrize("left", [1.0, 0.5])
def test_light_that_a_follower_swings_out_of_does_not_fall_at_once(left):
    """By 3 deg an image in a beam of 8 deg it falls by up to 2.4 times; then a lamp goes out."""
    off = np.arange(0, 25, 3) / 8
    peaks = 200 * np.exp(-np.square(off) / 2)
    peaks[-1] *= left
    *swung, last = (watched(*peaks[: k + 1])[1] for k in range(len(peaks)))
    assert peaks[-3] > 2 * peaks[-2]
    assert not any(swung)
    assert last == ("out" if left < 1 else None)


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_light_that_grows_tells_of_a_second_lamp_once_and_only_beside_another(share):
    lamps, told = watched(100.0, 80.0)
    assert told is None
    assert lamps.look(0.2, Glow(0, 0, 2 * LIT * 100.0), True) is None  # none is held apart
    leader = LeaderMotion(0.0, STATION, SURE)
    for dim in (100.0, 80.0, 90.0):
        lamps.look(0.3, Glow(0, 0, dim), True)
    lamps.other = OtherLamp(0.0, ASIDE, SURE, leader)
    bright = Glow(0, 0, share * LIT * 100.0)
    assert lamps.look(0.4, bright, True) == ("lit" if share > 1 else None)
    assert lamps.other.alone == (share < 1)
    assert lamps.look(0.5, Glow(0, 0, 4 * bright.peak), True) == ("lit" if share < 1 else None)


@pytest.mark.parametrize(("steers", "late"), [(True, -0.1), (True, 0.1), (False, -0.1)])
def test_what_a_lamp_left_is_taken_up_for_a_while_where_it_steered(steers, late):
    lamps, _ = watched(100.0, 10.0, steers=steers)
    assert lamps.taken_up(0.1 + LEFT_S + late) == (steers and late < 0)


@pytest.mark.parametrize("fell", [True, False])
def test_only_after_a_fall_a_lamp_where_the_leader_cannot_be_is_held_apart(fell):
    lamps, _ = watched(100.0, 10.0 if fell else 100.0)
    leader = LeaderMotion(0.2, STATION, SURE)
    if not fell:
        with pytest.raises(Outlier, match="another lamp"):
            lamps.whose(0.2, ASIDE, SURE, [leader], False, None)
        assert (lamps.other, lamps.met) == (None, False)
        return
    assert lamps.whose(0.2, ASIDE, SURE, [leader], False, None) == "other"
    assert lamps.met
    # It goes on from there, and the leader from where it was.
    assert lamps.whose(0.3, ASIDE, SURE, [leader], True, None) == "other"
    assert lamps.whose(0.3, STATION, SURE, [leader], True, None) == "leader"


@pytest.mark.parametrize(("to_port_m", "whose"), [(0.0, "leader"), (0.75, "both"), (1.5, "both")])
def test_light_is_of_both_lamps_where_ours_is_not_much_brighter(to_port_m, whose):
    lamps, leader = Lamps(), LeaderMotion(0.0, STATION, SURE)
    lamps.other = OtherLamp(0.0, ASIDE, SURE, leader)
    lamps.other.alone = False
    leader.own[1] += to_port_m
    assert lamps.whose(0.0, STATION, SURE, [leader], True, SightSettings()) == whose
    assert lamps.whose(0.0, STATION, SURE, [leader], True, None) == "leader"
