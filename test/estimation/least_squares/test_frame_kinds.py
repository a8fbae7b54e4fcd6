"""Sizes of what a scene does not describe: what each leaves unknown, and how often it is."""

import numpy as np
import pytest
from scenes import changed, coarse, with_prior

from uuv_optical_array.estimation.least_squares.frame_kinds import expecting, frame_kinds
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

PRIOR = np.array([-6.0, 0, 0, 0, 0]), np.array([6.0, 1.8, 1.8, 1.0, 1.0])
# Of a shade of a fifth in the logarithm of the light: it dims, it slopes, it bends.
SHADE = {"lamp.power": 0.2, "shade.mode_1": 0.05, "shade.mode_2": 0.05, "shade.mode_4": 0.0125}


def stds(kind):
    """Return the standard deviations of a kind's nuisances, by name."""
    return dict(zip(kind.names, kind.problem.nuisance_std.tolist(), strict=True))


def test_a_size_is_so_much_of_a_shade_and_of_daylight():
    clear, *others = frame_kinds(
        ForwardModel(with_prior(coarse("reference"), uneven_probability=0.1)), *PRIOR
    )
    shares = [kind.share for kind in (clear, *others)]
    assert shares == pytest.approx([0.9, 0.2 / 3, 0.028, 0.004, 0.1 / 75])
    known = stds(clear)
    assert not {"shade.mode_1", "ambient.to_bottom_counts"} & set(known)
    for size, kind in zip((0.25, 1.0, 2.0, 3.0), others, strict=True):
        found = stds(kind)
        for name, std in SHADE.items():
            assert found[name] == pytest.approx(np.hypot(known.get(name, 0.0), size * std))
        # Two percent of a full scale of 1023 counts, from the middle to an edge.
        assert found["ambient.to_bottom_counts"] == pytest.approx(size * 20.46)
        # What is no mode is as strong as one of the second order.
        white = np.sqrt(kind.problem.noise.square - clear.problem.noise.square)
        assert white == pytest.approx(size * 0.0125)


def test_what_is_known_exactly_leaves_no_size_but_by_several_lamps():
    assert len(frame_kinds(ForwardModel(coarse("reference")), *PRIOR)) == 1
    clear, small, large = frame_kinds(ForwardModel(load_scene("leading_lights")), *PRIOR)
    known = stds(clear)
    for size, kind in ((0.25, small), (1.0, large)):
        found = stds(kind)
        for name, std in {
            "follower.roll_rad": 0.3,
            "lamps.1.power": 0.2,
            "lamps.2.yaw_deg": 1.0,
        }.items():
            assert found[name] == pytest.approx(np.hypot(known[name], size * std))


def test_images_before_change_how_often_light_is_uneven_and_not_how_far():
    kinds = frame_kinds(
        ForwardModel(with_prior(coarse("reference"), uneven_probability=0.3)), *PRIOR
    )
    shares = [kind.share for kind in expecting(kinds, 0.6)]
    assert shares == pytest.approx([0.4, 0.4, 0.168, 0.024, 0.008])
    assert expecting(kinds, None) is kinds
    # However sure they are, an image may still be of the other kind.
    assert expecting(kinds, 1.0)[0].share > 0


def test_noise_relative_to_the_reading_is_in_every_kind():
    noisy = changed(
        "reference",
        effects={"sensor_noise": {"relative": 0.03}},
        prior={"gain_std": 0.01, "uneven_probability": 0.1},
    )
    plain = changed("reference", prior={"gain_std": 0.01, "uneven_probability": 0.1})
    pairs = zip(*(frame_kinds(ForwardModel(s), *PRIOR) for s in (noisy, plain)), strict=True)
    for kind, without in pairs:
        more = kind.problem.noise.square - without.problem.noise.square
        assert more == pytest.approx(0.03**2)
