"""Calibration of several lamps: their own powers, places and axes, and what they cannot tell."""

import dataclasses
import re

import numpy as np
import pytest
from calibrated_seas import (
    TURNED,
    check_consistency,
    drive,
    exposed,
    largest_pull,
    lights,
    named,
    pulls,
    recorded,
)

from uuv_optical_array import cramer_rao_bound
from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

START = load_scene("leading_lights")
ARRAY_TURNED = np.array([0.0, 0.0, *TURNED[2:]])  # the lamps' axes say how they are turned
OWN = "power", "x_m", "y_m", "z_m", "pitch_deg", "yaw_deg"


STD = np.array([0.002, 0.003, 0.003, 0.02, 0.02])


def test_errors_are_as_large_as_the_standard_errors_say():
    """At measured places of two images each; exact poses and an odometry have one lamp."""
    rng, fits, count, each = np.random.default_rng(5), 6, 20, 2
    misfit = check_consistency(lights, START, fits, count, rng, STD, ARRAY_TURNED, each)
    assert misfit == pytest.approx(1.0, abs=5 * np.sqrt(2 / (fits * count * each * 75)))


def test_the_scene_that_is_written_has_the_lamps_as_they_are_and_how_well_they_are_known():
    scene = lights(np.random.default_rng(8))
    found = calibrate(START, *recorded(scene, 60, 3))
    assert largest_pull(found, scene) < 5.5
    fitted = named(found)
    for i, lamp in enumerate(found.scene.lamps):
        for key in OWN:
            name = f"lamps.{i}.{key}"
            assert getattr(lamp, key) == pytest.approx(fitted[name].value, rel=1e-8, abs=1e-9)
    # The light of the written scene is that of the true one, within the noise.
    rng = np.random.default_rng(9)
    poses, rolls = drive(rng, 40)
    off = ForwardModel(found.scene).light(poses, rolls) - ForwardModel(scene).light(poses, rolls)
    assert np.sqrt((off**2).mean()) < 0.5
    # What the drive tells of the lamps makes a single image tell more.
    prior = found.scene.prior
    for key, own in (("aim_std_deg", OWN[4:]), ("place_std_m", OWN[1:4])):
        stds = [fitted[f"lamps.{i}.{name}"].std for i in range(3) for name in own]
        rms = np.sqrt(np.mean(np.square(stds)))
        assert getattr(prior, f"lamps_{key}") == pytest.approx(rms, rel=0.01)
    powers = [fitted[f"lamps.{i}.power"] for i in range(3)]
    relative = np.sqrt(np.mean([(p.std / p.value) ** 2 for p in powers]))
    assert prior.lamps_power_std == pytest.approx(relative, rel=0.01)
    # All axes are off together by no more than one of them, and no less than independent ones.
    assert prior.lamps_aim_std_deg / 2 < prior.lamp_aim_std_deg < prior.lamps_aim_std_deg
    pose = [-6.0, 0.3, -0.2, 0.1, -0.1]
    before, after = (cramer_rao_bound(ForwardModel(s), pose).std for s in (START, found.scene))
    assert (after[:3] < 0.7 * before[:3]).all()


def test_a_drive_on_the_axis_at_one_range_tells_the_powers_alone():
    rng = np.random.default_rng(4)
    poses = np.tile([-6.0, 0.0, 0.0, 0.0, 0.0], (100, 1)) + 0.01 * rng.standard_normal((100, 5))
    scene = lights(rng)
    scene = dataclasses.replace(
        scene,
        lamps=tuple(
            dataclasses.replace(there, power=lamp.power)
            for there, lamp in zip(START.lamps, scene.lamps, strict=True)
        ),
    )
    found = calibrate(START, exposed(scene, poses, rng), poses)
    for name, parameter in named(found).items():
        if name.endswith(("x_m", "y_m", "z_m")):
            assert parameter.note == "hardly by the images"
            assert parameter.std > 0.008
    (note,) = (note for note in found.notes if note.startswith("lamps.0.x_m"))
    assert "lamps.2.z_m: hardly better than the 0.01 m of the tape: record closer" in note
    assert 0.008 < found.scene.prior.lamps_place_std_m < 0.03


def of_lamp(i):
    return slice(5 * i, 5 * i + 5)


def test_exchanged_channels_are_refused():
    images, poses, rolls = recorded(START, 35, 3)
    exchanged = np.concatenate([images[:, of_lamp(i)] for i in (1, 0, 2)], axis=1)
    refusal = calibrate(START, exchanged, poses, rolls).refusal
    # They are 0.69 m from each other, less what the tape holds back.
    assert re.search(r"lamps\.0 by 0\.6\d m, lamps\.1 by 0\.6\d m; check which channel", refusal)


def test_a_lamp_that_is_off_is_named():
    images, poses, rolls = recorded(START, 60, 3)
    noise = np.random.default_rng(1).standard_normal((len(images), 5, 5))
    images[:, of_lamp(1)] = np.rint(START.black_counts + noise)
    with pytest.raises(ValueError, match=r"lamps\.1: it lights 0\.0% of its readings; switch it"):
        calibrate(START, images, poses, rolls)


def test_images_of_a_lamp_that_blinks_and_dead_detectors_are_left_out_by_name():
    scene = lights(np.random.default_rng(8))
    images, poses, rolls = recorded(scene, 60, 3)
    lit = images[:, of_lamp(0)].max(axis=(1, 2)) > 400
    blinked = np.flatnonzero(lit)[:2]
    images[blinked, of_lamp(0)] = START.black_counts
    images[:, [1, 6, 11], 2] = START.black_counts
    images[:, 0, 4] = START.black_counts  # one channel of a detector
    found = calibrate(START, images, poses, rolls)
    assert found.outlying_images == tuple(blinked)
    assert np.argwhere(np.isnan(found.gain_std)).tolist() == [[1, 2]]
    assert any(note.startswith("detector [1, 2] always reads") for note in found.notes)
    fitted, _ = pulls(found, scene)
    own = [value for name, value in fitted.items() if name[-5:] != "power"]
    assert np.abs(own).max() < 4.5
