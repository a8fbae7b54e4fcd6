"""``uuv_array commission`` rehearsed on the emulator's bench, which has a torch and a lamp."""

import dataclasses
import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from uuv_optical_array.calibration.acceptance import Acceptance, in_air
from uuv_optical_array.calibration.wiring import TorchSweeps
from uuv_optical_array.commands.commission import PATIENCE_S, TELL_S, Watch, report
from uuv_optical_array.forward.link_budget import Instrument, scene_with
from uuv_optical_array.forward.scene import load_scene

EMULATOR = Path(__file__).parents[2] / "examples/serial_array_emulator.py"
spec = importlib.util.spec_from_file_location("serial_array_emulator", EMULATOR)
emulator = importlib.util.module_from_spec(spec)
spec.loader.exec_module(emulator)

pytestmark = pytest.mark.usefixtures("compiled_fit")
RATE_HZ = 10
# What is typed, and for how many seconds it stays.
SESSION = ("off", 11), ("1", 10), ("2", 10), ("lamp", 11)
FOLLOW, LIGHTS = load_scene("follow"), load_scene("leading_lights")
GUIDE = in_air(scene_with(FOLLOW, Instrument()))
WIRED = [int(place) for place in np.random.default_rng(5).permutation(25)]


def rehearsed(test, scene, at_m, session=SESSION):
    """Give a test the images of a bench whose lamp stands at a range, and return it."""
    array = dataclasses.replace(scene.array, wiring=WIRED)
    wired = dataclasses.replace(scene, array=array)
    bench, now_s = emulator.Bench(wired, at_m, np.random.default_rng(3)), 0.0
    for what, seconds in session:
        bench.do(what, now_s)
        for _ in range(seconds * RATE_HZ):
            test.take(round(now_s * 1e9), bench.image(now_s))
            now_s += 1 / RATE_HZ
    return test


@pytest.mark.parametrize("scene", [FOLLOW, in_air(FOLLOW), GUIDE, LIGHTS])
def test_a_sound_array_passes_and_is_seen_where_it_was_told(scene, capsys):
    test = rehearsed(Acceptance(scene, 4.0, lambda line: None), scene, 4.0)
    assert test.missing == ""
    assert test.wiring == WIRED
    assert report(test, 5, 4.0) == 0
    printed = capsys.readouterr().out
    assert "acceptance test: passed" in printed
    rows = {line.split()[0]: line.split() for line in printed.splitlines() if " (" in line}
    assert list(rows) == ["x", "y", "z", "pitch", "yaw"]
    # Told, found and standard deviation; the bench misses the place by what hands do.
    aside = [-4.0, *emulator.HELD[:2], *np.degrees(emulator.HELD[2:])]
    for row, told, true in zip(rows.values(), [-4.0, 0, 0, 0, 0], aside, strict=True):
        assert float(row[2]) == told
        assert abs(float(row[3]) - true) < 2 * float(row[4])


@pytest.mark.parametrize("scene", [FOLLOW, in_air(FOLLOW), GUIDE, LIGHTS])
@pytest.mark.parametrize(("at_m", "told_m", "light"), [(4.0, 5.0, "1."), (5.0, 4.0, "0.")])
def test_a_lamp_that_is_elsewhere_than_told_fails(scene, at_m, told_m, light):
    test = rehearsed(Acceptance(scene, told_m, lambda line: None), scene, at_m)
    (text,) = test.verdict().whole
    assert text.startswith(f"the lamp is seen from x -{at_m:g}"[:-1])
    assert f"not from x -{told_m:g}: measure the distance again" in text
    assert f"the light is {light}" in text


def test_the_pedestal_of_the_sender_has_to_be_that_of_the_scene():
    """Darkness that reads too low for any daylight, and a pedestal that hides as daylight."""
    bare = scene_with(FOLLOW, Instrument(pedestal_counts=0))
    told = scene_with(FOLLOW, Instrument())
    assert rehearsed(Acceptance(told, 4.0, lambda line: None), told, 4.0).verdict().whole == []
    found = rehearsed(Acceptance(told, 4.0, lambda line: None), bare, 4.0).verdict()
    (text,) = found.whole
    assert text.startswith("darkness reads 0 counts, and the scene's pedestal is 100")
    modulated = {"waveform": "square", "pedestal_counts": 80.0}
    effects = {**LIGHTS.effects, "demodulation": modulated}
    demodulated = dataclasses.replace(LIGHTS, effects=effects)
    found = rehearsed(Acceptance(LIGHTS, 4.0, lambda line: None), demodulated, 4.0).verdict()
    assert found.dark_counts == (pytest.approx(80.0, abs=0.2), 20.0)
    assert any(text.startswith("darkness reads ") for text in found.whole)


def test_a_torch_before_a_planar_array_is_followed():
    flat = FOLLOW.with_shape("planar")
    assert rehearsed(TorchSweeps(5, 1023.0), flat, 4.0, SESSION[:3]).wiring == WIRED


@pytest.mark.parametrize(
    ("session", "words"),
    [
        ([], "no image: start the node"),
        ([("off", 3)], "the background: 2.9 of 10 s"),
        ([("off", 15)], "the torch of sweep 1 of 2: the brightest reading is "),
        ([("off", 11), ("1", 4)], "the end of sweep 1 of 2"),
        ([("off", 11), ("1", 12)], "the torch of sweep 2 of 2: "),
        (SESSION[:3], "the lamp: the brightest reading is "),
        ([*SESSION[:3], ("lamp", 4)], "the lamp: 3.9 of 10 s"),
    ],
)
def test_what_is_not_seen_is_named(session, words):
    test = rehearsed(Acceptance(FOLLOW, 4.0, lambda line: None), FOLLOW, 4.0, session)
    assert test.missing.startswith(words)


def test_waiting_is_told_and_ends():
    said: list[str] = []
    now = [0.0]
    watch = Watch(Acceptance(FOLLOW, 4.0, lambda line: None), said.append, lambda: now[0])
    assert watch.wanted()
    assert said == []
    now[0] = TELL_S
    assert watch.wanted()
    (text,) = said
    assert text.startswith("not seen: no image")
    assert watch.wanted()
    assert len(said) == 1
    now[0] = PATIENCE_S - 1
    watch.take(0, np.full((5, 5), 3.0))  # something new: the patience begins anew
    assert watch.wanted()
    now[0] = 2 * PATIENCE_S - 2
    assert watch.wanted()
    now[0] = 2 * PATIENCE_S
    assert not watch.wanted()
    assert watch.over


def test_the_emulator_obeys_what_is_typed(tmp_path):
    words = [sys.executable, EMULATOR, "--link", tmp_path / "array", "--bench", "4", "--shuffle"]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    ) as process:
        assert process.stdout.readline().startswith("port: ")
        assert process.stdout.readline().startswith("dark; type 1")
        for word, answer in (("1", "1: the torch moves for 8 s"), ("torch", "torch: unknown")):
            process.stdin.write(f"{word}\n")
            assert process.stdout.readline().startswith(answer)
        process.terminate()
