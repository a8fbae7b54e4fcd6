"""The age of a stamp by a steady clock, whoever sets that of the node, of the sensor, or both."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.time import Time

from uuv_optical_array.nodes.shared import stamp_time
from uuv_optical_array.nodes.shared.stamp_time import StampTime

STEPS_S = 0.5, -0.5, 2.0, -2.0, 30.0, -30.0, 3600.0, -3600.0
LATENCY_S = 0.06
LATE_S = 0.3  # as on a busy machine


class Sea:
    """True time, by which images are taken and come late, and clocks that are off it, s."""

    def __init__(self, monkeypatch, sensor_s=0.0, simulated=False):
        self.now_s, self.own_s, self.sensor_s = 1000.0, 1.7e9, 1.7e9 + sensor_s
        own = SimpleNamespace(now=lambda: Time(nanoseconds=self.ns(self.own_s)))
        steady = SimpleNamespace(now=lambda: Time(nanoseconds=self.ns(0.0)))
        monkeypatch.setattr(stamp_time, "steady_clock", lambda _: own if simulated else steady)
        self.time = StampTime(SimpleNamespace(get_clock=lambda: own))

    def ns(self, ahead_s):
        return round((self.now_s + ahead_s) * 1e9)

    def age_s(self, late_s=LATENCY_S, topic="features"):
        """Return how old a stamp that comes a tenth of a second later is taken to be."""
        self.now_s += 0.1
        return self.time.now_s() - self.time.of(self.ns(self.sensor_s - late_s), topic)


@pytest.mark.parametrize("step_s", STEPS_S)
@pytest.mark.parametrize("who", [("own_s",), ("sensor_s",), ("own_s", "sensor_s")])
def test_whoever_steps_a_clock_the_age_of_stamps_stays_true(monkeypatch, who, step_s):
    sea = Sea(monkeypatch)
    for late_s in (LATENCY_S, LATE_S, LATENCY_S):
        assert sea.age_s(late_s) == pytest.approx(late_s, abs=1e-6)
    for name in who:
        setattr(sea, name, getattr(sea, name) + step_s)
    # A sensor's clock that is set back by half a second cannot be told from images that late.
    late_s = 0.5 if (who, step_s) == (("sensor_s",), -0.5) else 0.0
    ages = np.array([sea.age_s() for _ in range(20)])
    assert ages.min() >= LATENCY_S - 0.1
    # Stamps that are not after the newest may be late ones, for the half second that they are so.
    assert ages.max() <= LATENCY_S + 0.5 + 0.1
    assert ages[6:].max() <= LATENCY_S + late_s + 0.1


@pytest.mark.parametrize("off_s", [-3600.0, 30.0])
def test_a_sensor_whose_clock_was_never_set_is_believed_to_be_in_time(monkeypatch, off_s):
    sea = Sea(monkeypatch, off_s)
    assert [sea.age_s() for _ in range(5)] == pytest.approx([0.0] * 5, abs=1e-6)


def test_a_delay_is_an_age_and_no_step_of_a_clock(monkeypatch):
    """Of a queue that grows as fast as time, and is then skipped."""
    sea = Sea(monkeypatch)
    delays = [*np.arange(0.05, 3.0, 0.1), 0.05]
    assert [sea.age_s(delay) for delay in delays] == pytest.approx(delays, abs=1e-6)


@pytest.mark.parametrize("step_s", [0.0, -30.0, 30.0])
@pytest.mark.parametrize("late_s", [0.4, 0.7, 2.5])
def test_a_topic_that_lags_behind_another_is_as_old_as_it_is(monkeypatch, late_s, step_s):
    """As tracks are on a busy machine, or what a modem tells, behind the images' key parameters."""
    sea = Sea(monkeypatch)
    for i in range(30):
        if i == 15:
            sea.sensor_s += step_s
        assert sea.age_s() == pytest.approx(LATENCY_S, abs=1e-6)
        assert sea.age_s(late_s, "track") == pytest.approx(late_s, abs=1e-6)


@pytest.mark.parametrize("off_s", [-30.0, 0.2, 1.5, 30.0])
@pytest.mark.parametrize("first", ["features", "leader/odometry"])
def test_a_leader_whose_clock_is_off_does_not_make_images_older(monkeypatch, off_s, first):
    sea = Sea(monkeypatch)
    told = []
    for i in range(60):
        if i or first == "features":
            assert sea.age_s() == pytest.approx(LATENCY_S, abs=1e-6)
        if i % 10 == 0:
            told.append(sea.age_s(LATENCY_S - off_s, "leader/odometry"))
    assert told[1:] == pytest.approx([LATENCY_S - off_s] * len(told[1:]), abs=1e-6)


@pytest.mark.parametrize("step_s", [-30.0, 30.0])
def test_without_images_other_stamps_tell_that_a_clock_was_set(monkeypatch, step_s):
    sea = Sea(monkeypatch)
    ages = [sea.age_s(topic=topic) for topic in ("features", "odometry") * 5]
    sea.now_s += 3.0
    sea.sensor_s += step_s
    ages += [sea.age_s(topic=topic) for topic in (*["odometry"] * 5, "features")]
    assert ages == pytest.approx([LATENCY_S] * len(ages), abs=1e-6)


@pytest.mark.parametrize(("off_s", "taken_s"), [(0.0, LATENCY_S), (-3600.0, 0.0)])
def test_a_clock_that_drifts_with_the_sensors_is_followed(monkeypatch, off_s, taken_s):
    """By 50 ppm, as NTP slews both: half a second in three hours. One may be off all the while."""
    sea = Sea(monkeypatch, off_s)
    for _ in range(3000):
        sea.now_s += 3.5
        sea.own_s += 1.8e-4
        sea.sensor_s += 1.8e-4
        age_s = sea.age_s()
    assert sea.own_s - 1.7e9 > 0.5
    assert age_s == pytest.approx(taken_s, abs=0.002)


def test_a_stamp_that_comes_again_and_one_that_comes_late_have_their_place(monkeypatch):
    sea = Sea(monkeypatch)
    sea.age_s()
    first, before = sea.ns(sea.sensor_s), sea.ns(sea.sensor_s - 0.2)
    places = [sea.time.of(stamp, "features") for stamp in (first, before, first)]
    assert places[0] == places[2]
    assert places[0] - places[1] == pytest.approx(0.2, abs=1e-5)


def test_simulated_time_is_that_of_the_stamps_whatever_it_does(monkeypatch):
    sea = Sea(monkeypatch, simulated=True)
    for step_s, late_s in itertools.product((0.0, -30.0, 3600.0), (-1.0, 0.5)):
        sea.own_s = sea.sensor_s = sea.own_s + step_s
        assert sea.age_s(late_s) == pytest.approx(late_s, abs=1e-6)
