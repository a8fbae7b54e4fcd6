"""Odometry of the follower in the beacon's frame: pose, twist, covariances, frames and stamps."""

from types import SimpleNamespace

import numpy as np
import pytest
from asker import Asker, figures, place_of, twist_of
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from uuv_optical_array.estimation.estimator import Estimate

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
RATE_HZ = 10
SPREAD = np.diag([4e-4, 1e-4, 1e-4, 1e-4, 1e-4])
AIM_VARIANCE = 1e-3  # of all five, where it shows


def truth(seconds):
    """Return where a follower is that closes in, drifts to port and turns."""
    return np.array([-7.0, 0.2, -0.1, 0.1, -0.2]) + seconds * np.array(
        [0.4, 0.1, -0.05, 0.02, 0.06]
    )


def frames(seconds):
    """Return position and rotation of that follower, in REP 103 axes, by SciPy."""
    *position, pitch, yaw = truth(seconds)
    return np.array(position), Rotation.from_euler("ZYX", [yaw, pitch, 0.0])


class Mover(Asker):
    """Asks an estimator node whose estimator knows the truth, ten times a second."""

    truth = staticmethod(truth)

    def __init__(self, lab, scene_file, **parameters):
        super().__init__(lab, scene_file, tracking=True, **parameters)
        self.odometry = lab.listen(Odometry, "relative_odometry")
        self.leaders = lab.listen(PoseStamped, "leader_pose")
        lab.connect()
        self.node.pipeline.estimator = SimpleNamespace(
            settings=self.node.pipeline.estimator.settings,
            constants=self.node.pipeline.estimator.constants,
            estimate=lambda *_: Estimate(self.truth(self.seconds), SPREAD, 0.01, None, 0.02),
            aim_covariance=lambda pose, roll: AIM_VARIANCE * np.eye(5),
        )

    def run(self, count, first=0):
        """Send frames of different signatures; return the last odometry."""
        for i in range(first, first + count):
            self.seconds = i / RATE_HZ
            message = self.message(np.array([0.5, 0.001 * i, 0.0, 0.0, 0.0]), 1)
            message.header.stamp = self.stamp = Time(
                sec=1 + i // RATE_HZ, nanosec=i % RATE_HZ * 10**8
            )
            self.clouds.publish(message)
            last = self.lab.answer(self.odometry, self.stamp, "odometry")
        return last


@pytest.fixture
def mover(lab, scene_file):
    return Mover(lab, scene_file)


def test_the_twist_is_that_of_the_pose_seen_from_the_follower(mover):
    last = mover.run(40)
    assert last.header.stamp == mover.poses[-1].header.stamp == mover.stamp
    assert (last.header.frame_id, last.child_frame_id) == ("leader/beacon", "base_link_by_light")
    # By differences of the true pose about that instant, in its own axes.
    step = 1e-4
    (before, turned_before), (_, at), (after, turned_after) = map(
        frames, mover.seconds + step * np.arange(-1, 2)
    )
    linear = at.inv().apply(after - before) / (2 * step)
    angular = at.inv().apply((turned_after * turned_before.inv()).as_rotvec()) / (2 * step)
    np.testing.assert_allclose(twist_of(last.twist.twist), [*linear, *angular], atol=2e-3)
    np.testing.assert_allclose(place_of(last)[0], frames(mover.seconds)[0], atol=2e-3)
    assert np.abs(linear - np.array([0.4, 0.1, -0.05])).max() > 0.03  # other axes, other numbers


def test_a_command_is_in_the_twist_at_once_and_a_bad_one_is_refused(lab, scene_file):
    mover = Mover(lab, scene_file, command_timeout_s=10.0)
    commands = lab.talk(TwistStamped, "cmd_vel")
    lab.connect()
    # A push of the thrusters at 3 s, when the clock of the messages is at 4 s. Roll is not steered.
    push = np.array([0.6, 0.0, -0.2, 0.1, -0.2])
    mover.truth = lambda s: np.array([-7.0, 0, 0, 0, 0]) + max(s - 3.0, 0.0) * push
    for second, surge, moves in ((1, 0.0, 0.0), (4, 0.6, 1.0), (5, np.nan, 1.0)):
        message = TwistStamped(header=Header(stamp=Time(sec=second), frame_id="rov/base_link"))
        linear, angular = message.twist.linear, message.twist.angular
        linear.x, linear.z = surge, -0.2 * moves
        angular.x, angular.y, angular.z = 0.4 * moves, 0.1 * moves, -0.2 * moves
        commands.publish(message)
    lab.report(mover.node, WARN, "cmd_vel, not finite")
    # Two frames after the push a track that is not told of it is far behind.
    np.testing.assert_allclose(
        twist_of(mover.run(33).twist.twist), [0.6, 0, -0.2, 0, 0.1, -0.2], atol=0.02
    )
    assert ("own_motion", "told") in figures(lab.report(mover.node, OK, value="own_motion"))
    mover.run(2, first=150)  # longer after the last command than command_timeout_s
    lab.until(
        lambda: ("own_motion", "not told") in figures(lab.report(mover.node, OK)),
        "the diagnostics to say that it is not told",
    )


def test_the_diagnostics_say_how_far_inside_of_the_table_a_pose_is(mover, scene):
    told = mover.lab.listen(DiagnosticArray, "/diagnostics")
    mover.run(1)
    mover.node.diagnostics.publish()
    mover.lab.until(lambda: told, "a status")
    values = dict(figures(told[-1].status[0]))
    spans = scene.settings()["table"]
    x_low, x_high, _ = spans["x_m"]
    low, high, _ = spans["yaw_deg"]
    inside = {
        "x": min(-7.0 - x_low, x_high + 7.0) / (x_high - x_low) * 2,
        "yaw": (high - np.degrees(0.2)) / (high - low) * 2,
    }
    nearest = min(inside, key=inside.get)
    assert values["table_margin"] == f"{inside[nearest]:.2f} ({nearest})"


def test_the_leaders_pose_is_the_inverse_and_both_covariances_are_positive_definite(mover):
    last = mover.run(15)
    # Of the track, not of the image.
    seen = place_of(SimpleNamespace(pose=mover.lab.answer(mover.leaders, mover.stamp)))[0]
    position, quaternion = place_of(last)
    expected = -Rotation.from_quat(quaternion).inv().apply(position)
    np.testing.assert_allclose(seen, expected, atol=1e-9)
    assert np.abs(np.subtract(position, place_of(mover.poses[-1])[0])).max() > 1e-6
    for part in (last.pose, last.twist):
        covariance = np.reshape(part.covariance, (6, 6))
        np.testing.assert_array_equal(covariance, covariance.T)
        np.linalg.cholesky(covariance)
    # No frame tells of the array's aim, and so the track by itself is that much too sure.
    variances = mover.node.pipeline.tracker.track().covariance.diagonal() + AIM_VARIANCE
    assert last.pose.covariance[0] == pytest.approx(variances[0], rel=1e-9)
    assert last.pose.covariance[35] == pytest.approx(variances[4], rel=1e-9)
    # Roll and roll rate are no measurements.
    assert last.pose.covariance[21] >= 0.02**2
    assert last.twist.covariance[21] >= max(last.twist.covariance[28], last.twist.covariance[35])
