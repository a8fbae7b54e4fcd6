"""A bag of several lamps: replayed, calibrated on, and replayed by the scene that this gives."""

import csv

import numpy as np
import pytest
from bags import drive_messages, image_message, write_bag
from calibrated_seas import exposed, lights
from command_line import run, text_of
from needs import rosbags
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.geometry import DOF_NAMES
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.recording.bag import RUN, opened

pytestmark = rosbags
IMAGES = 100
LOW, HIGH = [-6.5, -0.7, -0.7, -0.3, -0.3], [-3.0, 0.7, 0.7, 0.3, 0.3]
POSE = [f"{name}_{'m' if len(name) == 1 else 'rad'}" for name in DOF_NAMES]


@pytest.fixture(scope="module")
def drive():
    """The lamps, and poses of a follower that rolls by a degree."""
    rng = np.random.default_rng(6)
    scene = lights(rng)
    return scene, rng.uniform(LOW, HIGH, (IMAGES, 5)), np.radians(rng.standard_normal(IMAGES)), rng


@pytest.fixture(scope="module")
def bag(drive, tmp_path_factory):
    """What the nodes publish, with one image of a single lamp among the others."""
    scene, poses, rolls, rng = drive
    images, stamps = exposed(scene, poses, rng, rolls), 10**8 * np.arange(1, IMAGES + 1)
    ahead = np.array([3.0, -2.0, -5.0]), Rotation.from_euler("ZYX", [0.7, 0.1, 0.05])
    messages = [*drive_messages(stamps, poses, images, rolls, ahead)]
    messages.append(image_message(10**8 + 5, images[0, :5]))
    return write_bag(tmp_path_factory.mktemp("lights") / "lights", messages, "MCAP")


def test_a_scene_that_is_calibrated_on_a_bag_of_lamps_explains_its_images(bag, drive, tmp_path):
    scene, poses, rolls, _ = drive
    calibrated, folder = tmp_path / "lights.yaml", tmp_path / "after"
    words = ("--scene", "leading_lights", "--noise", "-o", calibrated)
    assert "lamps.2.yaw_deg" in text_of(run, "calibrate", bag, *words)
    lamps = load_scene(calibrated).lamps
    for found, true in zip(lamps, scene.lamps, strict=True):
        assert [found.pitch_deg, found.yaw_deg] == pytest.approx(
            [true.pitch_deg, true.yaw_deg], abs=0.1
        )
        assert [found.y_m, found.z_m] == pytest.approx([true.y_m, true.z_m], abs=0.01)
    told = text_of(run, "estimate", bag, "--scene", calibrated, "-o", folder)
    for words in (f"{IMAGES} images", f"{IMAGES} poses", "left out: 1 x /array/image: "):
        assert words in told
    with (folder / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    after, std = (
        np.array([[float(row[f"{of}{key}"]) for key in POSE] for row in rows])
        for of in ("", "std_")
    )
    off = after - poses
    # Far better than another sea with other lamps would give.
    assert (np.sqrt(np.mean(off**2, axis=0)) < [0.05, 0.03, 0.03, 0.02, 0.02]).all()
    # As far off as the covariances say; all share the calibration's errors.
    assert 0.7 < np.sqrt(np.mean((off / std) ** 2)) < 1.3
    # The lamps show the roll, too.
    with opened(folder / "bag") as bag:
        messages = [m for *_, m in bag.messages({"/relative_pose": RUN["relative_pose"]})]
    attitudes = [message.pose.pose.orientation for message in messages]
    found = Rotation.from_quat([[it.x, it.y, it.z, it.w] for it in attitudes]).as_euler("ZYX")
    assert np.corrcoef(found[:, 2], rolls)[0, 1] > 0.2
    stds = np.sqrt([message.pose.covariance[21] for message in messages])
    assert 0.7 < np.sqrt(np.mean(((found[:, 2] - rolls) / stds) ** 2)) < 1.3
