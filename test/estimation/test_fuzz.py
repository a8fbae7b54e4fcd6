"""Images of every kind, thirty thousand in all: no exception, no warning, no invalid pose."""

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


COUNT = 30_000 // (2 * 17) + 1  # of each kind, on either array
MATCHED = 300
ALL, EACH = (COUNT, SIDE, SIDE), (COUNT, 1, 1)


def exposed(model, rng):
    poses = rng.normal([-6, 0, 0, 0, 0], [1.5, 0.6, 0.6, 0.3, 0.3], (COUNT, 5))
    return model.expose(poses, rng)


def gradients(model, rng):
    across = np.linspace(-1, 1, SIDE)
    slopes = rng.normal(size=(2, *EACH)) * 10 ** rng.uniform(-3, 3, (2, *EACH))
    planes = slopes[0] * across + slopes[1] * across[:, None]
    return planes - planes.min(axis=(1, 2), keepdims=True)


def stuck(model, rng):
    images = exposed(model, rng)
    return np.where(rng.random(ALL) < 0.1, rng.choice([-0.0, 1, FULL], EACH), images)


def swapped(model, rng):
    return rng.permuted(exposed(model, rng).reshape(COUNT, -1), axis=1).reshape(ALL)


def from_anywhere(model, rng):
    places, angles = rng.normal(0, 10, (COUNT, 3)), rng.uniform(-np.pi, np.pi, (COUNT, 2))
    return model.expose(np.hstack([places, angles]), rng, rng.uniform(-np.pi, np.pi, COUNT))


KINDS = {
    "uniform": lambda model, rng: rng.uniform(0, FULL, ALL),
    "whole counts": lambda model, rng: rng.integers(0, int(FULL) + 1, ALL),
    "few levels": lambda model, rng: (
        rng.integers(0, 3, ALL).astype(np.int16) * rng.choice([1, 511])
    ),
    "sparse": lambda model, rng: rng.uniform(0, FULL, ALL) * (rng.random(ALL) < 0.1),
    "constant": lambda model, rng: np.ones(ALL) * rng.choice([0.0, -0.0, 0.4, 1, 500, FULL], EACH),
    "saturated": lambda model, rng: np.clip(
        exposed(model, rng) * rng.uniform(1, 1e3, EACH), 0, FULL
    ),
    "gradients": gradients,
    "of any size": lambda model, rng: (
        10.0 ** rng.uniform(-300, 300, EACH) * rng.uniform(0.5, 1.5, ALL)
    ),
    "of every size at once": lambda model, rng: 10.0 ** rng.uniform(-300, 300, ALL),
    "of few counts": lambda model, rng: rng.poisson(rng.uniform(0, 2, EACH), ALL),
    "below zero": lambda model, rng: rng.normal(0, 10 ** rng.uniform(-2, 3, EACH), ALL),
    "exposed": exposed,
    "dead": lambda model, rng: exposed(model, rng) * (rng.random(ALL) > 0.1),
    "stuck": stuck,
    "swapped": swapped,
    "turned over": lambda model, rng: FULL - exposed(model, rng),
    "from anywhere": from_anywhere,
}


def is_whole(estimator, image, parameters, roll):
    """Say whether there is a pose; it is finite, and its covariance positive definite."""
    try:
        result = estimator.estimate(image, parameters, roll)
    except NoPose:
        return False
    assert np.isfinite([*result.pose, *result.covariance.flat]).all()
    np.linalg.cholesky(result.covariance)
    return True


@pytest.mark.parametrize("kind", KINDS)
def test_thirty_thousand_images_leave_features_match_and_fit_whole(table, estimators, kind):
    scene, rng = table.scene, np.random.default_rng(list(KINDS).index(kind))
    with np.errstate(under="ignore"):
        images = KINDS[kind](ForwardModel(scene), rng)
    parameters = key_parameters(images, scene.full_scale_counts, scene.signature.peak)
    assert parameters.shape == (COUNT, 5)
    assert np.isfinite(parameters).all()
    assert (np.abs(parameters[:, 1:3]) <= (SIDE - 1) / 2).all()
    # No more than the skewness of one among n (n - 2) / sqrt(n - 1).
    assert (np.abs(parameters[:, 3:]) <= (SIDE - 2) / np.sqrt(SIDE - 1) + 1e-9).all()
    matcher, fitter = estimators
    # An image that comes again has the answer that it had.
    _, unlike = np.unique(images, axis=0, return_index=True)
    unlike = sorted(unlike)[:MATCHED]
    frames = [(images[i] if i % 10 == 0 else None, parameters[i], 0.0) for i in unlike]
    matched = sum(is_whole(matcher, *frame) for frame in frames)
    assert matched > 0.5 * MATCHED or kind != "exposed"
    rolls = np.random.default_rng(3).choice([0.0, 0.0, 0.35, -3.0], 30)
    for frame in zip(images, parameters, rolls, strict=False):
        is_whole(fitter, *frame)
