"""Bags estimated anew: by the truth, by the nodes themselves, and what is written of them."""

import csv

import numpy as np
import pytest
from asker import assert_is, place_of
from bags import drive_messages, image_message, write_bag
from command_line import run, text_of
from conftest import write_scene
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from needs import rosbags
from odometries import time_of
from scenes import squared_error
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array.commands import estimate
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.shared.messages import image_to_message, twist_to_message
from uuv_optical_array.recording.bag import RUN, opened
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.replay import CHUNK_FRAMES, replay
from uuv_optical_array.recording.results import write_results

pytestmark = rosbags
IMAGES = 2 * CHUNK_FRAMES + 3
START_NS = 1_700_000_000 * 10**9
METHOD = "sam_interpolated"


def pose_at(t):
    return np.array(
        [-6 + np.sin(t), 0.4 * np.sin(2 * t), 0.3 * np.cos(t), 0.1 * np.sin(3 * t), 0.1]
    )


@pytest.fixture(scope="module")
def drive(scene):
    """Poses, stamps and images of a follower, 10 a second, with frames that show no lamp."""
    model, rng = ForwardModel(scene), np.random.default_rng(4)
    poses = np.array([pose_at(0.1 * i) for i in range(IMAGES)])
    images = np.array([model.expose(pose, rng) for pose in poses])
    images[4] = 0.0
    images[6] = images[5]  # frozen
    images[8, 0, 0] = scene.full_scale_counts + 1
    return poses, START_NS + 10**8 * np.arange(IMAGES), images


BAD = {4: "no light", 6: "frozen", 8: "above full scale"}


@pytest.fixture(scope="module")
def estimator(table):
    return Estimator(table, METHOD)


@pytest.fixture(scope="module")
def bag(drive, tmp_path_factory):
    poses, stamps, images = drive
    messages = drive_messages(stamps, poses, images)
    return write_bag(tmp_path_factory.mktemp("bag") / "drive", messages, "MCAP")


def test_every_image_is_answered_in_order_from_two_processes_as_by_the_estimator(drive, estimator):
    poses, stamps, images = drive
    frames = list(replay(images, stamps, estimator, processes=2))
    assert [frame.stamp_ns for frame in frames] == stamps.tolist()
    for i, frame in enumerate(frames):
        assert frame.reason.partition(":")[0] == BAD.get(i, "")
        if i not in BAD:
            alone = estimator.estimate(images[i])
            np.testing.assert_allclose(frame.estimate.pose, alone.pose, atol=1e-12)
            assert squared_error(frame.estimate, poses[i]) < 40


def test_a_command_of_an_images_own_stamp_holds_for_it(drive, estimator):
    _, stamps, images = drive
    commands = [(int(stamps[1]), np.array([0.3, 0.0, 0.0]), np.zeros(3))]
    frames = replay(images[:3], stamps[:3], estimator, TrackerSettings(), commands=commands)
    assert [frame.track.own_motion for frame in frames] == ["not told", "told", "told"]


def test_the_nodes_say_the_same_of_the_same_images(lab, drive, compiled_fit, tmp_path):
    """Poses and tracks in a scene that learns, and of which images there are none."""
    _, stamps, images = drive
    count = 16
    path = write_scene(tmp_path, "unsure", prior={"lamp_power_std": 0.1})
    scene = load_scene(path)
    estimator = Estimator(scene)
    commands = [(int(stamp) - 10**7, np.array([0.2, 0, 0]), np.zeros(3)) for stamp in stamps[7:9]]
    expected = list(
        replay(images[:count], stamps[:count], estimator, TrackerSettings(), commands=commands)
    )
    lab.begin({"scene": str(path)})
    lab.start(FeatureNode)
    node = lab.start(EstimatorNode)
    helm = lab.talk(TwistStamped, "cmd_vel")
    sender = lab.talk(Image, "array/image")
    poses = lab.listen(PoseWithCovarianceStamped, "relative_pose")
    tracks = lab.listen(Odometry, "relative_odometry")
    lab.connect()
    for stamp, linear, angular in commands:
        at = Header(stamp=time_of(stamp))
        helm.publish(twist_to_message(linear, angular, at))
    # One that is refused comes after those that are taken.
    helm.publish(twist_to_message(np.full(3, np.nan), np.zeros(3), at))
    lab.report(node, DiagnosticStatus.WARN, "cmd_vel, not finite")
    for frame, image in zip(expected, images, strict=False):
        stamp = time_of(frame.stamp_ns)
        sender.publish(image_to_message(image, Header(stamp=stamp)))
        if frame.estimate is None:
            continue
        for heard, found in ((poses, frame.estimate), (tracks, frame.track)):
            assert_is(lab.answer(heard, stamp), found)
    assert len(poses) == len(tracks) == count - len(BAD)


def test_what_is_written_reads_back_by_other_readers(drive, estimator, tmp_path):
    poses, stamps, images = drive
    frames = list(replay(images[:10], stamps[:10], estimator, TrackerSettings()))
    for i, frame in enumerate(frames):  # rolled, as several lamps show
        if frame.estimate:
            frames[i] = frame._replace(estimate=frame.estimate._replace(roll=0.1 + 0.01 * i))
    known = poses.copy()
    known[0] = np.nan
    rolls = np.where(np.isnan(known[:, 0]), np.nan, 0.2)
    names = write_results(tmp_path, frames, Recording(images, known, rolls, stamps))
    assert sorted(names) == sorted(path.name for path in tmp_path.iterdir())
    posed = [i for i in range(10) if i not in BAD]

    with (tmp_path / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [i for i, row in enumerate(rows) if row["x_m"]] == posed
    assert rows[4]["no_pose"].startswith("no light")
    found = frames[0].estimate
    assert float(rows[0]["yaw_rad"]) == pytest.approx(found.pose[4], rel=1e-8)
    assert float(rows[0]["std_pitch_rad"]) == pytest.approx(found.covariance[3, 3] ** 0.5, rel=1e-8)

    tum = {name: np.loadtxt(tmp_path / name) for name in names if name.endswith(".tum")}
    np.testing.assert_allclose(tum["truth.tum"][:, 1:4], poses[1:, :3], atol=1e-9)
    turns = Rotation.from_quat(tum["truth.tum"][:, 4:]).as_euler("ZYX")
    np.testing.assert_allclose(turns[:, [1, 0]], poses[1:, 3:], atol=1e-8)
    np.testing.assert_allclose(turns[:, 2], 0.2, atol=1e-8)
    for name, of in (("pose", "estimate"), ("odometry", "track")):
        expected = [getattr(frames[i], of).pose[:3] for i in posed]
        written = tum[f"relative_{name}.tum"]
        np.testing.assert_allclose(written[:, 1:4], expected, atol=1e-9)
        turned = Rotation.from_quat(written[:, 4:]).as_euler("ZYX")
        np.testing.assert_allclose(turned[:, 2], 0.1 + 0.01 * np.array(posed), atol=1e-8)
    first = (tmp_path / "relative_pose.tum").read_text().split()[0]
    assert first == "1700000000.000000000"

    with opened(tmp_path / "bag") as held:
        heard = {"/relative_pose": {}, "/relative_odometry": {}}
        for _, channel, message in held.messages({name: RUN[name[1:]] for name in heard}):
            stamp = message.header.stamp
            heard[channel.topic][stamp.sec * 10**9 + stamp.nanosec] = message
    for by_stamp in heard.values():
        assert list(by_stamp) == [stamps[i] for i in posed]
    message = heard["/relative_odometry"][stamps[1]]
    names = message.header.frame_id, message.child_frame_id
    assert names == ("leader/beacon", "base_link_by_light")
    position, quaternion = place_of(message)
    track = frames[1].track
    np.testing.assert_array_equal(position, track.pose[:3])
    attitude = Rotation.from_quat(quaternion)
    np.testing.assert_allclose(attitude.as_euler("ZYX")[:2], track.pose[:2:-1], atol=1e-12)
    assert attitude.as_euler("ZYX")[2] == pytest.approx(0.11, abs=1e-12)
    speed = message.twist.twist.linear
    np.testing.assert_allclose(
        attitude.apply([speed.x, speed.y, speed.z]), track.rate[:3], atol=1e-12
    )
    assert np.linalg.eigvalsh(message.pose.covariance.reshape(6, 6)).min() > 0


def test_the_command_writes_a_folder_and_tells_errors_and_refusals(bag, scene_file, tmp_path):
    words = ("--scene", scene_file, "--method", METHOD, "-o", tmp_path / "out")
    told = text_of(run, "estimate", bag, *words)
    for word in (f"{IMAGES} images", f"{IMAGES - 3} poses", "no pose: 1 x frozen", "rms error"):
        assert word in told
    assert len((tmp_path / "out" / "frames.csv").read_text().splitlines()) == IMAGES + 1
    assert "it exists" in run("estimate", bag, *words, code=2)


def test_a_bag_of_images_alone_is_enough(drive, scene_file, tmp_path):
    _, stamps, images = drive
    only = [image_message(int(stamps[i]), images[i]) for i in range(4)]
    words = ("--scene", scene_file, "--method", METHOD, "-o", tmp_path / "out")
    told = text_of(run, "estimate", write_bag(tmp_path / "images", only), *words)
    assert "rms error" not in told
    assert not (tmp_path / "out" / "truth.tum").exists()
    assert np.loadtxt(tmp_path / "out" / "relative_pose.tum").shape == (4, 8)


def test_ctrl_c_keeps_what_is_there(bag, scene_file, tmp_path, monkeypatch):
    bar = estimate.progress.over

    def cut_short(each, unit="frame", **options):
        for i, frame in enumerate(bar(each, unit, **options)):
            if unit == "frame" and i == 70:
                raise KeyboardInterrupt
            yield frame

    monkeypatch.setattr(estimate.progress, "over", cut_short)
    words = ("--scene", scene_file, "--method", METHOD, "-o", tmp_path / "out")
    told = text_of(run, "estimate", bag, *words, code=130)
    assert f"interrupted after 70 of {IMAGES} images" in told
    assert len((tmp_path / "out" / "frames.csv").read_text().splitlines()) == 71
