"""Eren et al. (2016) again: published numbers, and a second implementation in the paper's axes."""

import functools

import numpy as np
import pytest
from scipy import stats
from second_paper import OPTIONS, second_angle, second_features, second_image

from uuv_optical_array.commands.studies import paper as command
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings
from uuv_optical_array.studies import separation
from uuv_optical_array.studies.eren2016 import choices as paper_choices
from uuv_optical_array.studies.eren2016 import figures as paper
from uuv_optical_array.studies.eren2016.figures import STATEMENTS
from uuv_optical_array.studies.eren2016.reproduction import Reproduction, as_object
from uuv_optical_array.studies.separation import RECONSTRUCTION, Conditions, angles_deg


@pytest.fixture(scope="module")
def scene():
    return load_scene("eren2016")


# --- The reconstruction. ---


@pytest.mark.parametrize(
    ("shape", "at_5_deg", "at_10_deg"), [("planar", 5.9, 12.1), ("curved", 11.3, 23.1)]
)
def test_the_reconstruction_has_its_recorded_angles_at_5_and_10_deg(
    scene, shape, at_5_deg, at_10_deg
):
    found = angles_deg(scene, Conditions(shape, 21, 4.0, "yaw"), [5, 10])
    np.testing.assert_allclose(found, [at_5_deg, at_10_deg], atol=0.05)


@pytest.mark.parametrize(
    "statement",
    [s for s in STATEMENTS if s.relation != "not significant"],
    ids=lambda s: f"{s.figure}: {s.text}",
)
def test_the_reconstruction_against_what_the_paper_states(scene, statement):
    ours = statement.ours(functools.partial(angles_deg, scene))
    if statement.relation == "above":
        assert ours > statement.paper
    elif statement.relation == "below":
        assert ours < statement.paper
    elif statement.paper is not None:
        # The paper reads its curves to whole degrees; ours differ by up to 1.1 deg.
        assert abs(ours - statement.paper) < 1.2
    else:
        # `Similar`, says the paper. Ours are not.
        assert -15 < ours < -10


CASES = [
    ("planar", 21, 4.0, "shift", 0.3),
    ("planar", 21, 4.0, "yaw", 10.0),
    ("curved", 21, 4.0, "shift", 0.3),
    ("curved", 21, 4.0, "shift", 0.9),
    ("curved", 21, 4.0, "yaw", 5.0),
    ("curved", 21, 4.0, "yaw", 30.0),
    ("curved", 3, 4.0, "shift", 0.2),
    ("curved", 5, 8.0, "shift", 0.2),
    ("curved", 5, 8.0, "yaw", 10.0),
    ("curved", 7, 4.0, "yaw", 10.0),
    ("curved", 101, 6.0, "shift", 0.45),
]


@pytest.mark.parametrize("case", CASES)
def test_every_kind_of_point_is_that_of_the_second_implementation(scene, case):
    *conditions, step = case
    found = angles_deg(scene, Conditions(*conditions), [step])
    np.testing.assert_allclose(found, second_angle(*case), atol=1e-6)


def test_the_widest_gap_between_the_shapes_is_that_of_the_second_implementation(scene):
    steps = np.arange(1, 21) * 0.03
    gaps = [
        second_angle("curved", 21, 4.0, "shift", step)
        - second_angle("planar", 21, 4.0, "shift", step)
        for step in steps
    ]
    statement = next(s for s in STATEMENTS if s.relation == "similar")
    found = statement.ours(functools.partial(angles_deg, scene))
    assert found == pytest.approx(min(gaps), abs=1e-6)
    assert max(gaps) < -min(gaps)
    assert steps[np.argmin(gaps)] == pytest.approx(0.3)


@pytest.mark.parametrize(("motion", "step"), [("shift", 0.2), ("yaw", 10.0)])
def test_the_best_gain_is_that_of_the_second_implementation(scene, monkeypatch, motion, step):
    sides = (3, 5, 7, 9, 11, 21)
    monkeypatch.setattr(paper, "SIDES", sides)
    statement = next(s for s in STATEMENTS if "gain" in s.text and motion in s.text)
    angles = {side: second_angle("curved", side, 4.0, motion, step) for side in sides}
    expected = max(angles[side] - angles[7] for side in (9, 11, 21))
    found = statement.ours(functools.partial(angles_deg, scene))
    assert found == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("text", OPTIONS)
def test_every_other_choice_is_what_it_says(scene, text):
    choice = next(c for c in paper_choices.alternatives(None) if c.text == text)
    for case in [
        ("curved", 21, 4.0, "shift", 0.3),
        ("planar", 21, 4.0, "yaw", 10.0),
        ("curved", 5, 8.0, "yaw", 12.0),
        ("curved", 5, 8.0, "shift", 0.2),
        ("curved", 11, 8.0, "yaw", 10.0),
    ]:
        *conditions, step = case
        found = angles_deg(scene, Conditions(*conditions), [step], choice)
        if "11 detectors" in text and case[1] == 5:
            # Mirrored, the window spans 5 detectors twice: nothing is left of an even image.
            image = second_image("curved", 5, [-8.0, 0, 0], 0, samples=11)
            assert np.ptp(image) < 1e-12 * image.max()
            assert np.isnan(found)
            continue
        np.testing.assert_allclose(found, second_angle(*case, **OPTIONS[text]), atol=1e-5)


@pytest.mark.parametrize("shift", [0.0, 0.03])
def test_the_choice_with_noise_is_the_mean_over_noisy_rounded_readings(scene, monkeypatch, shift):
    monkeypatch.setattr(paper_choices, "NOISE_DRAWS", 500)
    noisy = paper_choices.noisy(np.random.default_rng(1))
    found = angles_deg(scene, Conditions("curved", 5, 8.0, "shift"), [shift], noisy)
    rng = np.random.default_rng(2)
    counts = 1000 / second_image("curved", 5, [-4.0, 0, 0], 0).max()
    images = [counts * second_image("curved", 5, [-8.0, y, 0], 0) for y in (0, shift)]
    top, angles = images[0].max(), []
    for _ in range(500):
        read = [np.rint(image + rng.standard_normal(image.shape)) for image in images]
        u, v = (second_features(image, top) for image in read)
        angles.append(np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))))
    spread = np.std(angles) * np.sqrt(2 / 500)
    assert abs(found[0] - np.mean(angles)) < 5 * spread
    exact = second_angle("curved", 5, 8.0, "shift", shift)
    assert np.mean(angles) - exact > 10 * spread, "and the noise is worth a row"


def test_every_choice_suits_every_scene():
    # With no blur at all, and with a noise that a reading without noise must leave out.
    settings = load_scene("follow").settings()
    settings["effects"] = {"shot_noise": {"electrons_per_count": 50.0}, "adc": {"bits": 12}}
    other = scene_from_settings(settings, "other")
    for choice in paper_choices.alternatives(np.random.default_rng(1)):
        assert angles_deg(other, Conditions("planar", 7, 5.0, "yaw"), [20.0], choice) > 1


def test_what_has_no_number_is_flat_and_met_by_nobody():
    above = next(s for s in STATEMENTS if s.relation == "above")
    assert above.met(np.nan) is False
    assert command.number(np.nan) == "flat"
    (point,) = as_object(Reproduction([np.nan]))["figures"]["4a"]["points"]
    assert point["ours_deg"] is None
    stated = next(s for s in STATEMENTS if s.relation == "is")
    assert command.verdict(stated, np.nan) == ""


def test_every_choice_is_checked_above():
    names = [choice.text for choice in paper_choices.alternatives(np.random.default_rng(1))]
    assert names == [*OPTIONS, "10 bits, noise of 1 count"]
    assert RECONSTRUCTION.text == names[0]


# --- Its parts. ---


@pytest.mark.parametrize(
    ("move", "feature", "sign"),
    [
        ([0, 0.3, 0, 0, 0], 1, -1),  # to starboard: the spot goes to port
        ([0, 0, 0, 0, 0.2], 1, -1),  # bow to starboard: to port
        ([0, 0, 0.3, 0, 0], 2, -1),  # down: up
        ([0, 0, 0, 0.2, 0], 2, 1),  # bow up: down
    ],
)
def test_a_move_in_the_papers_axes_is_seen_where_it_should_be(scene, move, feature, sign):
    pose = separation.from_paper_axes(np.array([4.0, 0, 0, 0, 0]) + move)
    found = key_parameters(ForwardModel(scene).expected(pose), 1023, "detector")
    assert sign * found[feature] >= 2
    assert found[3 - feature] == 0


def test_the_papers_axes_count_the_range_positive():
    pose = separation.from_paper_axes([4.0, 0, 0, 0, 0])
    np.testing.assert_array_equal(pose, [-4.0, 0, 0, 0, 0])
    assert not np.signbit(pose[1:]).any()


def test_the_papers_signature_counts_from_one_at_the_port_and_top_edge():
    image = np.random.default_rng(3).uniform(0, 500, (2, 5, 5))
    image[0, 0, 3], image[1, 4, 0] = 800, 600
    found = separation.paper_signature(image, 1000)
    np.testing.assert_allclose(found[:, :3], [[0.8, 4 / 5, 1 / 5], [0.6, 1 / 5, 5 / 5]])
    for vector, (row, column), frame in zip(found, [(0, 3), (4, 0)], image, strict=True):
        skews = [stats.skew(np.gradient(profile)) for profile in (frame[row], frame[:, column])]
        np.testing.assert_allclose(vector[3:], skews)


def test_the_plain_five_numbers_of_the_papers_array_do_not_see_range_when_aligned(scene):
    images = ForwardModel(scene).expected([[-4.0, 0, 0, 0, 0], [-8.0, 0, 0, 0, 0]])
    near, far = key_parameters(images, scene.full_scale_counts, "detector")
    assert near[0] > 5 * far[0]
    # Skewnesses of symmetric profiles are 0 but for rounding, which a weak peak magnifies.
    assert spectral_angle(near, far) < 1e-13
    own_top = [separation.paper_signature(image, image.max()) for image in images]
    assert spectral_angle(*own_top) < 1e-13
    # A peak over one full scale beside positions that count from the edge is another matter.
    one_top = [separation.paper_signature(image, 1023.0) for image in images]
    expected = [np.arctan2(11 / 21 * np.sqrt(2), image.max() / 1023) for image in images]
    assert spectral_angle(*one_top) == pytest.approx(expected[1] - expected[0], abs=1e-12)


def test_the_least_step_is_the_first_that_reaches_15_deg():
    steps = np.array([0.0, 0.1, 0.2, 0.3])
    assert paper.least_detected(steps, np.array([0, 14.999, 15.0, 3.0])) == 0.2
    assert paper.least_detected(steps, np.array([0, 1.0, 2.0, 14.999])) is None


def test_the_scene_is_the_papers(scene):
    array, model = scene.array, ForwardModel(scene)
    assert (array.shape, array.detectors_per_side, array.width_m) == ("curved", 21, 0.4)
    assert (array.bow_m, array.radius_m) == (0.4, 0.32)
    assert model.array.spacing_m == pytest.approx(0.02)
    assert scene.signature.peak == "detector"
    assert scene.signature.lift == 0
    assert scene.full_scale_counts == 1023


def test_panels_are_the_papers():
    panels = paper.panels()
    assert list(panels) == ["4a", "4b", "5a", "5b", "6a", "6b", "6c", "6d", "6e", "6f"]
    assert {c.shape for c in panels["4b"]} == {"planar", "curved"}
    assert [panels["5a"][i].side for i in (0, -1)] == [3, 101]
    for panel, side, motion in (("6a", 3, "shift"), ("6e", 5, "yaw"), ("6f", 101, "yaw")):
        assert [c.range_m for c in panels[panel]] == [4, 5, 6, 7, 8]
        assert {(c.side, c.motion, c.shape) for c in panels[panel]} == {(side, motion, "curved")}
    np.testing.assert_allclose(np.diff(paper.STEPS["shift"]), 0.03)
    assert paper.STEPS["shift"][-1] == pytest.approx(0.9)
    np.testing.assert_array_equal(paper.STEPS["yaw"], range(31))
