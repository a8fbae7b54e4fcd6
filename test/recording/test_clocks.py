"""Images of another clock than their poses: which are kept, and what moves with the poses."""

import numpy as np
import pytest

from uuv_optical_array.recording.clocks import shifted
from uuv_optical_array.recording.images import Recording

STAMPS_NS = np.arange(10) * 10**8  # s, up to 0.9
KNOWN_S = 0.55  # up to which the odometries go


def poses_at(stamps_ns):
    """A follower that goes ahead at 1 m/s, and rolls by its range."""
    seconds = stamps_ns * 1e-9
    seconds = np.where(seconds <= KNOWN_S, seconds, np.nan)
    return np.outer(seconds, [1.0, 0.0, 0.0, 0.0, 0.0]), seconds


@pytest.fixture
def recording():
    command = (3 * 10**8, np.ones(3), np.zeros(3))
    images = np.zeros((10, 3, 3))
    return Recording(images, *poses_at(STAMPS_NS), STAMPS_NS, commands=[command], poses_at=poses_at)


def test_images_that_lose_their_pose_are_left_out_and_counted(recording):
    moved = shifted(recording, 0.1)  # the sixth image, of 0.5 s, has its pose at 0.6 s
    assert moved.stamps_ns.tolist() == np.delete(STAMPS_NS, 5).tolist()
    np.testing.assert_allclose(moved.poses[:5, 0], [0.1, 0.2, 0.3, 0.4, 0.5])
    assert moved.left_out == ["left out: 1 x images without a pose at the offset of the clocks"]


def test_an_estimate_keeps_images_without_a_pose(recording):
    moved = shifted(recording, -0.1, posed=False)
    assert moved.stamps_ns.tolist() == STAMPS_NS.tolist()
    np.testing.assert_allclose(moved.poses[:7, 0], [-0.1, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert np.isnan(moved.poses[7:]).all()
    assert moved.left_out == []


def test_commands_are_by_the_clock_of_the_poses(recording):
    ((stamp_ns, linear, _),) = shifted(recording, 0.1).commands
    assert stamp_ns == 2 * 10**8
    assert linear.tolist() == [1, 1, 1]


def test_an_offset_that_leaves_no_pose_is_refused(recording):
    with pytest.raises(ValueError, match=r"time_offset_s: no image has a known pose 2 s from"):
        shifted(recording, 2.0)
