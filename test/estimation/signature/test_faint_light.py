"""Light that no single image shows: its false alarms, closed forms, and sides of a lamp."""

import numpy as np
import pytest
from scenes import ready
from scipy.stats import binom

from uuv_optical_array.estimation.signature import faint_light
from uuv_optical_array.estimation.signature.daylight import Daylight
from uuv_optical_array.estimation.signature.faint_light import (
    BEFORE_S,
    MOST_GAP_S,
    NEW_S,
    FaintLight,
)
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import power_offsets

STEP_S = 0.1
U, V = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)))


def shown(faint, images, begin_s=0.0):
    """Return what each image, one in `STEP_S`, shows."""
    return [faint.look(begin_s + STEP_S * k, image) for k, image in enumerate(images)]


def daylight(rng, count, level, uneven):
    """Return images of daylight with a slope, unequal darks and gains, read in whole counts."""
    light = level + uneven * (0.8 * U - 0.5 * V) + uneven * rng.normal(0, 0.5, 25)
    gains = 1 + 0.02 * uneven * rng.normal(0, 1, 25)
    readings = np.rint(gains * light + rng.normal(0, 1, (count, 25)))
    return readings.clip(0, 1023).reshape(count, 5, 5)


@pytest.mark.parametrize(("level", "uneven"), [(0.0, 0.0), (5.0, 0.0), (5.0, 3.0)])
def test_what_lasts_shows_light_as_rarely_as_is_said(monkeypatch, level, uneven):
    """Half of what noise is so odd by shows less light than before, which is no lamp's."""
    odd, runs = 0.05, 600
    monkeypatch.setattr(faint_light, "ODD_DAYLIGHT", odd)
    rng = np.random.default_rng(11)
    hits = 0
    for _ in range(runs):
        hits += shown(FaintLight(5), daylight(rng, 20, level, uneven))[-1] is not None
    assert binom.ppf(1e-4, runs, 0.7 * odd / 2) <= hits <= binom.isf(1e-4, runs, odd / 2)


def test_a_level_of_daylight_that_changes_shows_no_light():
    rng = np.random.default_rng(12)
    for level in (0.5, 2.0, 8.0):
        images = np.concatenate([daylight(rng, 100, 4.0, 0.0), daylight(rng, 100, level, 0.0)])
        assert shown(FaintLight(5), images) == [None] * 200


@pytest.mark.parametrize("step_s", [0.1, 0.5])
def test_light_that_comes_shows_as_two_means_differ_by_it(step_s):
    """Light of two counts and slopes, without noise; the means forget at their time constants."""
    level, slopes, k = 2.0, np.array([-1.2, 0.6]), 7
    light = (level + slopes @ np.array([U, V])).reshape(5, 5)
    faint, before = FaintLight(5), round(10 * BEFORE_S / step_s)
    for i in range(before):
        assert faint.look(step_s * i, np.zeros((5, 5))) is None
    for i in range(before, before + k):
        came = faint.look(step_s * i, light)
    left = np.exp(-k * step_s / np.array([NEW_S, BEFORE_S]))
    np.testing.assert_allclose(came, (left[1] - left[0]) * light, rtol=1e-4)


def test_one_detector_that_brightens_shows_as_a_flat_bowl():
    odd = np.zeros((5, 5))
    odd[2, 2] = 8.0
    faint = FaintLight(5)
    shown(faint, np.zeros((200, 5, 5)))
    came = shown(faint, [odd] * 10, 20.0)[-1]
    assert came is not None
    assert came[2, 2] == came.max()
    shares = came / odd.max()
    fitted = np.linalg.lstsq(np.stack([U**0, U, V, U**2 + V**2], 1), came.ravel(), rcond=None)
    assert (shares < 0.2).all()
    np.testing.assert_allclose(fitted[0][1:3], 0.0, atol=1e-9)


def test_light_that_goes_and_what_comes_after_a_gap_show_none():
    rng = np.random.default_rng(13)
    dark, lit = daylight(rng, 100, 0.0, 0.0), daylight(rng, 100, 2.0, 1.5)
    assert shown(FaintLight(5), [*lit, *dark]) == [None] * 200
    for gap_s, shows in ((0.9 * MOST_GAP_S, True), (1.1 * MOST_GAP_S, False), (-1.0, False)):
        faint = FaintLight(5)
        shown(faint, dark)
        begin_s = 99 * STEP_S + gap_s
        assert any(came is not None for came in shown(faint, lit[:40], begin_s)) == shows


@pytest.mark.parametrize(("y", "z"), [(3.2, 0), (-3.2, 0), (0, 3.2), (0, -3.2), (-2.3, 2.3)])
def test_a_lamp_far_aside_shows_on_its_side_in_three_seconds_but_in_no_image(y, z):
    """As where a follower has lost its leader: 8.5 m behind it, 21 deg off the axis of its beam."""
    model, rng = ForwardModel(ready("follow")), np.random.default_rng(14)
    light = model.light([-8.5, y, z, 0, 0], 0.0)
    out = model.light([-8.5, y, z, 0, 0], 0.0, power_offsets([0.0], 1))
    explains, faint = Daylight(model).explains, FaintLight(5)
    images = [model.read(each, rng) for each in [*[out] * 100, *[light] * 30]]
    assert all(image.max() < 5 or explains(image) for image in images)
    found = shown(faint, images)
    assert found[:100] == [None] * 100
    came = found[-1]
    port, top = came[:, :2].sum() - came[:, 3:].sum(), came[:2].sum() - came[3:].sum()
    for side, brighter in ((-y, port), (-z, top)):
        assert brighter * np.sign(side) > 0 if side else abs(brighter) < came.sum() / 3
