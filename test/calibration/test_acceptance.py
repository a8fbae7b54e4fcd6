"""The acceptance test of an array: what passes, and what each fault is called."""

import dataclasses

import numpy as np
import pytest
from bags import image_message, write_bag
from command_line import run, text_of
from needs import rosbags

from uuv_optical_array.calibration.acceptance import Acceptance, in_air
from uuv_optical_array.core.messages import as_wired
from uuv_optical_array.forward.array import build_array
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

pytestmark = pytest.mark.usefixtures("compiled_fit")
SCENE, LIGHTS, RANGE_M = load_scene("follow"), load_scene("leading_lights"), 4.0
WIRED = [int(place) for place in np.random.default_rng(2).permutation(25)]


def session(
    gain=1.0, noise=1.0, offset=0.0, flicker=0.0, at=(-RANGE_M, 0.02, -0.03, 0.02, 0.03), pause=0,
    scene=SCENE, channels=(0, 1, 2), powers=1.0,
):  # fmt: skip
    """Yield stamps and images: darkness, both sweeps and the lamps, of detectors with faults.

    `gain`, `noise` and `offset` are numbers or grids, of all lamps alike or for each; `flicker` and
    `powers` are numbers or of each lamp. The torch is modulated as the last one.
    """
    rng, array, lamps = np.random.default_rng(4), build_array(scene.array), scene.lamp_count
    y, z = array.positions[:, 1].reshape(5, 5), array.positions[:, 2].reshape(5, 5)
    lamp = ForwardModel(scene).light(np.array(at)).reshape(lamps, 5, 5) - scene.black_counts
    lamp = lamp[list(channels[:lamps])] * np.reshape(powers, (-1, 1, 1))
    gains = gain * (1 + 0.03 * rng.standard_normal((5, 5)))
    dark = np.zeros((lamps, 5, 5))

    def torch(a, b):
        light = dark.copy()
        light[-1] = 600 * (1 + ((y - a) ** 2 + (z - b) ** 2) / 0.12**2) ** -1.5
        return light

    travel = np.linspace(0.35, -0.35, 50)
    lights = [dark] * 105 + [torch(a, 0.01) for a in travel] + [dark] * 15
    lights += [torch(-0.01, a) for a in travel] + [dark] * 15
    for _ in range(105):
        wavers = np.multiply(flicker, rng.standard_normal())
        lights.append(lamp * (1 + np.reshape(wavers, (-1, 1, 1))))
    stamp = 10**15
    for number, light in enumerate(lights):
        stamp += 10**8 + (pause if number == len(lights) - 20 else 0)
        counts = gains * light + 20 + offset + noise * rng.standard_normal((lamps, 5, 5))
        image = np.clip(np.rint(counts), 0, 1023).reshape(-1, 5)
        yield stamp, as_wired(image, WIRED)


def faults_of(scene=SCENE, **faults):
    test = Acceptance(scene, RANGE_M, lambda line: None)
    for stamp, image in session(scene=scene, **faults):
        test.take(stamp, image)
    assert test.complete
    assert test.wiring == WIRED
    return test.verdict()[:2]


def at(place, value, others):
    grid = np.full((5, 5), float(others))
    grid[place] = value
    return grid


def of_one_lamp(i, place, value):
    return np.array([at(place, value if k == i else 1, 1) for k in range(3)])


@pytest.mark.parametrize(("sea", "daylight"), [(SCENE, 0.0), (SCENE, 50.0), (LIGHTS, 0.0)])
def test_a_sound_array_passes(sea, daylight):
    assert faults_of(sea, offset=daylight) == ({}, [])


@pytest.mark.parametrize("sea", [SCENE, LIGHTS])
def test_a_sound_array_passes_though_hands_placed_the_lamp(sea):
    """By up to 0.3 m and 8 deg; its power is a fifth below the scene's."""
    aside = (-1.05 * RANGE_M, 0.3, -0.25, np.radians(-8.0), np.radians(7.0))
    assert faults_of(sea, at=aside, powers=0.8) == ({}, [])


@pytest.mark.parametrize(
    ("sea", "fault", "place", "words"),
    [
        (SCENE, {"gain": at((1, 3), 0.6, 1)}, (1, 3), "does not fit the lamp's light"),
        # A dim corner looks like a beam from the side, but for where the lamp was placed.
        (SCENE, {"gain": at((0, 0), 0.5, 1)}, (0, 0), "does not fit the lamp's light"),
        (LIGHTS, {"gain": at((4, 4), 0.5, 1)}, (4, 4), "does not fit the lamp's light"),
        (SCENE, {"noise": at((4, 0), 5, 1)}, (4, 0), "noise 4."),
        (SCENE, {"offset": at((2, 2), 40, 0)}, (2, 2), "reads 59.9 in the dark, the others 20"),
        (SCENE, {"gain": at((2, 1), 1.0, 1) * 1.6}, (2, 2), "at full scale"),
        (LIGHTS, {"gain": at((1, 3), 0.6, 1)}, (1, 3), "does not fit the lamp's light"),
        (LIGHTS, {"noise": of_one_lamp(2, (4, 0), 5)}, (4, 0), "noise 4."),
        (LIGHTS, {"offset": 40 * (of_one_lamp(1, (2, 2), 2) - 1)}, (2, 2), "reads 60.2 in the da"),
    ],
)
def test_a_fault_is_told_of_its_detector(sea, fault, place, words):
    detectors, whole = faults_of(sea, **fault)
    assert detectors[place].startswith(words)
    if words != "at full scale":
        assert (list(detectors), whole) == ([place], [])


@pytest.mark.parametrize(
    ("sea", "fault", "words"),
    [
        (SCENE, {"flicker": 0.04}, "the lamp flickers by "),
        (SCENE, {"at": (-6.5, 0, 0, 0, 0)}, "the lamp is seen from x -6."),
        (SCENE, {"at": (-RANGE_M, 1.4, 0, 0, 0)}, "the lamp is seen from x -"),
        (SCENE, {"pause": 10**9}, "a gap of 1.1 s"),
        (LIGHTS, {"flicker": (0, 0.04, 0)}, "lamps[1] flickers by "),
        (LIGHTS, {"powers": (1, 1, 0)}, "lamps[2]: no light: switch it on"),
        (LIGHTS, {"channels": (1, 0, 2)}, "the lamp's light is not explained"),
        (LIGHTS, {"channels": (1, 2, 0)}, "the lamps appear rolled by 120 deg"),
        (LIGHTS, {"at": (-6.5, 0, 0, 0, 0)}, "the lamp is seen from x -6."),
    ],
)
def test_a_fault_of_the_whole_is_told(sea, fault, words):
    detectors, (text,) = faults_of(sea, **fault)
    assert not detectors
    assert text.startswith(words)


def test_the_lamp_has_to_shine_without_a_break():
    test, frames = Acceptance(SCENE, RANGE_M, lambda line: None), list(session())
    for stamp, image in frames[:-60]:
        test.take(stamp, image)
    for later in (0, 60):  # off for an image, then on
        for stamp, image in frames[-60:]:
            test.take(stamp + later * 10**8, image if later else frames[0][1])
            assert not test.complete
    test.take(stamp + 11 * 10**9, image)
    assert test.complete


def test_air_takes_the_water_away_and_widens_the_beam():
    air = in_air(SCENE)
    assert set(air.effects) == {"sensor_noise", "saturation", "adc"}
    assert air.lamp.beam_sigma_deg == pytest.approx(8 * 1.34)
    assert "plume" not in in_air(load_scene("night_plume")).effects
    # Of the same lamp: dimmer by refraction alone, where there is no water to take away.
    clear = load_scene("ideal")
    assert in_air(clear).lamp.reference_counts == pytest.approx(
        clear.lamp.reference_counts / 1.34**2
    )
    first, *others = LIGHTS.lamps
    own = dataclasses.replace(first, beam_sigma_deg=5.0)
    lit = in_air(dataclasses.replace(LIGHTS, lamps=(own, *others)))
    assert lit.lamps[0].beam_sigma_deg == pytest.approx(5 * 1.34)


@rosbags
def test_the_command_says_pass_or_fail_of_each_detector(tmp_path):
    for name, faults, code in (("good", {}, 0), ("bad", {"noise": at((4, 0), 5, 1)}, 1)):
        messages = [image_message(*each) for each in session(**faults)]
        bag = write_bag(tmp_path / name, messages, "MCAP")
        words = ("--lamp", RANGE_M, "-o", tmp_path / "sea.yaml")
        out = text_of(run, "commission", bag, *words, code=code)
        assert out.count("pass  ") + out.count("pass\n") == 25 - code
        assert ("acceptance test: passed" in out) == (code == 0)
    assert "detector [4, 0] fails: noise 4" in out
    assert load_scene(tmp_path / "sea.yaml").array.wiring == WIRED
    lights = [image_message(*each) for each in session(scene=LIGHTS)]
    bag = write_bag(tmp_path / "lights", lights, "MCAP")
    words = ("--scene", "leading_lights", "-o", tmp_path / "lights.yaml")
    out = text_of(run, "commission", bag, "--lamp", RANGE_M, *words)
    assert "move one of the lamps, lit, in place of the torch" in out
    assert "acceptance test: passed" in out
    assert load_scene(tmp_path / "lights.yaml").array.wiring == WIRED
    cut = write_bag(tmp_path / "cut", messages[:-60], "MCAP")
    line = run("commission", cut, "--lamp", RANGE_M, "-o", tmp_path / "sea.yaml", code=1)
    assert "not seen: the lamp: 4.4 of 10 s without a break" in line
