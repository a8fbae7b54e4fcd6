"""Light that differs from the scene's by more than it names: wide covariances, or no pose."""

import numpy as np
import pytest

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses

COUNT = 30
# Of a shade of a fifth, and daylight of two percent of 1023 counts; what is no mode is white.
SHADE = {"lamp.power": 0.2, "shade.mode_1": 0.05, "shade.mode_2": 0.05}
SHADE |= {f"shade.mode_{k}": 0.0125 for k in (3, 4, 5)}
DAYLIGHT, WHITE = (
    dict.fromkeys(("ambient.to_starboard_counts", "ambient.to_bottom_counts"), 20.46),
    0.0125,
)


@pytest.fixture(scope="module")
def estimator(compiled_fit):
    return Estimator(load_scene("follow")).wait()


def answers(estimator, poses, images, uneven=None):
    """Return the largest error of each answered image in its own standard deviations."""
    found = []
    for pose, image in zip(poses, images, strict=True):
        try:
            estimate = estimator.estimate(image, uneven=uneven)
        except NoPose:
            continue
        found.append(np.max(np.abs(estimate.pose - pose) / np.sqrt(estimate.covariance.diagonal())))
    return np.array(found)


def test_images_drawn_with_the_sizes_are_as_far_off_as_they_say(estimator):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(4)
    poses = lit_poses(model, 2 * COUNT, rng)
    size = rng.choice([0.25, 1.0, 2.0, 3.0], 2 * COUNT, p=[2 / 3, 0.28, 0.04, 1 / 75])
    stds = {**SHADE, **DAYLIGHT}
    offsets = {name: size * std * rng.standard_normal(2 * COUNT) for name, std in stds.items()}
    gains = 1 + size[:, None, None] * WHITE * rng.standard_normal((2 * COUNT, 5, 5))
    light = model.with_gains(model.light(poses, 0.0, offsets), gains)
    off = answers(estimator, poses, model.read(np.maximum(light, 0.0), rng), uneven=1.0)
    assert len(off) >= 2 * COUNT - 4
    assert (off < 6).all()


def test_rows_that_read_too_little_are_no_reason_to_be_sure(estimator):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(2)
    poses = lit_poses(model, COUNT, rng)
    light = model.light(poses)
    light[:, :2] *= 0.9
    off = answers(estimator, poses, model.read(light, rng))
    assert len(off) >= COUNT - 2
    assert (off < 6).all()


def test_light_of_no_lamp_is_not_taken_for_very_uneven_light(estimator):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(3)
    row, column = np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5), indexing="ij")
    at, width = rng.uniform(-1, 1, (COUNT, 2)), rng.uniform(0.3, 1, (COUNT, 2))
    blobs = [
        300 * np.exp(-(((row - a[0]) / w[0]) ** 2 + ((column - a[1]) / w[1]) ** 2) / 2)
        for a, w in zip(at, width, strict=True)
    ]
    off = answers(estimator, np.zeros((COUNT, 5)), model.read(np.array(blobs), rng))
    assert len(off) <= 2


def test_only_a_size_beyond_one_has_to_fit_better_than_most(estimator):
    fit, model = estimator._fit, ForwardModel(estimator.scene)
    image = model.expose(np.array([-5.0, 0.2, -0.1, 0.05, 0.1]), np.random.default_rng(1))
    for kind, fits in zip(fit._kinds[1:], (True, True, False, False), strict=True):
        problem = kind.problem._replace(readings=image.ravel())
        found = fit._hypothesis(kind, problem, fit.guide)
        # One image of six of that size fits worse.
        assert fit._fits(found._replace(frame=found.frame._replace(score=1.0))) == fits
