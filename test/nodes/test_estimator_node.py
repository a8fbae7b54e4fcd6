"""The estimator node: the pose and covariance of the core, by its table and settings."""

import sys

import numpy as np
import rclpy.logging
from asker import Asker, assert_is, figures, place_of
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from scenes import changed
from tables import write_table

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature_table import build_table

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def matched(table, signature):
    return Estimator(table, "sam").estimate(parameters=signature)


def test_each_signature_is_answered_with_the_cores_pose_and_covariance(asker, signatures, table):
    estimator = Estimator(table, "sam")
    for i, signature in enumerate(signatures, start=1):
        message = asker.ask(signature, i)
        assert message.header.frame_id == "leader/beacon"
        assert_is(message, estimator.estimate(parameters=signature))
    assert len({tuple(place_of(pose)[0]) for pose in asker.poses}) > 3
    status = asker.lab.report(asker.node, OK)
    values = dict(figures(status))
    assert (values["answered"], values["method"]) == ("10", "sam")
    assert 0 < float(values["angle_rad"]) <= float(values["runner_up_angle_rad"]) < 0.25


def test_a_bad_table_is_an_error_at_the_start_and_refused_at_run_time(
    lab, scene_file, scene, table, tmp_path, signatures
):
    murky_scene = changed(scene, effects={"attenuation": {"k_per_m": 0.2}})
    good, murky = (
        write_table(tmp_path / name, each)
        for name, each in (("good", table), ("murky", build_table(murky_scene)))
    )
    words = murky, "another scene", "effects.attenuation", "k_per_m", "0.2"
    asker = Asker(lab, scene_file, table=murky)
    for neighbours in (32, 64):  # which mends nothing
        assert lab.set(asker.node, "neighbours", neighbours).successful
    lab.deliver(asker.node, asker.clouds, asker.message(signatures[0], 1))
    lab.report(asker.node, ERROR, *words)
    result = lab.set(asker.node, "table", good)
    assert result.successful, result.reason
    assert_is(asker.ask(signatures[1], 2), matched(table, signatures[1]))
    result = lab.set(asker.node, "table", murky)
    assert not result.successful
    assert all(word in result.reason for word in words)
    lab.statuses.clear()
    assert_is(asker.ask(signatures[2], 3), matched(table, signatures[2]))
    assert asker.seconds_answered() == [2, 3]
    lab.report(asker.node, OK)


def test_what_is_set_at_once_is_taken_whole_and_decides_what_is_answered(
    asker, table, signatures, tmp_path
):
    rows = np.arange(len(table.poses)) % 2 == 0
    some = type(table)(table.scene, table.poses[rows], table.parameters[rows])
    changes = {"table": write_table(tmp_path / "thinner", some), "method": "sam_interpolated"}
    changes |= {"neighbours": 9, "roll_std_rad": 0.3}
    result = asker.node.set_parameters_atomically(
        [Parameter(name, value=value) for name, value in changes.items()]
    )
    assert result.successful, result.reason
    expected = Estimator(some, "sam_interpolated", neighbours=9).estimate(parameters=signatures[0])
    assert_is(asker.ask(signatures[0], 1), expected, 0.3)
    angle = expected.angle_rad
    assert asker.lab.set(asker.node, "max_angle_rad", angle * 0.999).successful
    asker.clouds.publish(asker.message(signatures[0], 2))
    asker.lab.report(asker.node, WARN, "no match", f"{angle:.3f} rad")
    assert asker.lab.set(asker.node, "max_angle_rad", angle * 1.001).successful
    asker.ask(signatures[0], 3)
    assert asker.seconds_answered() == [1, 3]


def test_without_tf2_msgs_the_node_warns_and_works(lab, scene_file, signatures, monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", None)  # makes its import fail
    asker = Asker(lab, scene_file, publish_tf=True)
    (line,) = (line for line in lab.logged("tf2_msgs") if "tf2_msgs" in line.msg)
    assert line.level == rclpy.logging.LoggingSeverity.WARN
    asker.ask(signatures[0], 1)
