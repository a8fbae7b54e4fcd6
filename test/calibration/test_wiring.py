"""The wiring of an array: at the door, and found with a torch."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import changed

from uuv_optical_array.calibration.wiring import TorchSweeps, description
from uuv_optical_array.core.messages import as_wired, in_place
from uuv_optical_array.forward.array import ArraySettings
from uuv_optical_array.forward.scene import load_scene, save_scene

WIDTH_M, FULL, RATE_HZ = 0.4, 4095.0, 20
# What the message shows of an image, written as NumPy does to the image, by what the report says.
SYMMETRIES = {
    "in reading order": lambda image: image,
    "mirrored, port with starboard": np.fliplr,
    "mirrored, top with bottom": np.flipud,
    "turned by half a turn": lambda image: np.rot90(image, 2),
    "turned by a quarter, clockwise": lambda image: np.rot90(image, -1),
    "turned by a quarter, anticlockwise": np.rot90,
    "transposed": np.transpose,
    "transposed about the other diagonal": lambda image: np.rot90(np.transpose(image), 2),
}


def torch_run(side, rng, distance_m=0.12, reach_m=0.35, sweep_s=6.0, hand_m=0.02):
    """Yield stamps and images of a torch before an array in daylight: a point's light, by hand."""
    across = np.linspace(WIDTH_M / 2, -WIDTH_M / 2, side)  # y from port, z from the top
    z, y = np.meshgrid(across, across, indexing="ij")
    gains = rng.uniform(0.7, 1.3, (side, side))
    stamp = 10**15

    def exposed(torch=None):
        light = np.zeros((side, side))
        if torch is not None:
            square = (y - torch[0]) ** 2 + (z - torch[1]) ** 2 + distance_m**2
            light = 3000 * distance_m**3 / square**1.5
        counts = gains * (light + 200) + rng.normal(0, 2, (side, side))
        return np.clip(np.rint(counts), 0, FULL)

    def dark():
        return [None] * int(1.5 * RATE_HZ)

    travel = np.linspace(reach_m, -reach_m, int(sweep_s * RATE_HZ))
    hand = hand_m * np.sin(np.arange(len(travel)) / 9)
    first, second = np.stack([travel, hand], 1), np.stack([hand, travel], 1)
    for torch in [*dark(), *first, *dark(), *second, *dark()]:
        yield stamp, exposed(torch)
        stamp += 10**9 // RATE_HZ


def found(side, change, rng, **how):
    sweeps = TorchSweeps(side, FULL)
    for stamp, image in torch_run(side, rng, **how):
        sweeps.take(stamp, change(image))
    return sweeps.wiring


@pytest.mark.parametrize("words", SYMMETRIES)
def test_each_symmetry_of_the_square_is_found_and_named(words):
    assert description(found(5, SYMMETRIES[words], np.random.default_rng(1)), 5) == words


@settings(max_examples=15)
@given(st.permutations(range(25)), st.integers(0, 99))
def test_any_wiring_is_found(order, seed):
    def change(image):
        return image.ravel()[list(order)].reshape(5, 5)

    wiring = found(5, change, np.random.default_rng(seed))
    image = np.arange(25.0).reshape(5, 5)
    np.testing.assert_array_equal(in_place(change(image), wiring), image)
    np.testing.assert_array_equal(as_wired(image, wiring), change(image))


def with_a_dead_detector(image):
    return np.where(np.arange(25).reshape(5, 5) == 13, 0.0, image)


def test_two_swapped_wires_of_a_large_array_are_found():
    def swapped(image):
        pixels = image.ravel().copy()
        pixels[[7, 8]] = pixels[[8, 7]]
        return pixels.reshape(image.shape)

    wiring = found(9, swapped, np.random.default_rng(2), sweep_s=12.0, hand_m=0.0)
    expected = np.arange(81)
    expected[[7, 8]] = 8, 7
    assert wiring == expected.tolist()
    assert description(wiring, 9) == "2 of 81 readings are of other detectors"


@pytest.mark.parametrize(
    ("change", "how", "words"),
    [
        (np.transpose, {"distance_m": 20.0}, "cannot be separated"),
        (np.transpose, {"reach_m": 0.05}, "(cannot be separated|not seen by)"),
        (np.transpose, {"sweep_s": 0.5}, "move the torch more slowly"),
        (with_a_dead_detector, {}, r"not seen by 1 of 25 readings.*row 2, column 3"),
    ],
)
def test_a_sweep_that_does_not_tell_is_refused_with_a_cure(change, how, words):
    with pytest.raises(ValueError, match=words):
        found(5, change, np.random.default_rng(3), **how)


@pytest.mark.parametrize("sign", [0, 1])
def test_a_torch_that_shines_at_first_need_only_be_switched_off(sign):
    """Held still or moved: what is darker than the first second is the background."""
    rng, rate = np.random.default_rng(6), 10**9 // RATE_HZ
    run = list(torch_run(5, rng))
    start = run[0][0] - 2 * RATE_HZ * rate
    sweeps = TorchSweeps(5, FULL)
    for i in range(2 * RATE_HZ):
        torch = 1000 + 500 * sign * np.sin(i / 5)
        sweeps.take(start + i * rate, np.rint(200 + torch + rng.normal(0, 2, (5, 5))))
    for stamp, image in run:
        sweeps.take(stamp, image)
    assert sweeps.wiring == list(range(25))


def test_two_sweeps_along_one_axis_are_told():
    sweeps = TorchSweeps(5, FULL)
    run = list(torch_run(5, np.random.default_rng(5)))
    again = [image for _, image in run[: len(run) // 2 + 15]] * 2

    def take_all():
        for i, image in enumerate(again):
            sweeps.take(i * 10**9 // RATE_HZ, image)

    with pytest.raises(ValueError, match="same order"):
        take_all()


def test_a_scene_keeps_its_wiring_and_refuses_what_is_none(tmp_path):
    assert "wiring" not in load_scene("follow").settings()["array"]
    turned = np.rot90(np.arange(25).reshape(5, 5)).ravel().tolist()
    save_scene(changed("follow", array={"wiring": turned}), tmp_path / "turned.yaml", "a test")
    assert load_scene(tmp_path / "turned.yaml").array.wiring == turned
    for bad, words in (
        (list(range(24)), "24 places, but the array has 25"),
        ([*turned[:-1], turned[0]], r"wiring\[24\]: 4 is given twice"),
        ([*turned[:-1], 25], r"wiring\[24\]: 25 is too large"),
        ([*turned[:-1], 0.5], "not a whole number"),
        ("mirrored", "not a list of whole numbers"),
    ):
        with pytest.raises(ValueError, match=words):
            changed("follow", array={"wiring": bad})


def test_a_smaller_array_of_a_study_has_no_wiring():
    wired = ArraySettings("planar", 2, wiring=[1, 0, 3, 2])
    assert wired.with_shape("curved").wiring == [1, 0, 3, 2]
