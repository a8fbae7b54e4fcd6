"""``uuv_array calibrate --places``: a rail and a tape in place of two odometries."""

import re

import numpy as np
import pytest
from bags import image_message, write_bag
from calibrated_seas import sea, truth_of
from command_line import json_of, run
from needs import rosbags
from scenes import changed

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.calibration.places_check import in_words
from uuv_optical_array.forward.link_budget import Instrument, scene_with
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.recording.images import Recording
from uuv_optical_array.recording.places import read_places, with_places

HEAD = "x_m,y_m,z_m,pitch_deg,yaw_deg,x_std_m,y_std_m,z_std_m,pitch_std_deg,yaw_std_deg"
STDS = np.array([0.004, 0.006, 0.006, *np.radians([0.3, 0.3])])
EACH = 4  # images at a place


def line(pose, stds=STDS):
    degrees = np.array([1, 1, 1, 180 / np.pi, 180 / np.pi])
    return ",".join(f"{value:.9g}" for value in (*(pose * degrees), *(stds * degrees)))


@pytest.fixture(scope="module")
def tank():
    """Places as they are and as they were measured, and images of each, with others between."""
    rng = np.random.default_rng(11)
    scene = sea("follow")
    true = rng.uniform([-6, -0.8, -0.8, -0.35, -0.35], [-2.5, 0.8, 0.8, 0.35, 0.35], (50, 5))
    told = true + STDS * rng.standard_normal(true.shape)
    images = ForwardModel(scene).expose(np.repeat(true, EACH + 1, axis=0), rng)
    images[EACH :: EACH + 1] = 7.0  # while the array is moved
    return scene, told, images


def table_of(told, path):
    rows = [f"{i * (EACH + 1)},{i * (EACH + 1) + EACH - 1},{line(p)}" for i, p in enumerate(told)]
    path.write_text("\n".join(["# tank", f"image,last_image,{HEAD}", *rows, ""]), encoding="utf-8")
    return path


@rosbags
def test_a_rail_and_a_tape_calibrate_a_scene(tank, tmp_path):
    scene, told, images = tank
    messages = [image_message(10**8 * i, image) for i, image in enumerate(images, start=1)]
    bag = write_bag(tmp_path / "tank", messages, "MCAP")
    table = table_of(told, tmp_path / "places.csv")
    output = tmp_path / "tank.yaml"
    found = json_of(run, "calibrate", bag, "--places", table, "-o", output)
    assert found["images"] == 50 * EACH
    assert 0.8 < found["mean_squared_residual"] < 1.2
    values, gains = truth_of(scene)
    for name, value in values.items():
        fitted = found["parameters"][name]
        assert abs(fitted["fitted"] - value) < 4 * fitted["std_error"], name
    np.testing.assert_array_less(
        np.abs(found["gains"] - gains), 5 * np.array(found["gain_std_errors"])
    )
    assert load_scene(output).lamp.beam_sigma_deg == pytest.approx(6.5, abs=0.2)
    both = ("--places", table, "--set", "attitude_std_deg=1")
    assert "--set attitude_std_deg: the table of --places has these errors" in run(
        "calibrate", bag, *both, code=2
    )


def test_images_of_a_place_share_its_error(tank):
    """So more images of the same places tell little more, and those of more places do."""
    _, told, images = tank
    start, kept = load_scene("follow"), np.delete(images, np.s_[EACH :: EACH + 1], axis=0)
    numbers = np.repeat(np.arange(50), EACH)
    poses = told[numbers]

    def error(found, name="lamp.beam_sigma_deg"):
        return next(p.std for p in found.parameters if p.name == name)

    shared = calibrate(start, kept, poses, pose_std=STDS, places=numbers)
    single = calibrate(start, kept[::EACH], told, pose_std=np.broadcast_to(STDS, told.shape))
    independent = calibrate(start, kept, poses, pose_std=STDS)
    assert error(independent) < 0.75 * error(shared)
    assert 0.5 * error(single) < error(shared) < error(single)


def recording(count=5):
    stamps = 10**9 * np.arange(7, 7 + count)
    poses = np.full((count, 5), np.nan)
    return Recording(np.arange(count * 4.0).reshape(count, 2, 2), poses, poses[:, 0], stamps)


def test_times_find_the_nearest_image_or_all_of_a_span(tmp_path):
    table, pose = tmp_path / "places.csv", np.array([-3, 0.1, 0.2, 0.1, -0.2])
    table.write_text(f"time_s,roll_deg,{HEAD}\n2.6,9,{line(pose)}\n0.8,0,{line(-pose)}\n", "utf-8")
    found, stds, numbers = with_places(recording(), read_places(table))
    np.testing.assert_array_equal(found.images[:, 0, 0], [4, 12])
    np.testing.assert_allclose(found.poses, [-pose, pose])
    np.testing.assert_allclose(found.rolls, [0, np.radians(9)])
    np.testing.assert_allclose(stds, [STDS, STDS])
    assert numbers.tolist() == [1, 0]
    assert found.refused == {"images of no line of places.csv": 3}
    table.write_text(f"time_s,until_s,{HEAD}\n0.5,3,{line(pose, 0 * STDS)}\n", encoding="utf-8")
    found, stds, numbers = with_places(recording(), read_places(table))
    assert numbers.tolist() == [0, 0, 0]
    assert (stds == 1e-6).all()


@pytest.mark.parametrize(
    ("head", "rows", "words"),
    [
        ("", [], "columns none; give the columns image or time_s, x_m"),
        (f"image,{HEAD}", [], "no place below the columns"),
        (HEAD, ["0"], "the columns image or time_s, x_m"),
        (f"image,colour,{HEAD}", ["0"], "columns image, colour, x_m"),
        (f"image,until_s,{HEAD}", ["0"], "perhaps last_image and roll_deg"),
        (f"image,{HEAD}", ["0,far,0,0,0,0,1,1,1,1,1"], "line 2: could not convert .*'far'"),
        (f"image,{HEAD}", ["0,0,0,0,0,0,1,1,-1,1,1"], "line 2: z_std_m: -1.0; give a number;"),
        (f"image,{HEAD}", ["0,0,0,0,0,nan,1,1,1,1,1"], "line 2: yaw_deg: nan"),
        (f"image,{HEAD}", ["0,0,0"], "line 2: 3 cells; give 11"),
        (
            f"image,{HEAD}",
            ["9,0,0,0,0,0,1,1,1,1,1"],
            "line 2: it has no image; the bag has 5 in 4.0 s",
        ),
        (f"time_s,{HEAD}", ["9,0,0,0,0,0,1,1,1,1,1"], "line 2: it has no image"),
        (f"image,{HEAD}", ["1,0,0,0,0,0,1,1,1,1,1"] * 2, "line 3: it has an image of another line"),
    ],
)
def test_a_bad_table_is_refused_with_its_line(head, rows, words, tmp_path):
    table = tmp_path / "places.csv"
    table.write_text("\n".join([head, *rows]), encoding="utf-8")
    with pytest.raises(ValueError, match=words) as caught:
        with_places(recording(), read_places(table))
    assert "\n" not in str(caught.value)


def test_a_table_that_cannot_be_used_is_refused_before_the_bag_is_read(tmp_path):
    """There is no bag; where the table is good, that is the error."""
    bag, table = tmp_path / "bag", tmp_path / "places.csv"
    words = "calibrate", bag, "--places", table
    assert f"{table}: No such file" in run(*words, code=2)
    assert f"{table}: No such file" in run("calibrate", bag, "--trajectory", table, code=2)
    pose = np.array([-3, 0.1, 0.2, 0.1, -0.2])
    table.write_text(f"image,{HEAD}\n0,{line(pose, -STDS)}\n", "utf-8")
    assert f"{table}: line 2: x_std_m: -0.004; give a number" in run(*words, code=1)
    table.write_text(f"image,{HEAD}\n0,{line(pose)}\n", "utf-8")
    assert f"{bag}: " in run(*words, code=2)


def rail(wrong=1.0, noise=1.0, off=0.0):
    """Calibrate at 20 places, two images each, that were told wrong."""
    rng = np.random.default_rng(8)
    scene = sea(sensor_noise__sigma_counts=noise)
    true = rng.uniform([-6, -0.8, -0.8, -0.35, -0.35], [-3, 0.8, 0.8, 0.35, 0.35], (20, 5))
    places = np.repeat(np.arange(20), 2)
    images = ForwardModel(scene).expose(true[places], rng)
    told = (true + STDS * rng.standard_normal(true.shape)) * wrong + off
    start = changed("reference", prior={"known": "as_bought"})
    return calibrate(start, images, told[places], pose_std=STDS, places=places).refusal


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ([1, 1, 1, 1, -1], "yaw is (-[01].[0-9]+) times"),
        ([1, -1, 1, 1, 1], "y is (-[01].[0-9]+) times"),
    ],
)
def test_places_in_other_axes_are_named_as_such(wrong, words):
    refusal = rail(wrong)
    assert refusal.startswith("the light contradicts the places")
    # Mirrored; the light alone tells it to a part of it.
    assert float(re.search(words, refusal)[1]) == pytest.approx(-1, abs=0.4)
    assert "pitch" not in refusal.split(";")[0]


@pytest.mark.parametrize(
    ("wrong", "off", "words", "wanted"),
    [
        (1, [0.2, 0, 0, 0, 0], r"along x by (\S+) m, with a standard error of (\S+) m", 0.2),
        ([1.04, 1.04, 1.04, 1, 1], 0, r"by (\S+) of their distance .* error of (\S+):", 0.04),
    ],
)
def test_places_that_are_all_off_alike_are_refused_where_their_light_tells_it(
    wrong, off, words, wanted
):
    refusal = rail(wrong, off=np.array(off))
    assert refusal.startswith("by the light all places are off ")
    assert "prior.lamp_behind_std_m" in refusal
    size, std = map(float, re.search(words, refusal).groups())
    assert std < wanted / 5
    assert abs(size - wanted) < 4 * std


def test_a_reading_close_to_full_scale_hides_no_error_of_all_places():
    rng = np.random.default_rng(0)
    scene = sea("follow")
    true = rng.uniform([-6, -0.8, -0.8, -0.4, -0.4], [-2.5, 0.8, 0.8, 0.4, 0.4], (20, 5))
    near = np.array([[-x, 0, 0, 0, 0] for x in np.linspace(2, 4, 401)])
    peaks = ForwardModel(scene).light(near).max(axis=(1, 2))
    true[0] = near[np.abs(peaks - scene.full_scale_counts + 4).argmin()]
    places = np.repeat(np.arange(20), 3)
    images = ForwardModel(scene).expose(true[places], rng)
    told = true + STDS * rng.standard_normal(true.shape)
    start = load_scene("follow")
    for off, begin in ((0.0, ""), (0.2, "by the light all places are off along x by +0.")):
        given = told + np.array([off, 0, 0, 0, 0])
        found = calibrate(start, images, given[places], pose_std=STDS, places=places)
        assert found.refusal.startswith(begin)
        assert bool(found.refusal) == bool(off)


def test_places_that_are_right_are_not_blamed():
    assert not rail()
    assert "the places" not in (refusal := rail([1] * 5, noise=6.0))
    assert "the residuals are independent" in refusal


def test_readings_of_little_noise_blame_no_places_that_are_right():
    """As of the guide's instrument, whose noise is 1 of 200,000 of full scale."""
    rng = np.random.default_rng(8)
    scene = scene_with(load_scene("follow"), Instrument())
    true = rng.uniform([-6, -0.8, -0.8, -0.35, -0.35], [-3, 0.8, 0.8, 0.35, 0.35], (20, 5))
    places = np.repeat(np.arange(20), 2)
    images = ForwardModel(scene).expose(true[places], rng)
    told = true + STDS * rng.standard_normal(true.shape)
    assert not calibrate(scene, images, told[places], pose_std=STDS, places=places).refusal


def test_an_error_of_places_is_said_by_its_kind():
    rng = np.random.default_rng(1)
    told, noise = rng.uniform(-1, 1, 40), 0.01 * rng.standard_normal(40)
    assert in_words(1, told, 0.3 + noise) == "all are off by y +0.3 m"
    elsewhere = np.where(np.arange(40) == 7, 5.0, 0.3 + noise)  # one of another pose
    assert in_words(1, told, elsewhere) == "all are off by y +0.3 m"
    assert in_words(1, told, -2 * told + noise) == "y is -1.00 times the given value"
    assert in_words(3, told, np.radians(20) * rng.choice([-1.0, 1.0], 40)).startswith(
        "pitch is off by 20 deg rms"
    )
