"""``uuv_array calibrate`` on the bag of a drive, and on bad ones."""

import functools
import json
import math
import re
import sys
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bags import TYPES, image_message, odometry_message, store, write_bag
from calibrated_seas import AIMS, sea, truth_of
from command_line import assert_picture, interrupted, json_of, python, run, text_of
from matplotlib.figure import Figure
from needs import rosbags
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from uuv_optical_array.calibration.fit.beam_shape import ResidualsByAngle
from uuv_optical_array.forward.array import ArraySettings
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.plots.calibration import draw_calibration
from uuv_optical_array.recording.images import read_recording

pytestmark = rosbags

BEACON = [-0.7, 0.1, 0.2]
ARRAY = ArraySettings("planar", 5)
SECONDS, RATE_HZ = 20, 10  # of the drive
LEADER, FOLLOWER, IMAGE = "/leader/odometry", "/follower/odometry", "/array/image"
# The sea of the bag; the fit starts from the scene `follow`.
SEA = sea("follow", gains=(0.05, 8), sensor_noise__sigma_counts=1.5)


def leader_at(t):
    """Return where a leader is that goes and turns evenly, as a record of it is interpolated."""
    turn = Rotation.from_euler("ZYX", [0.6, 0.1, -0.2]) * Rotation.from_rotvec(
        [0, 0.1 * t, 0.3 * t]
    )
    return np.array([0.8 * t, 0.3 * t, -5 + 0.1 * t]), turn


def relative_at(t):
    """Return pose and roll of a follower that runs from 3 to 8 m and weaves, noses about."""
    pose = [
        -5.5 + 2.5 * np.cos(2 * np.pi * t / SECONDS),
        0.9 * np.sin(0.9 * t),
        0.8 * np.cos(1.3 * t),
        0.3 * np.sin(1.7 * t),
        0.3 * np.cos(2.3 * t),
    ]
    return np.array(pose), 0.1 * np.sin(0.7 * t)


def follower_at(t):
    position, turn = leader_at(t)
    pose, roll = relative_at(t)
    own = turn * Rotation.from_euler("ZYX", [pose[4], pose[3], roll])
    return position + turn.apply(np.array(BEACON) + pose[:3]), own


def images_at(seconds):
    """Return what the array reads at these times, with the noise of a seed."""
    poses, rolls = zip(*map(relative_at, seconds), strict=True)
    return ForwardModel(SEA).expose(np.array(poses), np.random.default_rng(3), np.array(rolls))


def messages_of(seconds, axes, late_s=0.0):
    """Return topic and bytes of every message of a drive, with odometries in turned axes.

    The images' stamps are late.
    """

    def odometry(topic, t, position, turn):
        own = axes * turn * axes.inv()
        return odometry_message(topic, round(t * 1e9), axes.apply(position), own.as_quat())

    images = iter(images_at(1.05 + np.arange(seconds * RATE_HZ) / RATE_HZ))
    messages = [odometry(LEADER, 1.0, *leader_at(1.0))]
    for step in range(seconds * RATE_HZ // 2):
        times = [1.0 + 0.2 * step + 0.05 + 0.1 * half for half in (0, 1)]
        messages += [odometry(FOLLOWER, t, *follower_at(t)) for t in times]
        # An image waits for the pose of the leader after it.
        later = 1.0 + 0.2 * (step + 1)
        messages.append(odometry(LEADER, later, *leader_at(later)))
        for t in times:
            messages.append(image_message(round((t + late_s) * 1e9), next(images)))
    return messages


@pytest.fixture(scope="module")
def recorded():
    return messages_of(SECONDS, Rotation.identity())


@pytest.fixture(scope="module")
def bag(recorded, tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bag") / "drive", recorded, "MCAP")


def test_a_bag_gives_every_image_at_the_pose_it_was_taken_at(bag):
    found = read_recording(bag, ARRAY, beacon_position_m=BEACON)
    assert len(found.images) == SECONDS * RATE_HZ
    assert not found.refused
    seconds = 1.05 + 0.1 * np.arange(len(found.images))
    np.testing.assert_allclose(found.stamps_ns, np.round(seconds * 1e9), atol=1)
    expected = [relative_at(t) for t in seconds]
    np.testing.assert_allclose(found.poses, [pose for pose, _ in expected], atol=1e-9)
    np.testing.assert_allclose(found.rolls, [roll for _, roll in expected], atol=1e-9)
    np.testing.assert_array_equal(found.images, images_at(seconds))


def command(bag, folder, *words):
    return (
        "calibrate", bag, "--scene", "follow", "-o", folder / "sea.yaml",
        "--set", f"beacon_position_m={','.join(map(str, BEACON))}", *words,
    )  # fmt: skip


def test_another_sea_is_found_within_its_standard_errors(bag, tmp_path):
    found = json_of(run, *command(bag, tmp_path, "--noise"))
    assert not found["clock"]["applied"]
    written = load_scene(tmp_path / "sea.yaml").settings()
    true, gains = truth_of(SEA)
    for name, value in {**true, "sensor_noise.sigma_counts": 1.5}.items():
        fit = found["parameters"][name]
        assert abs(fit["fitted"] - value) < 4 * fit["std_error"], name
        if name == "lamp.power" or name in AIMS:
            continue  # no setting of a scene
        assert abs(fit["start"] - value) > 15 * fit["std_error"], name
        group, key = name.split(".")
        home = written if group in written else written["effects"]
        assert home[group][key] == pytest.approx(fit["fitted"], rel=1e-8)
    errors = (np.array(found["gains"]) - gains) / np.array(found["gain_std_errors"])
    assert np.abs(errors).max() < 4
    low, high = chi2.ppf([5e-4, 0.9995], 24)
    assert low < (errors**2).sum() < high
    assert np.abs(gains - 1).max() > 30 * np.max(found["gain_std_errors"])
    np.testing.assert_allclose(
        written["effects"]["responsivity"]["gains"], found["gains"], rtol=1e-8
    )


def test_a_bag_whose_images_are_late_is_calibrated_at_their_times(tmp_path):
    messages = messages_of(SECONDS, Rotation.identity(), late_s=0.01)
    late = write_bag(tmp_path / "late", messages, "MCAP")
    text = text_of(run, *command(late, tmp_path))
    said = r"stamps are (\S+) ms .* late, which was taken into account \(time_offset_s=(\S+?)\)"
    late_ms, offset_s = map(float, re.search(said, text).groups())
    # The leader's odometry comes at 5 Hz, so that its turns are known to 0.2 ms.
    assert (late_ms, 1e3 * offset_s) == pytest.approx((10, -10), abs=1)
    found = load_scene(tmp_path / "sea.yaml")
    off = math.log(
        found.effects["sea"]["scattering_per_m"] / SEA.effects["sea"]["scattering_per_m"]
    )
    assert abs(off) < 4 * found.prior.scattering_std


def test_a_bag_is_calibrated_by_a_table_of_poses_in_place_of_odometries(recorded, tmp_path):
    images = [(topic, data) for topic, data in recorded if topic == IMAGE]
    bag = write_bag(tmp_path / "images", images, "MCAP")
    seconds = np.arange(1.0, 1.3 + SECONDS, 0.02)
    told = [(*pose[:3], *np.degrees([*pose[3:], roll])) for pose, roll in map(relative_at, seconds)]
    rows = [",".join(f"{x:.9g}" for x in (t, *row)) for t, row in zip(seconds, told, strict=True)]
    head = "time_s,x_m,y_m,z_m,pitch_deg,yaw_deg,roll_deg"
    table = tmp_path / "mocap.csv"
    table.write_text("\n".join([head, *rows, ""]))
    found = json_of(run, *command(bag, tmp_path, "--trajectory", table))
    assert found["images"] == SECONDS * RATE_HZ
    assert not found["clock"]["applied"]
    for name, value in truth_of(SEA)[0].items():
        fit = found["parameters"][name]
        assert abs(fit["fitted"] - value) < 4 * fit["std_error"], name
    refused = run(*command(bag, tmp_path, "--detectors", table), code=2)
    assert "is not a table of readings; a bag has images of the scene's array" in refused


def test_a_namespaced_stack_in_ned_axes_is_read_by_its_topics(tmp_path):
    ned = messages_of(4, Rotation.from_euler("X", np.pi))
    messages = [("/rov" + topic, data) for topic, data in ned]
    bag = write_bag(tmp_path / "ned", messages, version=8)
    names = "rov/array/image", "/rov/leader/odometry", "rov/follower/odometry/"
    topics = dict(zip(("image_topic", "leader_topic", "follower_topic"), names, strict=True))
    found = read_recording(bag, ARRAY, beacon_position_m=BEACON, odometry_axes="frd", **topics)
    assert len(found.images) == 4 * RATE_HZ
    expected = [relative_at(t * 1e-9)[0] for t in found.stamps_ns]
    np.testing.assert_allclose(found.poses, expected, atol=1e-9)


def changed(messages, topic, change):
    """Change every message of a topic; `None` leaves one out."""
    for there, data in messages:
        if there == topic:
            kind = TYPES["odometry" if "odometry" in topic else "image"]
            message = store().deserialize_cdr(data, kind)
            if change(message) is None:
                data = bytes(store().serialize_cdr(message, kind))
            else:
                continue
        yield there, data


def put(path, value):
    """Return a change that sets an attribute."""

    def change(message):
        *groups, last = path.split(".")
        setattr(functools.reduce(getattr, groups, message), last, value)

    return change


def late(message):
    message.header.stamp.sec += 1000


@pytest.mark.parametrize(
    ("topic", "change", "words"),
    [
        (IMAGE, put("encoding", "rgb8"), ("wrong encoding: 'rgb8'", "no image with a known pose")),
        (LEADER, put("header.frame_id", "map"), ("frames differ", "map", "odom")),
        (LEADER, put("pose.pose.position.y", np.nan), ("/leader/odometry: not finite", "there is")),
        (FOLLOWER, put("pose.pose.orientation.w", 9.0), ("/follower/odometry: bad attitude",)),
        (LEADER, late, ("older than every pose", "1001.000 to", "/array/image 1.050 to")),
        (IMAGE, lambda _: "left out", ("no topic /array/image", LEADER, FOLLOWER, "--set image_")),
    ],
    ids=["encoding", "frames", "NaN", "attitude", "stamps", "no image"],
)  # fmt: skip
def test_a_bag_of_which_nothing_can_be_used_says_why_in_one_line(
    recorded, tmp_path, topic, change, words
):
    bag = write_bag(tmp_path / "bad", changed(recorded[:60], topic, change))
    line = run(*command(bag, tmp_path), code=1)
    for word in (str(bag), *words):
        assert word in line, line
    assert not (tmp_path / "sea.yaml").exists()


def test_what_cannot_be_used_is_left_out_and_counted(recorded, tmp_path):
    seen = {LEADER: 0, IMAGE: 0}

    def spoil(message):
        """Spoil a leader pose or two, and an image."""
        seen[LEADER] += 1
        if seen[LEADER] in (4, 10, 11, 12):
            message.pose.pose.position.x = np.nan

    def blind(message):
        seen[IMAGE] += 1
        if seen[IMAGE] == 5:
            message.encoding = "mono8"
        if seen[IMAGE] == 7:
            message.header.stamp.nanosec -= 100_000_000  # that of the image before

    messages = list(changed(changed(recorded[:150], LEADER, spoil), IMAGE, blind))
    total = sum(topic == IMAGE for topic, _ in messages)
    found = read_recording(
        write_bag(tmp_path / "spoilt", messages), ARRAY, beacon_position_m=BEACON
    )
    told = dict(found.refused)
    assert told.pop(f"{LEADER}: not finite") == 4
    assert told.pop(f"{IMAGE}: wrong encoding: 'mono8', not mono16") == 1
    assert told.pop(f"{IMAGE}: duplicate stamp") == 1
    # Three poses away: a gap of 0.8 s, with eight images; one away is interpolated.
    assert told.pop(f"{IMAGE}: no {LEADER} at its stamp: it falls in a gap") == 8
    assert not told
    assert len(found.images) == total - 10


def test_bags_that_are_none_are_refused_in_one_line(recorded, tmp_path):
    empty = write_bag(tmp_path / "empty", [])
    assert "it is empty" in run(*command(empty, tmp_path), code=1)
    assert "no such file" in run(*command(tmp_path / "nowhere", tmp_path), code=2)
    (tmp_path / "folder").mkdir()
    assert "no file .mcap or .db3" in run(*command(tmp_path / "folder", tmp_path), code=1)
    typed = write_bag(tmp_path / "typed", recorded[:30])
    line = run(*command(typed, tmp_path, "--set", f"image_topic={LEADER}"), code=1)
    assert f"{LEADER} is nav_msgs/msg/Odometry, not sensor_msgs/msg/Image" in line
    line = run(*command(typed, tmp_path, "--set", f"leader_topic={FOLLOWER}"), code=1)
    assert "the same topic" in line
    again = [*recorded[100:130], *recorded[:30]]
    line = run(*command(write_bag(tmp_path / "twice", again), tmp_path), code=1)
    assert "the clock was set back" in line


@pytest.fixture
def sea_of_before(tmp_path):
    """A scene where the command is to write its own."""
    path = tmp_path / "sea.yaml"
    path.write_text("# of before\n", encoding="utf-8")
    return path


def stopped(self, path, **options):
    """Write half a picture; the trial in memory, before the work, ends well."""
    if not isinstance(path, BytesIO):
        Path(path).write_bytes(b"half")
        raise KeyboardInterrupt


@pytest.mark.parametrize("words", [(), ("--json",)])
def test_ctrl_c_while_it_draws_keeps_the_scene_and_the_report(
    bag, tmp_path, sea_of_before, monkeypatch, words
):
    monkeypatch.setattr(Figure, "savefig", stopped)
    drawn = command(bag, tmp_path, "--picture", tmp_path / "x.png", *words)
    printed = text_of(run, *drawn, code=130)
    count = SECONDS * RATE_HZ
    assert json.loads(printed)["images"] == count if words else f"{count} images" in printed
    assert "does not explain the data" in printed  # the noise, which is not fitted
    assert list(tmp_path.iterdir()) == [sea_of_before]
    assert load_scene(sea_of_before).effects["responsivity"]["gains"]


# The first step of the fit does not end, so that Ctrl-C comes in the midst of it.
SLOWLY = """
import sys, threading
from uuv_optical_array.commands import calibrate, main
fit = calibrate.calibrate

def slowly(*given):
    *others, on_step, places = given
    def step():
        on_step()
        threading.Event().wait()
    return fit(*others, step, places)

calibrate.calibrate = slowly
main(sys.argv[1:])
"""


def test_ctrl_c_in_the_midst_of_the_fit_leaves_all_as_it_was(bag, tmp_path, sea_of_before):
    program = [sys.executable, "-c", SLOWLY, *command(bag, tmp_path)]
    code, out, error = interrupted(program, rb"\b[1-9]\d* step")
    assert code == 130, error
    assert b"Traceback" not in error
    assert out == b"interrupted: nothing was written\n"
    assert list(tmp_path.iterdir()) == [sea_of_before]
    assert sea_of_before.read_text() == "# of before\n"


def test_it_reports_and_draws_without_ros(bag, tmp_path):
    ros = ["rclpy", "sensor_msgs", "nav_msgs", "geometry_msgs", "std_msgs"]
    picture = tmp_path / "residuals.png"
    words = [*map(str, command(bag, tmp_path, "--noise", "--picture", picture))]
    done = python(
        f"import sys; sys.modules.update(dict.fromkeys({ros}));"
        f"from uuv_optical_array.commands import main; main({words})"
    )
    assert done.returncode == 0, done.stderr
    assert load_scene(tmp_path / "sea.yaml")
    assert_picture(picture)
    for word in (
        f"{SECONDS * RATE_HZ} images",
        "lamp.power",
        "gains",
        "mean squared residual 1.000",
        "scene:",
    ):
        assert word in done.stdout
    assert "note:" not in done.stdout


def test_it_names_the_extra_that_it_needs(bag, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    assert "-m pip install 'rosbags>=0.10'" in run(*command(bag, tmp_path), code=1)


def test_the_picture_shows_which_detector_and_which_images_are_not_explained():
    rng, shape = np.random.default_rng(1), (400, 2 * 9)  # of two lamps
    residuals = rng.standard_normal(shape)
    residuals[:, [5, 14]] *= 1.5
    residuals[300:] += 0.5
    used, uncensored = np.ones(shape, bool), rng.uniform(size=shape) < 0.8
    used[7], uncensored[7], residuals[7] = False, False, 3
    used[:, [8, 17]], uncensored[:, [8, 17]], residuals[:, [8, 17]] = False, False, 3  # dead
    off_axis = ResidualsByAngle(
        np.array([2.0, 9.0]), np.array([0.01, -0.03]), np.full(2, 0.002), 0.8
    )
    result = SimpleNamespace(residuals=residuals, used=used, uncensored=uncensored)
    result.gains, result.by_angle = np.eye(3), off_axis
    poses = np.column_stack([-np.linspace(3, 8, 400), *np.zeros((4, 400))])
    recording = SimpleNamespace(seconds=100 + np.arange(400), poses=poses)
    by_detector, by_time, by_range, by_angle, *_ = draw_calibration(result, recording, "title").axes
    (mesh,) = by_detector.collections
    wanted = np.ones((3, 3))
    wanted[1, 2], wanted[2, 2] = 1.5, 3
    np.testing.assert_allclose(np.ma.filled(mesh.get_array(), np.nan), wanted, atol=0.2)
    for axes, last in ((by_time, 399), (by_range, 8)):
        rms, mean, left_out = (line.get_ydata() for line in axes.lines[:3])
        assert axes.lines[0].get_xdata()[-1] == last
        assert np.nanmean(rms[:300]) == pytest.approx(1.05, abs=0.05)
        assert np.nanmean(mean[300:]) - np.nanmean(mean[:300]) == pytest.approx(0.5, abs=0.1)
        assert np.flatnonzero(np.isfinite(left_out)).tolist() == [7]
        assert left_out[7] == 3
    np.testing.assert_allclose(by_angle.lines[0].get_xydata(), [[2.0, 1.0], [9.0, -3.0]])
    assert by_angle.get_title() == "by this angle alone: 80% of the misfit"
