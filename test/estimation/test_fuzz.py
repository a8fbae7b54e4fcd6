"""Thirty thousand images of every kind: no accident, no warning, and no pose that is not one."""

import numpy as np
import pytest
from scenes import coarse

from uuv_optical_array.estimation.estimator import Estimator, NoPose
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel

pytestmark = [pytest.mark.filterwarnings("error"), pytest.mark.usefixtures("strict_arithmetic")]

SIDE, FULL = 5, 1023.0


@pytest.fixture(scope="module", params=["curved", "planar"])
def table(request):
    return build_table(coarse("reference").with_shape(request.param))


@pytest.fixture(scope="module")
def estimators(table):
    return Estimator(table, "sam"), Estimator(table, "least_squares").wait()


# Kinds of images, each a function of (model, rng, how many).


def uniform(model, rng, count):
    return rng.uniform(0, FULL, (count, SIDE, SIDE))


def whole_counts(model, rng, count):
    return rng.integers(0, int(FULL) + 1, (count, SIDE, SIDE))


def few_levels(model, rng, count):
    return rng.integers(0, 3, (count, SIDE, SIDE)).astype(np.int16) * rng.choice([1, 511])


def sparse(model, rng, count):
    return uniform(model, rng, count) * (rng.random((count, SIDE, SIDE)) < 0.1)


def constant(model, rng, count):
    return np.ones((count, SIDE, SIDE)) * rng.choice([0.0, -0.0, 0.4, 1, 500, FULL], (count, 1, 1))


def saturated(model, rng, count):
    return np.minimum(exposed(model, rng, count) * rng.uniform(1, 1000, (count, 1, 1)), FULL)


def gradients(model, rng, count):
    across = np.linspace(-1, 1, SIDE)
    slopes = rng.normal(size=(2, count, 1, 1)) * 10 ** rng.uniform(-3, 3, (2, count, 1, 1))
    planes = slopes[0] * across + slopes[1] * across[:, None]
    return planes - planes.min(axis=(1, 2), keepdims=True)


def of_any_size(model, rng, count):
    sizes = 10.0 ** rng.uniform(-300, 300, (count, 1, 1))
    return rng.uniform(0.5, 1.5, (count, SIDE, SIDE)) * sizes


def of_every_size_at_once(model, rng, count):
    return 10.0 ** rng.uniform(-300, 300, (count, SIDE, SIDE))


def of_few_counts(model, rng, count):
    return rng.poisson(rng.uniform(0, 2, (count, 1, 1)), (count, SIDE, SIDE))


def below_zero(model, rng, count):
    return rng.normal(0, 10 ** rng.uniform(-2, 3, (count, 1, 1)), (count, SIDE, SIDE))


def exposed(model, rng, count):
    poses = rng.normal([-6, 0, 0, 0, 0], [1.5, 0.6, 0.6, 0.3, 0.3], (count, 5))
    return model.expose(poses, rng)


def dead(model, rng, count):
    return exposed(model, rng, count) * (rng.random((count, SIDE, SIDE)) > 0.1)


def stuck(model, rng, count):
    images = exposed(model, rng, count)
    return np.where(
        rng.random(images.shape) < 0.1, rng.choice([-0.0, 1, FULL], (count, 1, 1)), images
    )


def swapped(model, rng, count):
    return rng.permuted(exposed(model, rng, count).reshape(count, -1), axis=1).reshape(
        -1, SIDE, SIDE
    )


def turned_over(model, rng, count):
    return FULL - exposed(model, rng, count)


def from_anywhere(model, rng, count):
    poses = np.concatenate(
        [rng.normal(0, 10, (count, 3)), rng.uniform(-np.pi, np.pi, (count, 2))], axis=1
    )
    return model.expose(poses, rng, rng.uniform(-np.pi, np.pi, count))


KINDS = [
    *(uniform, whole_counts, few_levels, sparse, constant, saturated, gradients, of_any_size),
    *(of_every_size_at_once, of_few_counts, below_zero, exposed, dead, stuck, swapped),
    *(turned_over, from_anywhere),
]


def is_whole(estimator, image, parameters, roll):
    """Say whether there is a pose; it is finite, and its covariance positive definite."""
    try:
        result = estimator.estimate(image, parameters, roll)
    except NoPose:
        return False
    assert np.isfinite([*result.pose, *result.covariance.flat]).all()
    np.linalg.cholesky(result.covariance)
    return True


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_thirty_thousand_images_leave_features_match_and_fit_whole(table, estimators, kind):
    count = 30_000 // (2 * len(KINDS)) + 1  # on either array
    scene, rng = table.scene, np.random.default_rng(KINDS.index(kind))
    with np.errstate(under="ignore"):
        images = kind(ForwardModel(scene), rng, count)
    parameters = key_parameters(images, scene.full_scale_counts, scene.signature.peak)
    assert parameters.shape == (count, 5)
    assert np.isfinite(parameters).all()
    assert (np.abs(parameters[:, 1:3]) <= (SIDE - 1) / 2).all()
    # No more than the skewness of one among n (n - 2) / sqrt(n - 1).
    assert (np.abs(parameters[:, 3:]) <= (SIDE - 2) / np.sqrt(SIDE - 1) + 1e-9).all()
    matcher, fitter = estimators
    # An image that comes again has the answer that it had.
    _, unlike = np.unique(images, axis=0, return_index=True)
    frames = [(images[i] if i % 10 == 0 else None, parameters[i], 0.0) for i in sorted(unlike)]
    matched = sum(is_whole(matcher, *frame) for frame in frames)
    if kind is exposed:
        assert matched > 0.5 * count
    rolls = np.random.default_rng(3).choice([0.0, 0.0, 0.35, -3.0], 30)
    for frame in zip(images, parameters, rolls, strict=False):
        is_whole(fitter, *frame)
