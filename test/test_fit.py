"""The fit against SciPy's optimisers, on the same problem written a second time."""

import numpy as np
import pytest
import second_forward
from scipy.optimize import least_squares, minimize
from scipy.stats import chi2, norm

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.features import key_parameters
from uuv_optical_array.estimation.least_squares.coordinates import from_pose
from uuv_optical_array.estimation.least_squares.problem import (
    MOST_STEPS,
    PosePrior,
    evaluate,
    problem_of,
    refine,
)
from uuv_optical_array.estimation.table.signature_table import build_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

pytestmark = [
    pytest.mark.filterwarnings("error"),
    pytest.mark.usefixtures("strict_arithmetic"),
]

MIDDLE = np.array([-6.0, 0, 0, 0, 0])
WIDE = np.full(5, 1e4)
STDS = {"lamp.power": 0.1, "attenuation.k_per_m": 0.01, "ambient.level_counts": 3.0}
ROLL = np.radians(20)


def scene(counts=900.0, ambient=None, prior=None, number=5):
    values = load_scene("reference").settings()
    values["lamp"]["reference_counts"] = counts
    values["array"]["detectors_per_side"] = number
    if ambient is not None:
        values["effects"]["ambient"] = {"level_counts": ambient}
    values["prior"] = prior or {}
    return scene_from_settings(values, "fit")


def light_of(scene, pose, roll=0.0, power=0.0, k=0.0, ambient=0.0):
    """The second forward model's light; the last three are offsets of the scene's."""
    offsets = {"lamp.power": power, "attenuation.k_per_m": k}
    if "ambient" in scene.effects:
        offsets["ambient.level_counts"] = ambient
    return second_forward.light(scene.settings(), pose, roll, offsets).ravel()


def cost_of(scene, readings, pose, roll=0.0, nuisances=(), stds=()):
    """Negative log-posterior under a flat prior of the pose: noise of one count and rounding."""
    offsets = dict(zip(("power", "k", "ambient"), nuisances, strict=False))
    light, std = light_of(scene, pose, roll, **offsets), np.sqrt(1 + 1 / 12)
    logs = np.where(
        readings >= 1023,
        norm.logsf(1022.5, light, std),
        np.where(
            readings <= 0,
            norm.logcdf(0.5, light, std),
            -0.5 * (readings - light) ** 2 / std**2,
        ),
    )
    squares = sum((value / each) ** 2 for value, each in zip(nuisances, stds, strict=True))
    return 0.5 * squares - logs.sum()


def drawn(scene, count, seed, roll=0.0):
    """Draw poses of at least 20 counts, and expose them."""
    rng = np.random.default_rng(seed)
    model = ForwardModel(scene)
    half = np.array([2, 0.6, 0.6, *np.radians([20, 20])])
    poses = rng.uniform(MIDDLE - half, MIDDLE + half, (4 * count, 5))
    poses = poses[model.light(poses, roll).max(axis=(1, 2)) > 20][:count]
    return poses, model.expose(poses, rng, roll).reshape(count, -1)


class Fitter:
    """Fits of a scene's images, as NumPy runs them."""

    def __init__(self, scene, stds=None, pose_std=WIDE):
        self.problem = problem_of(
            ForwardModel(scene), PosePrior(MIDDLE, pose_std, stds or {}), False
        )

    def place(self, pose, roll=0.0):
        """Coordinates of a pose, and offsets of 0."""
        offsets = np.zeros(len(self.problem.mean) - 5)
        return np.concatenate([from_pose(self.problem.frame, pose, roll), offsets])

    def of(self, readings, roll):
        return self.problem._replace(readings=np.ravel(readings).astype(float), roll=roll)

    def refine(self, readings, starts, roll=0.0):
        """Refine each start; best first."""
        problem = self.of(readings, roll)
        with np.errstate(all="ignore"):
            fits = [refine(problem, self.place(start, roll), MOST_STEPS) for start in starts]
        return sorted((fit for fit in fits if np.isfinite(fit.cost)), key=lambda fit: fit.cost)

    def cost(self, readings, place, roll):
        return evaluate(self.of(readings, roll), place).cost


def fit_of(scene, stds=None):
    return Fitter(scene, stds)


def own_minimum(scene, readings, start, roll, stds):
    """Minimise the second writing with SciPy, in units in which the pose is of order one."""
    units = np.array([0.1, 0.1, 0.1, 0.03, 0.03, *stds])

    def cost(scaled):
        values = scaled * units
        return cost_of(scene, readings, values[:5], roll, values[5:], stds)

    with np.errstate(under="ignore"):
        start = np.concatenate([start, np.zeros(len(stds))]) / units
        found = minimize(cost, start, method="BFGS", options={"gtol": 1e-6})
        polished = minimize(
            cost, found.x, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9}
        )
    return polished.x * units, polished.fun


@pytest.mark.parametrize("counts", [900.0, 3000.0], ids=["in range", "saturated"])
@pytest.mark.parametrize("roll", [0.0, ROLL], ids=["level", "rolled"])
@pytest.mark.parametrize("stds", [{}, STDS], ids=["known scene", "nuisances"])
def test_the_fit_ends_where_scipys_optimiser_does_and_at_its_cost(counts, roll, stds):
    sea = scene(counts, 5.0 if stds else None)
    fit = fit_of(sea, stds)
    for pose, readings in zip(*drawn(sea, 3, 11, roll), strict=True):
        best = fit.refine(readings, pose[None], roll)[0]
        with np.errstate(under="ignore"):
            ours = cost_of(sea, readings, best.pose, roll, best.at[5:], stds.values())
            whole, cost = own_minimum(sea, readings, best.pose, roll, tuple(stds.values()))
        # A cost of 1e-3 above the minimum is a twentieth of a standard deviation.
        assert -1e-6 <= ours - cost < 2e-3
        off = fit.place(whole[:5], roll)[:5] - best.at[:5]
        off = np.concatenate([off, whole[5:] - best.at[5:]])
        assert off @ best.information @ off < 0.02
        truth = fit.place(pose, roll)
        with np.errstate(under="ignore"):
            theirs = cost_of(sea, readings, pose, roll, np.zeros(len(stds)), stds.values())
        at_truth = fit.cost(readings, truth, roll)
        assert at_truth - best.cost == pytest.approx(theirs - ours, abs=2e-3)


def test_the_information_is_that_of_scipys_least_squares():
    sea = scene()
    fit, std = fit_of(sea), np.sqrt(1 + 1 / 12)
    for pose, readings in zip(*drawn(sea, 5, 12), strict=True):
        if not ((readings > 0) & (readings < 1023)).all():
            continue
        best = fit.refine(readings, pose[None])[0]
        own = least_squares(
            lambda at, readings=readings: (light_of(sea, at) - readings) / std,
            best.pose,
            x_scale=[0.1, 0.1, 0.1, 0.03, 0.03],
            xtol=1e-12,
        )
        steps = 1e-6 * np.eye(5)
        by_pose = [fit.place(own.x + step) for step in steps]
        by_pose = (np.array(by_pose) - fit.place(own.x)).T / 1e-6
        ours = by_pose.T @ best.information @ by_pose
        scale = 1 / np.sqrt(ours.diagonal())
        np.testing.assert_allclose(
            ours * np.outer(scale, scale),
            own.jac.T @ own.jac * np.outer(scale, scale),
            atol=0.02,
        )


@pytest.fixture(scope="module")
def estimator():
    values = scene().settings()
    values["table"] = {key: [*span[:2], 7] for key, span in values["table"].items()}
    return Estimator(build_table(scene_from_settings(values, "seven")), "least_squares")


def same_minimum(fits):
    best = fits[0]
    return [(fit.at - best.at) @ best.information @ (fit.at - best.at) < 0.1 for fit in fits]


def test_every_candidate_of_the_match_leads_to_one_minimum(estimator):
    sea = estimator.table.scene
    _, frames = drawn(sea, 100, 13)
    alone = Estimator(estimator.table, "sam", max_angle_rad=np.pi)
    fit, agreed = fit_of(sea), []
    for readings in frames:
        image = readings.reshape(5, 5)
        answer = alone.estimate(key_parameters(image, sea.full_scale_counts, sea.signature.peak))
        fits = fit.refine(readings, np.array([answer.pose, answer.runner_up_pose]))
        agreed += same_minimum(fits) if len(fits) == 2 else [False, False]
    assert np.mean(agreed) > 0.97


@pytest.mark.parametrize("roll", [0.0, ROLL], ids=["level", "rolled"])
def test_starts_a_metre_and_fifteen_degrees_off_arrive(roll):
    sea = scene()
    fit, rng = fit_of(sea), np.random.default_rng(14)
    reach = np.array([1, 0.3, 0.3, *np.radians([15, 15])])
    arrived = []
    for pose, readings in zip(*drawn(sea, 60, 15, roll), strict=True):
        [best] = fit.refine(readings, pose[None], roll)
        starts = pose + reach * rng.choice([-1, 1], (4, 5))
        fits = fit.refine(readings, starts, roll)
        off = np.array([fit.at - best.at for fit in fits])
        arrived += list(((off @ best.information) * off).sum(axis=1) < 0.1)
    assert len(arrived) == 4 * 60
    assert np.mean(arrived) > 0.95


@pytest.mark.parametrize("name", STDS)
def test_an_offset_of_the_scene_is_found_and_its_error_is_as_said(name):
    """Offsets drawn from the prior; the errors of pose and offset agree with the information."""
    sea = scene(ambient=5.0)
    stds = {name: STDS[name]}
    fit, model, rng = fit_of(sea, stds), ForwardModel(sea), np.random.default_rng(16)
    poses, _ = drawn(sea, 60, 17)
    squares, found, given = [], [], []
    for pose in poses:
        offset = rng.normal(0, STDS[name])
        light = model.light(pose, 0.0, {name: np.array(offset)}).ravel()
        readings = np.clip(np.rint(light + rng.standard_normal(light.shape)), 0, 1023)
        best = fit.refine(readings, pose[None])[0]
        off = best.at - [*fit.place(pose)[:5], offset]
        squares.append(off @ best.information @ off)
        found.append(best.at[5])
        given.append(offset)
        # What is known can only become better known.
        assert np.linalg.inv(best.information)[5, 5] <= STDS[name] ** 2 * (1 + 1e-9)
    assert chi2.ppf(1e-4, 6 * 60) < np.sum(squares) < chi2.isf(1e-4, 6 * 60)
    if name != "attenuation.k_per_m":
        assert np.corrcoef(found, given)[0, 1] > 0.3


@pytest.mark.parametrize("name", STDS)
def test_an_offset_under_a_narrow_prior_stays(name):
    sea = scene(ambient=5.0)
    narrow = STDS[name] * 1e-4
    free, bound = fit_of(sea), fit_of(sea, {name: narrow})
    for pose, readings in zip(*drawn(sea, 5, 18), strict=True):
        [known], [held] = free.refine(readings, pose[None]), bound.refine(readings, pose[None])
        assert abs(held.at[5]) < 3 * narrow
        off = held.at[:5] - known.at
        assert off @ known.information @ off < 1e-2


def test_the_prior_of_the_pose_holds_what_no_light_says():
    """In the dark all readings are zero, and the best pose is one that is dark enough."""
    sea = scene()
    half = 5 * np.array([2, 0.6, 0.6, *np.radians([20, 20])])
    fit = Fitter(sea, pose_std=half)
    fits = fit.refine(np.zeros(25), MIDDLE + np.array([[0, 0.1, 0, 0.1, 0], [1, 0, 0.1, 0, 0.1]]))
    assert fits
    for each in fits:
        assert light_of(sea, each.pose).max() < 5
        np.linalg.cholesky(each.information)


@pytest.mark.parametrize(
    "readings",
    [np.zeros(25), np.full(25, 1023.0), np.r_[np.zeros(12), np.full(13, 1023.0)], np.eye(5) * 1023],
    ids=["dark", "full", "half", "diagonal"],
)
def test_any_readings_leave_fits_in_the_order_of_their_cost(readings):
    fit = Fitter(scene(), pose_std=np.array([10, 3, 3, 2, 2.0]))
    starts = MIDDLE + np.random.default_rng(19).normal(0, 0.3, (4, 5))
    fits = fit.refine(np.ravel(readings), starts)
    costs = [each.cost for each in fits]
    assert costs == sorted(costs)
    assert np.isfinite([each.pose for each in fits]).all()
    assert np.isfinite(costs).all()
