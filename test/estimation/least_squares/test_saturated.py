"""Images with every reading at full scale: what they leave of the prior, by brute force."""

import numpy as np
import pytest
from scenes import coarse_settings

from uuv_optical_array.estimation.estimator import Estimator, NoPose
from uuv_optical_array.estimation.least_squares.problem import PosePrior
from uuv_optical_array.estimation.least_squares.saturated import saturated_posterior
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

pytestmark = pytest.mark.filterwarnings("error")
PRIOR = PosePrior(np.array([-6.0, 0.8, 0, 0.5, 0]), np.array([6.0, 1.8, 1.8, 1.0, 1.0]), {})
POWER = {"lamp.power": 0.3, "attenuation.k_per_m": 0.02}


def model_of(shape="planar", reference_counts=1e5):
    values = coarse_settings(load_scene("reference"), 3)
    values["array"] = {"shape": shape, "detectors_per_side": 3}
    if shape == "curved":
        values["array"]["radius_m"] = 0.32
    values["lamp"]["reference_counts"] = reference_counts
    return ForwardModel(scene_from_settings(values, "bright"))


def survivors(model, prior, roll, count=300_000):
    """Poses drawn from the prior whose images, noise and all, are at full scale everywhere."""
    rng = np.random.default_rng(4)
    poses = prior.pose_mean + prior.pose_std * rng.standard_normal((count, 5))
    poses = poses[np.abs(poses[:, 3]) < np.pi / 2]
    offsets = {
        name: std * rng.standard_normal(len(poses)) for name, std in prior.nuisance_std.items()
    }
    images = model.expose(poses, rng, roll, offsets)
    return poses[(images == 1023).all(axis=(1, 2))]


@pytest.mark.parametrize(
    ("shape", "nuisances", "roll", "reference_counts"),
    [
        *(("planar", {}, 0.0, 5e4), ("planar", POWER, 0.4, 1e6), ("curved", {}, 0.4, 5e4)),
        *(("curved", POWER, 0.0, 1e6), ("planar", POWER, 0.0, 5e4), ("curved", {}, 0.0, 1e6)),
    ],
)
def test_mean_and_covariance_are_those_of_the_poses_that_saturate_it(
    shape, nuisances, roll, reference_counts
):
    model = model_of(shape, reference_counts)
    prior = PosePrior(PRIOR.pose_mean, PRIOR.pose_std, nuisances)
    poses = survivors(model, prior, roll)
    assert len(poses) > 400
    found = saturated_posterior(model, prior, roll)
    scale = poses.std(axis=0)
    np.testing.assert_allclose(found.mean / scale, poses.mean(axis=0) / scale, rtol=0, atol=0.2)
    expected = np.cov(poses.T) / np.outer(scale, scale)
    np.testing.assert_allclose(found.covariance / np.outer(scale, scale), expected, atol=0.25)
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
    assert found.score < 0  # all is explained


def test_a_lamp_too_dim_to_saturate_any_reading_is_no_pose():
    table = build_table(model_of(reference_counts=30.0).scene)
    with pytest.raises(NoPose, match="an image of this scene leaves such residuals"):
        Estimator(table).wait().estimate(np.full((3, 3), 1023.0))


def test_an_estimate_of_such_an_image_is_wide_and_the_same_every_time():
    estimator = Estimator(build_table(model_of().scene)).wait()
    one, other = (estimator.estimate(np.full((3, 3), 1023.0)) for _ in range(2))
    np.testing.assert_array_equal(one.pose, other.pose)
    assert one.covariance[0, 0] > 1
    assert one.runner_up_pose is None
