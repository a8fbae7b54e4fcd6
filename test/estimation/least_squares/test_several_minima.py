"""A posterior of several minima has one volume, however many of them are found."""

import numpy as np
import pytest
from scenes import changed, coarse

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import lit_poses


@pytest.fixture(scope="module")
def table():
    """Return that of a weakly curved array in a narrow beam: its posteriors are bent valleys."""
    scene = changed(
        coarse("reference", 7),
        array={"detectors_per_side": 7, "radius_m": 0.6},
        lamp={"beam_sigma_deg": 5.0, "reference_counts": 3600.0},
        effects={"saturation": {"level_counts": 4095.0}, "adc": {"bits": 12}},
    )
    return build_table(scene)


def test_the_evidence_of_an_image_is_the_same_from_one_start_and_from_many(table):
    model, rng = ForwardModel(table.scene), np.random.default_rng(4)
    images = model.expose(lit_poses(model, 12, rng), rng)
    estimators = [Estimator(table, candidates=count).wait() for count in (1, 32)]
    several = 0
    for readings in images.reshape(len(images), -1):
        one, many = (
            fit._hypothesis(
                fit._kinds[0],
                fit._kinds[0].problem._replace(readings=readings),
                fit.guide,
                np.full((5, 1), np.nan),
            ).frame
            for fit in (each._fit for each in estimators)
        )
        several += np.isnan(one.runner_up_score) and not np.isnan(many.runner_up_score)
        assert many.log_evidence == pytest.approx(one.log_evidence, abs=0.2)
    assert several > 5
