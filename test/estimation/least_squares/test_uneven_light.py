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


SIZES = {0.25: 2 / 3, 1.0: 0.28, 2.0: 0.04, 3.0: 1 / 75}  # by their shares


def uneven(estimator, count, sizes, seed):
    """Return poses, and images whose light is off by so many times what the prior has."""
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(seed)
    poses = lit_poses(model, count, rng)
    size = rng.choice(list(sizes), count, p=list(sizes.values()))
    stds = {**SHADE, **DAYLIGHT}
    offsets = {name: size * std * rng.standard_normal(count) for name, std in stds.items()}
    gains = 1 + size[:, None, None] * WHITE * rng.standard_normal((count, 5, 5))
    light = model.with_gains(model.light(poses, 0.0, offsets), gains)
    return poses, model.read(np.maximum(light, 0.0), rng)


def test_images_drawn_with_the_sizes_are_as_far_off_as_they_say(estimator):
    poses, images = uneven(estimator, 2 * COUNT, SIZES, seed=4)
    off = answers(estimator, poses, images, uneven=1.0)
    assert len(off) >= 2 * COUNT - 4
    # A clear image from elsewhere may look the same: so one in eighty is farther off, of other
    # seeds, and this many by five standard deviations more.
    assert np.count_nonzero(off >= 6) <= 5


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


def test_light_of_the_largest_size_has_to_fit_better_than_most(estimator):
    """Of images drawn with that size half fit worse than the median; few would as if clear."""
    poses, images = uneven(estimator, 4 * COUNT, {3.0: 1.0}, seed=7)
    assert len(answers(estimator, poses, images)) < 0.6 * 4 * COUNT
