"""The working volume: poses drawn from it, its spread, and what it adds to a bound."""

import numpy as np
import pytest
from scenes import changed

from uuv_optical_array.estimation.signature_table import grid_axes
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import (
    GUESSED,
    HIGH,
    LOW,
    lit_poses,
    volume_table,
)
from uuv_optical_array.studies.shared.errors import position_and_angle


def test_poses_fill_the_volume_where_there_is_light(scene):
    model = ForwardModel(scene)
    poses = lit_poses(model, 2000, np.random.default_rng(5))
    assert poses.shape == (2000, 5)
    assert (poses >= LOW).all()
    assert (poses <= HIGH).all()
    assert model.expected(poses).max(axis=(1, 2)).min() > 20
    np.testing.assert_allclose(LOW, [-8, -0.9, -0.9, *np.radians([-20, -20])])
    spread = poses[:, [0, 3, 4]].std(axis=0) * np.sqrt(12)
    np.testing.assert_allclose(spread, (HIGH - LOW)[[0, 3, 4]], rtol=0.08)


def test_a_scene_too_dark_for_the_study_is_refused(scene):
    dark = ForwardModel(changed(scene, lamp={"reference_counts": 5.0}))
    with pytest.raises(ValueError, match=r"scene changed: none of .* peaks above 20 counts"):
        lit_poses(dark, 5, np.random.default_rng())


def test_a_guess_errs_by_the_spread_of_the_volume():
    poses = np.random.default_rng(0).uniform(LOW, HIGH, (200_000, 5))
    middle = (np.array(LOW) + HIGH) / 2
    assert position_and_angle(poses - middle) == pytest.approx(GUESSED, rel=0.01)


def test_tables_span_the_volume_of_the_study():
    axes = grid_axes(volume_table(6))
    np.testing.assert_allclose([axis[0] for axis in axes], LOW, atol=1e-12)
    np.testing.assert_allclose([axis[-1] for axis in axes], HIGH, atol=1e-12)
    assert [len(axis) for axis in axes] == [6] * 5
