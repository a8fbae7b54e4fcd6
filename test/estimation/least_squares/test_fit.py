"""The fit of an image against SciPy: its cost, derivatives, minimum and information."""

import numpy as np
import pytest
from differences import assert_close, differentiate
from drawn_effects import poses
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st
from scenes import make_scene
from scipy.optimize import minimize
from scipy.special import log_ndtr
from scipy.stats import chi2

from uuv_optical_array.estimation.least_squares.frame_kinds import frame_kinds
from uuv_optical_array.estimation.least_squares.problem import (
    MAX_STEP,
    MOST_STEPS,
    VOLUME,
    evaluate,
    light_at,
    problem_of,
    propose,
    refine,
    start_at,
)
from uuv_optical_array.estimation.least_squares.starts import nearest_rows
from uuv_optical_array.estimation.unknowns.coordinates import from_pose, to_lamp
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

pytestmark = [pytest.mark.filterwarnings("error"), pytest.mark.usefixtures("strict_but_for_zeros")]
# A failing place tells as much as a simpler one, which takes minutes to find.
reproducible = settings(max_examples=15, phases=(Phase.explicit, Phase.generate))

MIDDLE = np.array([-6.0, 0, 0, 0, 0])
WIDE = np.full(5, 1e4)
TABLE = np.array([6.0, 1.8, 1.8, 1.05, 1.05])  # the prior of an estimator
WATER = {"attenuation": {"k_per_m": 0.1}}
ADC = {"saturation": {"level_counts": 1023.0}, "adc": {"bits": 10}}
STDS = {
    "lamp.power": 0.1,
    "attenuation.k_per_m": 0.01,
    "ambient.level_counts": 3.0,
    "responsivity.temperature_c": 4.0,
}
THREE = {name: STDS[name] for name in list(STDS)[:3]}
ROLL = np.radians(20)
EFFECTS = {
    "electronics": {**WATER, "sensor_noise": {"sigma_counts": 1.0}, **ADC},
    # Without limits: at one the fit takes the noise as it is at the place.
    "shot noise": {
        **WATER,
        "sensor_noise": {"sigma_counts": 1.0},
        "shot_noise": {"electrons_per_count": 5.0},
    },
    "daylight": {
        **WATER,
        "field_of_view": {"cosine_power": 1.5},
        "ambient": {"level_counts": 5.0},
        "forward_scatter": {"window_m": 0.25},
        "responsivity": {"spread": 0.05, "seed": 2},
        "sensor_noise": {"sigma_counts": 1.0},
        **ADC,
    },
}


def model_of(effects="electronics", counts=900.0, shape="curved"):
    return ForwardModel(make_scene(shape, effects=EFFECTS[effects], reference_counts=counts))


class Fit:
    """The problem of a model's images, in coordinates and, by the laws of chance, in the pose."""

    def __init__(self, model, stds=None, pose_std=WIDE):
        self.model, self.stds = model, stds or {}
        self.pose_std = pose_std
        self.problem = problem_of(model, MIDDLE, pose_std, self.stds)

    def of(self, readings, roll=0.0):
        return self.problem._replace(readings=np.ravel(readings).astype(float), roll=roll)

    def at(self, pose, roll=0.0, offsets=None):
        offsets = np.zeros(len(self.stds)) if offsets is None else offsets
        return np.concatenate([from_pose(self.problem.frame, np.array(pose), roll), offsets])

    def pose(self, at, roll=0.0):
        return np.array(to_lamp(self.problem.frame, at, roll)[1])

    def light(self, pose, roll, offsets):
        offsets = dict(zip(self.stds, np.reshape(offsets, (len(self.stds), 1)), strict=True))
        return self.model.light(np.array(pose)[None], roll, offsets).ravel()

    def variance(self, light):
        """Of a reading: one count of noise, and shot noise or rounding."""
        if "shot_noise" in self.model.scene.effects:
            return 1 + light / 5
        return np.full(light.shape, 1 + 1 / 12)

    def log_likelihood(self, readings, light):
        std = np.sqrt(self.variance(light))
        inside = -0.5 * ((readings - light) / std) ** 2 - np.log(std)
        if "adc" not in self.model.scene.effects:
            return inside
        saturated, dark = log_ndtr((light - 1022.5) / std), log_ndtr((0.5 - light) / std)
        return np.where(readings >= 1023, saturated, np.where(readings <= 0, dark, inside))

    def told(self, readings, light):
        """Return the information of each reading: of what a limit cut off, the second derivative.

        S. Kay (1993), eq. 3.31.
        """
        variance = self.variance(light)
        inside = 1 / variance + 0.5 * ((self.variance(light + 1) - variance) / variance) ** 2
        step = 1e-2 * np.sqrt(variance)  # of smaller ones rounding is seen
        below, here, above = (self.log_likelihood(readings, light + k * step) for k in (-1, 0, 1))
        cut = (readings >= 1023) | (readings <= 0)
        limited = cut & ("adc" in self.model.scene.effects)
        return np.where(limited, (2 * here - above - below) / step**2, inside)

    def cost(self, readings, pose, roll=0.0, offsets=()):
        """Negative log-posterior, a second time and without coordinates."""
        light = self.light(pose, roll, offsets)
        prior = (((pose - MIDDLE) / self.pose_std) ** 2).sum()
        prior += sum((x / std) ** 2 for x, std in zip(offsets, self.stds.values(), strict=True))
        return 0.5 * prior - self.log_likelihood(np.ravel(readings), light).sum()


def cosines(model, pose, roll):
    """Return the cosine of incidence at each detector."""
    return model.rays(np.array(pose)[None], np.array([roll]))[2]


def drawn(model, count, seed, roll=0.0):
    """Draw poses of at least 20 counts, and expose them."""
    rng = np.random.default_rng(seed)
    half = np.array([2, 0.6, 0.6, *np.radians([20, 20])])
    poses = rng.uniform(MIDDLE - half, MIDDLE + half, (4 * count, 5))
    poses = poses[model.light(poses, roll).max(axis=(1, 2)) > 20][:count]
    return poses, model.expose(poses, rng, roll).reshape(count, -1)


each_shape = pytest.mark.parametrize("shape", ["curved", "planar"])
# Places with readings that are not of them: pose, roll, seed, and how bright.
anywhere = given(
    poses.map(np.array), st.floats(-0.5, 0.5), st.integers(0, 99), st.sampled_from([0.1, 1, 30])
)


def any_place(fit, pose, roll, seed, scale):
    """Return a place, and readings that are not those of this place."""
    rng = np.random.default_rng(seed)
    assume(np.abs(cosines(fit.model, pose, roll)).min() > 1e-3)  # where Lambert's cosine has a kink
    assume(cosines(fit.model, pose, roll).max() > 0.05)
    offsets = rng.standard_normal(len(fit.stds)) * list(fit.stds.values())
    readings = fit.light(pose + rng.normal(0, 0.02, 5), roll, 0 * offsets)
    readings = fit.model.read(scale * readings, rng)
    return fit.of(readings, roll), fit.at(pose, roll, offsets)


@pytest.mark.parametrize("effects", EFFECTS)
@each_shape
def test_cost_gradient_and_information_are_those_of_the_posterior_of_the_pose(effects, shape):
    fit = Fit(model_of(effects, 900.0, shape), STDS if effects == "daylight" else {}, TABLE)

    @reproducible
    @anywhere
    def check(pose, roll, seed, scale):
        problem, at = any_place(fit, pose, roll, seed, scale)
        state, light = evaluate(problem, at), fit.light(pose, roll, at[5:])
        np.testing.assert_allclose(state.pose, pose, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(light_at(problem, at), light, rtol=1e-9)

        def pose_at(x):
            return fit.pose(x, roll)

        def cost(x):
            return np.array(fit.cost(problem.readings, pose_at(x), roll, x[5:]))

        # Constants do not matter, so costs are compared with that of another place.
        off, here = evaluate(problem, at + 0.01).cost - state.cost, cost(at)
        assert off == pytest.approx(cost(at + 0.01) - here, rel=1e-6, abs=1e-6 * max(1, abs(here)))
        slopes = differentiate(cost, at, 5e-5)
        np.testing.assert_allclose(
            -state.gradient, slopes, rtol=1e-5, atol=1e-6 * np.abs(slopes).max() + 1e-6
        )
        volumes = differentiate(lambda x: np.array(to_lamp(problem.frame, x, roll)[2]), at)
        assert_close(state.slopes[VOLUME], volumes[:5])
        of_light = differentiate(lambda x: fit.light(pose_at(x), roll, x[5:]), at)
        of_pose = differentiate(pose_at, at)
        expected = of_light.T * fit.told(problem.readings, light) @ of_light
        expected += (of_pose.T / TABLE**2) @ of_pose
        expected += np.diag([*np.zeros(5), *(std**-2 for std in fit.stds.values())])
        scale = np.outer(*2 * [1 / np.sqrt(expected.diagonal())])
        np.testing.assert_allclose(state.information * scale, expected * scale, atol=2e-4)

    check()


def own_minimum(fit, readings, start, roll):
    """Minimise the second writing with SciPy, in units in which all is of order one."""
    units = np.array([0.1, 0.1, 0.1, 0.03, 0.03, *fit.stds.values()])

    def cost(scaled):
        return fit.cost(readings, scaled[:5] * units[:5], roll, scaled[5:] * units[5:])

    start = np.concatenate([start, np.zeros(len(fit.stds))]) / units
    found = minimize(cost, start, method="BFGS", options={"gtol": 1e-6})
    polished = minimize(cost, found.x, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-7})
    return polished.x * units, polished.fun


@pytest.mark.parametrize(
    ("counts", "roll", "stds"),
    [(900.0, 0.0, {}), (900.0, ROLL, THREE), (3000.0, 0.0, THREE), (3000.0, ROLL, {})],
    ids=["level", "rolled, nuisances", "saturated, nuisances", "saturated, rolled"],
)
def test_the_fit_ends_where_scipys_optimiser_does_and_at_its_cost(counts, roll, stds):
    model = model_of("daylight" if stds else "electronics", counts)
    fit = Fit(model, stds)
    for pose, readings in zip(*drawn(model, 2, 11, roll), strict=True):
        problem, truth = fit.of(readings, roll), fit.at(pose, roll)
        best = refine(problem, truth, MOST_STEPS)
        ours = fit.cost(readings, best.pose, roll, best.at[5:])
        whole, cost = own_minimum(fit, readings, best.pose, roll)
        # A cost of 1e-3 above the minimum is a twentieth of a standard deviation.
        assert -1e-6 <= ours - cost < 2e-3
        off = fit.at(whole[:5], roll, whole[5:]) - best.at
        assert off @ best.information @ off < 0.02
        theirs = fit.cost(readings, pose, roll, truth[5:])
        assert evaluate(problem, truth).cost - best.cost == pytest.approx(theirs - ours, abs=2e-3)


@each_shape
@pytest.mark.parametrize("stds", [{}, THREE], ids=["known scene", "nuisances"])
@pytest.mark.parametrize("roll", [0.0, ROLL], ids=["level", "rolled"])
def test_starts_a_metre_and_fifteen_degrees_off_arrive(roll, stds, shape):
    """At the best place, or on a planar array's ring of attitudes that look alike at no cost."""
    model = model_of("daylight" if stds else "electronics", 900.0, shape)
    fit, rng = Fit(model, stds), np.random.default_rng(14)
    far = shape == "curved"
    reach = np.array([1, 0.3, 0.3, 0.26, 0.26] if far else [0.05, 0.01, 0.01, 0.005, 0.005])
    arrived = []
    for pose, readings in zip(*drawn(model, 12, 15, roll), strict=True):
        problem = fit.of(readings if far else model.light(pose, roll), roll)
        best = refine(problem, fit.at(pose, roll), MOST_STEPS)
        for start in pose + reach * rng.choice([-1, 1], (3, 5)):
            found = refine(problem, fit.at(start, roll), MOST_STEPS)
            off = found.at - best.at
            near = off @ best.information @ off < 0.1
            arrived.append(near if far else found.cost < best.cost + 1e-3)
    assert np.mean(arrived) > 0.95


@pytest.mark.parametrize("name", STDS)
def test_an_offset_of_the_scene_is_found_and_its_error_is_as_said(name):
    """Offsets drawn from the prior; the errors of pose and offset agree with the information."""
    model, std = model_of("daylight"), STDS[name]
    fit, rng = Fit(model, {name: std}), np.random.default_rng(16)
    squares, found, drawn_offsets = [], [], std * rng.standard_normal(60)
    for pose, offset in zip(drawn(model, 60, 17)[0], drawn_offsets, strict=True):
        readings = model.read(fit.light(pose, 0.0, [offset]), rng)
        best = refine(fit.of(readings), fit.at(pose), MOST_STEPS)
        off = best.at - fit.at(pose, 0.0, [offset])
        squares.append(off @ best.information @ off)
        found.append(best.at[5])
    assert chi2.ppf(1e-4, 6 * 60) < np.sum(squares) < chi2.isf(1e-4, 6 * 60)
    if name in ("lamp.power", "ambient.level_counts"):
        assert np.corrcoef(found, drawn_offsets)[0, 1] > 0.3


@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_a_step_is_that_of_the_damped_model_and_never_beyond_its_reach(damping):
    model = model_of("daylight")
    fit, stds = Fit(model, THREE), np.array(list(THREE.values()))
    reach, shortened = np.array([*[MAX_STEP] * 5, *2 * stds]), []
    for pose, readings in zip(*drawn(model, 20, 23), strict=True):
        problem = fit.of(readings)
        for share in (0.01, 1.0):
            state = evaluate(problem, fit.at(pose + share * np.array([2, 0.3, 0.3, 0.3, 0.3])))
            pull, damped = state.gradient, state.information.copy()
            damped[np.diag_indices(8)] *= 1 + damping
            step = np.linalg.solve(damped, pull)
            excess = max(1.0, (np.abs(step) / reach).max())
            there, decrement = propose(problem, state, damping)
            np.testing.assert_allclose(there - state.at, step / excess, rtol=1e-6, atol=1e-9)
            assert decrement == pytest.approx(0.5 * step @ pull, rel=1e-6)
            shortened.append(excess > 1)
    assert 0 < np.mean(shortened) < 1


def test_where_there_is_no_step_it_is_said():
    fit = Fit(model_of())
    state = evaluate(fit.of(np.full(25, 100.0)), fit.at(MIDDLE))
    state.information[:] = -np.eye(5)
    there, decrement = propose(fit.problem, state, 0.0)
    assert np.isnan(decrement)
    np.testing.assert_array_equal(there, state.at)


def test_what_only_one_lamp_has_is_told_by_the_readings_of_that_lamp_alone():
    model, rng = ForwardModel(load_scene("leading_lights")), np.random.default_rng(8)
    readings = model.expose(np.array([-5.0, 0.3, -0.2, 0.1, -0.15]), rng).ravel()
    for kind in frame_kinds(model, MIDDLE, WIDE):
        problem = kind.problem._replace(readings=readings)
        at = start_at(problem, np.array([-5.2, 0.2, -0.1, 0.05, -0.1]))
        at[5:] += 0.01 * rng.standard_normal(len(at) - 5)
        everywhere = np.tile((0, len(readings)), (len(at), 1))
        assert (problem.spans != everywhere).any(axis=1).sum() == sum(
            name.startswith("lamps.") for name in kind.names
        )
        told, whole = (evaluate(p, at) for p in (problem, problem._replace(spans=everywhere)))
        np.testing.assert_allclose(told.gradient, whole.gradient, rtol=1e-9)
        told, whole = told.information, whole.information
        np.testing.assert_allclose(told, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


@pytest.mark.parametrize("count", [1, 4, 7])
def test_an_image_whose_direction_is_no_number_starts_from_rows_that_there_are(count):
    units = np.random.default_rng(1).normal(size=(6, 40))
    np.full(count, -(2**40), dtype=np.int64)  # what memory may hold that is given out again
    rows, _ = nearest_rows(units, np.full(6, np.nan), count)
    assert ((rows >= 0) & (rows < units.shape[1])).all()
