"""The likelihood of a calibration and its solver: gradient, poses, what is held."""

import numpy as np
import pytest
from calibrated_seas import drive, lights, recorded, sea
from scenes import changed

from uuv_optical_array.calibration.fit.fit import CalibrationProblem, refine
from uuv_optical_array.calibration.fit.identifiability import undetermined
from uuv_optical_array.calibration.likelihood.likelihood import CalibrationLikelihood, Unknowns
from uuv_optical_array.calibration.likelihood.parameters import POWER, SHARE, K, Layout
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

FIRST_GAIN = SHARE  # of one lamp
FLAT = {"beam_widths": [0.6, 1.0, 1.7], "beam_weights": [-0.2, 0.9, 0.3]}

STARTS = {
    "flat": changed("follow", lamp=FLAT),
    "behind": changed("reference", prior={"lamp_behind_std_m": 0.2}),
    "floors": changed("leading_lights", prior={"lamps_floor_std_counts": 20.0}),
}


@pytest.mark.parametrize(
    ("start", "pose_std", "images_a_place"),
    [
        ("flat", [0.02, 0.01, 0.01, 0.01, 0.02], 3),
        ("follow", None, 1),
        ("behind", [0.02, 0.01, 0.01, 0.01, 0.02], 1),
        ("floors", None, 1),
        ("reference", None, 1),
        ("reference", [0.02, 0.01, 0.01, 0.01, 0.02], 3),
        ("leading_lights", [0.02, 0.01, 0.01, 0.01, 0.02], 3),
    ],
)
def test_the_gradient_is_that_of_the_value(start, pose_std, images_a_place):
    rng = np.random.default_rng(3)
    started = STARTS.get(start) or load_scene(start)
    base = {"flat": "follow", "behind": "reference", "floors": "leading_lights"}.get(start, start)
    scene = sea(base, shot_noise__electrons_per_count=30.0)
    scene = lights(rng) if scene.lamps else scene
    poses, rolls = drive(rng, 24)
    places = np.arange(24) % (24 // images_a_place)
    poses, rolls = poses[places], rolls[places]
    images = ForwardModel(scene).expose(poses, rng, rolls)
    std = None if pose_std is None else np.array(pose_std)
    likelihood = CalibrationLikelihood(started, images, poses, rolls, std, places)
    middle = likelihood.unshifted(likelihood.start())
    shifts = rng.normal(size=middle.shifts.shape) * (0 if std is None else likelihood.pose_std)
    here = middle.parameters + 0.05 * rng.standard_normal(len(middle.parameters))
    if std is not None:
        # Of the shifts that follow the parameters, so that they leave nothing to gain.
        for _ in range(100):
            step = likelihood.evaluate(Unknowns(here, shifts)).shift_step
            shifts = shifts + step
            if np.abs(step).max() < 1e-9:
                break
        assert np.abs(step).max() < 1e-5
        aside = 1e-5 * rng.normal(size=shifts.shape) * likelihood.pose_std
        ahead, behind = (likelihood.evaluate(Unknowns(here, shifts + x)) for x in (aside, -aside))
        assert abs(ahead.cost - behind.cost) / 2e-5 < 1e-2
    gradient = likelihood.evaluate(Unknowns(here, shifts)).gradient
    # By each parameter, and by the gains at once along two ways drawn anew.
    gains = likelihood.layout.gains
    along = np.zeros((gains + 2, len(here)))
    along[:gains, :gains] = np.eye(gains)
    along[gains:, gains:] = rng.standard_normal((2, len(here) - gains))
    for step in 1e-5 * along:
        ahead, behind = (likelihood.evaluate(Unknowns(here + x, shifts)) for x in (step, -step))
        slope = (behind.cost - ahead.cost) / 2e-5
        assert slope == pytest.approx(gradient @ step / 1e-5, rel=5e-5, abs=1e-2)


def test_poses_are_fitted_even_where_every_parameter_is_held():
    std = np.array([0.02, 0.01, 0.01, 0.01, 0.02])
    likelihood = CalibrationLikelihood(load_scene("reference"), *recorded(sea(), 30, seed=3), std)
    start = likelihood.unshifted(likelihood.start())
    found = refine(CalibrationProblem(likelihood, frozenset(range(FIRST_GAIN + 25)), int), start)
    np.testing.assert_array_equal(found.at.parameters, start.parameters)
    assert found.cost < likelihood.evaluate(start).cost - 1
    assert np.abs(found.shift_step / likelihood.pose_std).max() < 0.02


@pytest.mark.parametrize(("reach_m", "gains_known"), [(0.24, True), (0.26, False)])
def test_gains_are_held_where_an_unknown_attenuation_would_shift_them_by_half_a_per_cent(
    reach_m, gains_known
):
    """At one pose K, uncertain by 0.02 /m, shifts a gain by 0.02 /m times its excess range."""
    excess = np.linspace(-reach_m, reach_m, 9)
    layout = Layout(sea(gains=None, array__detectors_per_side=3))
    slopes = np.zeros((9, FIRST_GAIN + 9))
    slopes[:, POWER], slopes[:, K], slopes[:, FIRST_GAIN:] = 1.0, -(6.0 + excess), np.eye(9)
    information = 1e6 * slopes.T @ slopes
    others = frozenset(range(FIRST_GAIN)) - {POWER, K}
    unknown, correlated = undetermined(layout, information, others)
    assert unknown == ({K} if gains_known else {K, *range(FIRST_GAIN, FIRST_GAIN + 9)})
    assert correlated[POWER] == K
