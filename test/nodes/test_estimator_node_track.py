"""The estimator node's track: late frames, ranges, clocks, settings."""

import math
import re

import numpy as np
import pytest
from asker import Asker, Shower, assert_is, figures
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from sensor_msgs.msg import Range
from std_msgs.msg import Header

from uuv_optical_array.estimation.estimator import Estimator, EstimatorSettings
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.nodes.estimator_node import EstimatorNode

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
HERE = np.array([-6.0, 0.1, 0.1, 0.02, 0.03])


@pytest.fixture
def tracked(lab, scene_file, scene, compiled_fit):
    return Shower(lab, scene_file, scene, method="least_squares", tracking=True)


def test_a_late_frame_enters_the_track_and_an_outlier_does_not(tracked, scene):
    rng = np.random.default_rng(7)
    model = ForwardModel(scene)
    assert tracked.lab.set(tracked.node, "buffer_s", 5.0).successful
    for seconds in (1, 2, 4):
        tracked.show(model.expose(HERE, rng), seconds)
    tracked.send(model.expose(HERE, rng), 3)
    tracked.lab.report(tracked.node, WARN, "late frame")
    tracked.send(model.expose(HERE + np.array([2.0, 0, 0, 0, 0]), rng), 5)
    tracked.lab.report(tracked.node, WARN, "outlier", "standard deviations off")
    tracked.show(model.expose(HERE, rng), 6)
    assert tracked.seconds_answered() == [1, 2, 4, 6]


class Sounder:
    """Sends ranges to a node that fits and tracks."""

    def __init__(self, lab, scene_file, scene):
        given = {"use_range": True, "range_std_m": 0.05, "buffer_s": 5.0}
        on_range, self.heard = EstimatorNode.on_range, []

        def heard(node, message):
            on_range(node, message)
            self.heard.append(message)

        lab.patch.setattr(EstimatorNode, "on_range", heard)
        self.shower = Shower(lab, scene_file, scene, method="least_squares", tracking=True, **given)
        self.lab, self.node = lab, self.shower.node
        self.talker = lab.talk(Range, "range")
        lab.connect()

    def sound(self, range_m, seconds, **fields):
        header = Header(stamp=Time(sec=seconds, nanosec=9))
        message = Range(header=header, range=range_m, max_range=50.0)
        for name, value in fields.items():
            setattr(message, name, value)
        before = len(self.heard)
        self.talker.publish(message)
        self.lab.until(lambda: len(self.heard) > before, "the range to arrive")


@pytest.fixture
def sounder(lab, scene_file, scene, compiled_fit):
    return Sounder(lab, scene_file, scene)


def test_ranges_enter_the_track_at_their_stamps_with_their_variance_or_the_parameters(
    sounder, scene, table
):
    rng, pipeline = np.random.default_rng(9), Pipeline(Estimator(table).wait())
    pipeline.track_with(TrackerSettings(buffer_s=5.0))
    measured = float(np.float32(np.linalg.norm(HERE[:3]) + 0.1))
    variance = {"variance": 0.04} if hasattr(Range(), "variance") else {}
    stds = {2: 0.05, 3: math.sqrt(np.float32(0.04)) if variance else 0.05}
    for seconds in range(1, 5):
        image = ForwardModel(scene).expose(HERE, rng)
        if seconds in stds:
            sounder.sound(measured, seconds, **(variance if seconds == 3 else {}))
            pipeline.range(seconds * 10**9 + 9, measured, stds[seconds])
        sounder.shower.show(image, seconds)
        answer = pipeline.answer(seconds * 10**9 + 9, image)
        assert_is(sounder.shower.track(seconds), answer.track)
    assert answer.track.range.stamp_ns == 3 * 10**9 + 9
    values = dict(figures(sounder.lab.report(sounder.node, OK)))
    assert re.fullmatch(r"[+-]0.\d\d m off the track, \d.\d standard .*; used", values["range"])


def test_false_ranges_and_those_of_another_time_change_no_track_and_are_told(sounder, scene, table):
    rng, pipeline = np.random.default_rng(9), Pipeline(Estimator(table).wait())
    right, now = float(np.linalg.norm(HERE[:3])), sounder.node.get_clock().now().seconds_nanoseconds
    cases = [
        (dict(range_m=right, seconds=94), "range, late range", "more than buffer_s 5"),
        (dict(range_m=right + 3.0, seconds=102), "false range", "standard deviations; refused"),
        (dict(range_m=math.nan, seconds=103), "range, not finite", "nan"),
        (dict(range_m=-2.0, seconds=104), "range, out of bounds", "-2 m, not within", "0 to 50"),
        (dict(range_m=51.0, seconds=105), "range, out of bounds", "51 m, not within", "0 to 50"),
        (dict(range_m=0.0, seconds=106), "range, range: 0 m; give from 0.001"),
        (dict(range_m=right, seconds=now()[0] + 9), "range, stamp ahead"),
    ]
    if hasattr(Range(), "variance"):
        cases.append((dict(range_m=right, seconds=109, variance=-1.0), "out of bounds", "-1 m^2"))
    sounder.shower.show(ForwardModel(scene).expose(HERE, rng), 100)
    for seconds, (sent, *words) in enumerate(cases, start=101):
        sounder.sound(**sent)
        sounder.shower.show(ForwardModel(scene).expose(HERE, rng), seconds)
        sounder.lab.report(sounder.node, WARN, *words)
    rng = np.random.default_rng(9)
    pipeline.track_with(TrackerSettings(buffer_s=5.0))
    for seconds in range(100, 101 + len(cases)):
        answer = pipeline.answer(seconds * 10**9 + 9, ForwardModel(scene).expose(HERE, rng))
    assert_is(sounder.shower.track(seconds), answer.track)


@pytest.mark.parametrize(
    ("refused", "reason"),
    [(("table", "/nowhere"), "no table there"), (("method", "magic"), "magic")],
)
def test_an_atomic_set_that_is_refused_leaves_track_estimator_and_parameters(
    tracked, scene, table, refused, reason
):
    images = ForwardModel(scene).expose(np.tile(HERE, (4, 1)), np.random.default_rng(8))
    for seconds, image in enumerate(images[:3], start=1):
        tracked.show(image, seconds)
    changes = {"velocity_walk_m_per_s": 5.0, "max_misfit": 0.01, "candidates": 1}
    before = {name: tracked.node.get_parameter(name).value for name in changes}
    result = tracked.node.set_parameters_atomically(
        [Parameter(name, value=value) for name, value in [*changes.items(), refused]]
    )
    assert not result.successful
    assert reason in result.reason
    for name, value in before.items():
        assert tracked.node.get_parameter(name).value == value
    assert tracked.node.pipeline.estimator.settings == EstimatorSettings()
    # The next frame joins the track of the first three, as one that was never disturbed.
    pipeline = Pipeline(Estimator(table).wait())
    for seconds, image in enumerate(images, start=1):
        answer = pipeline.answer(seconds * 10**9 + 9, image)
    tracked.show(images[3], 4)
    assert_is(tracked.track(4), answer.track)


def test_tracked_poses_do_not_run_backwards_and_a_clock_that_was_set_back_starts_anew(
    lab, scene_file, signatures
):
    asker = Asker(lab, scene_file, tracking=True, buffer_s=5.0)
    for signature, seconds in zip(signatures, [100, 102, 101, 103, 50, 51, 52], strict=False):
        lab.deliver(asker.node, asker.clouds, asker.message(signature, seconds))
    lab.until(lambda: 52 in asker.seconds_answered(), "the last pose")
    assert asker.seconds_answered() == [100, 102, 103, 51, 52]
    lab.report(asker.node, WARN, "late frame", "stamp not later: 50.0")


@pytest.mark.parametrize("back_s", [3, 4, 40])
def test_a_clock_that_is_set_back_costs_a_track_one_frame_however_far(
    lab, scene_file, signatures, back_s
):
    """Also where it is no farther than a track waits for frames that are late or for light."""
    asker = Asker(lab, scene_file, tracking=True)
    seconds = [100, 101, 102, *(103 - back_s + i for i in range(3))]
    for signature, second in zip(signatures, seconds, strict=False):
        lab.deliver(asker.node, asker.clouds, asker.message(signature, second))
    lab.until(lambda: len(asker.seconds_answered()) > 4, "the last pose")
    assert asker.seconds_answered() == seconds[:3] + seconds[4:]
