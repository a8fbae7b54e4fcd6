"""The compiled fit against the NumPy one, which SciPy's optimisers check in `test_fit`."""

import math
import subprocess
import sys
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import wrightomega

from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.estimator import Estimator, NoPose
from uuv_optical_array.estimation.features import key_parameters
from uuv_optical_array.estimation.least_squares.compiled_fit import CompiledFit, image_fit
from uuv_optical_array.estimation.least_squares.solver import ImageFit, Prior
from uuv_optical_array.estimation.likelihood import Limits, log_likelihood
from uuv_optical_array.estimation.table.signature_table import build_table
from uuv_optical_array.forward import effects as effects_module
from uuv_optical_array.forward import light_batch as bulk
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

pytestmark = pytest.mark.filterwarnings("error")
numba = pytest.mark.skipif(not bulk.installed(), reason="Numba is not installed")
reproducible = settings(deadline=None, derandomize=True, max_examples=25)

WATER = {"attenuation": {"k_per_m": 0.2}}
ADC = {"saturation": {"level_counts": 700.0}, "adc": {"bits": 10}}
EFFECTS = {
    "none": {},
    "electronics": {**WATER, "sensor_noise": {"sigma_counts": 1.0}, **ADC},
    "shot noise": {**WATER, "shot_noise": {"electrons_per_count": 5.0}, **ADC},
    "window": {"forward_scatter": {"window_m": 0.25}, "sensor_noise": {"sigma_counts": 1.0}},
    "spread": {"beam_spread": {"scattering_per_m": 0.3, "scattering_angle_deg": 4.0}},
    "lens": {"field_of_view": {"cosine_power": 2.5}},
    "rim": {"field_of_view": {"half_angle_deg": 40.0, "edge_deg": 30.0}},
    "faults": {
        "responsivity": {"spread": 0.1, "seed": 1},
        "detector_faults": {"dead": [[0, 1]], "stuck": [[2, 2]], "stuck_counts": 40.0},
    },
    "all": {
        **WATER,
        "beam_spread": {"scattering_per_m": 0.1, "scattering_angle_deg": 2.0},
        "field_of_view": {"cosine_power": 1.5},
        "responsivity": {"spread": 0.05, "seed": 2},
        "detector_faults": {"dead": [[1, 1]]},
        "ambient": {"level_counts": 20.0},
        "forward_scatter": {"window_m": 0.25},
        "photodiode": {
            "part": "SM05PD1A",
            "bandwidth_hz": 1e3,
            "load_ohm": 1e6,
            "amps_per_count": 1e-9,
        },
        **ADC,
    },
}
STDS = {
    "lamp.power": 0.1,
    "attenuation.k_per_m": 0.02,
    "ambient.level_counts": 3.0,
    "responsivity.temperature_c": 4.0,
}
ALIGNED = np.array([-6.0, 0, 0, 0, 0])

# From where the array is used to where a detector looks away from the lamp and beside its beam.
places = st.tuples(st.floats(-9, -0.6), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
poses = st.tuples(places, st.floats(-1.2, 1.2), st.floats(-1.2, 1.2))
some_poses = st.lists(poses, min_size=1, max_size=4).map(
    lambda some: np.array([(*place, pitch, yaw) for place, pitch, yaw in some])
)
rolls = st.sampled_from([0.0, 0.3])


def fits(effects, shape="curved", side=5, sigma_deg=8.0, nuisances=False):
    """Return the compiled fit of a scene, and the NumPy one."""
    values = load_scene("reference").settings()
    values["lamp"]["beam_sigma_deg"] = sigma_deg
    values["array"].update(shape=shape, detectors_per_side=side)
    if shape == "planar":
        del values["array"]["radius_m"]
    values["effects"] = EFFECTS[effects]
    scene = scene_from_settings(values, "test")
    stds = {
        name: std
        for name, std in STDS.items()
        if nuisances and name.partition(".")[0] in ("lamp", *scene.effects)
    }
    model = ForwardModel(scene)
    prior = Prior(ALIGNED, np.array([6.0, 3, 3, 1.5, 1.5]), stds)
    return CompiledFit(model, prior), ImageFit(model, prior)


def assert_close(ours, theirs):
    """Compare to rounding, of the largest of each place."""
    rows = theirs.reshape(len(theirs), -1)
    scale = np.abs(rows).max(axis=1).reshape(-1, *(1,) * (theirs.ndim - 1))
    assert np.all(np.abs(ours - theirs) <= 1e-9 * scale + 1e-12)


def at_places(fit, some, roll, rng):
    coordinates = np.zeros((len(some), len(fit.mean)))
    coordinates[:, :5] = fit.chart.from_pose(some, roll)
    coordinates[:, 5:] = rng.standard_normal(coordinates[:, 5:].shape) * fit.std[5:]
    return coordinates


@numba
@pytest.mark.parametrize("effects", EFFECTS)
@pytest.mark.parametrize("shape", ["curved", "planar"])
@pytest.mark.parametrize("nuisances", [False, True], ids=["known", "nuisances"])
def test_both_say_the_same_of_every_place(effects, shape, nuisances):
    """The image is that of the first pose, the places are those of all."""
    compiled, plain = fits(effects, shape, 3 if effects == "all" else 5, nuisances=nuisances)

    @reproducible
    @given(some=some_poses, roll=rolls, seed=st.integers(0, 99), scale=st.sampled_from([1, 30]))
    def check(some, roll, seed, scale):
        rng = np.random.default_rng(seed)
        coordinates = at_places(plain, some, roll, rng)
        limits = plain.model.limits
        readings = scale * plain.model.expose(some[0], rng, roll).ravel()
        # Without noise the gradient at the truth is rounding alone.
        readings = np.clip(readings + rng.standard_normal(len(readings)), limits.low, limits.high)
        for ours, theirs in zip(
            compiled.evaluate(readings, coordinates, roll),
            plain.evaluate(readings, coordinates, roll),
            strict=True,
        ):
            assert_close(ours, theirs)
        for ours, theirs in zip(
            compiled.cost(readings, coordinates, roll),
            plain.cost(readings, coordinates, roll),
            strict=True,
        ):
            assert_close(ours, theirs)
        assert_close(compiled.light(coordinates[0], roll), plain.light(coordinates[0], roll))

    check()


@numba
@pytest.mark.parametrize("sigma_deg", [0.5, 60.0])
@pytest.mark.parametrize("side", [3, 21])
def test_both_say_the_same_of_narrow_and_wide_beams_on_small_and_large_arrays(sigma_deg, side):
    compiled, plain = fits("electronics", "curved", side, sigma_deg)
    rng = np.random.default_rng(1)
    some = rng.uniform([-9, -2, -2, -1.5, -3], [2, 2, 2, 1.5, 3], (200, 5))
    coordinates = at_places(plain, some, 0.0, rng)
    readings = plain.model.expose(ALIGNED, rng).ravel()
    for ours, theirs in zip(
        compiled.evaluate(readings, coordinates, 0.0),
        plain.evaluate(readings, coordinates, 0.0),
        strict=True,
    ):
        assert_close(ours, theirs)


@numba
@pytest.mark.parametrize("effects", ["electronics", "shot noise", "all"])
def test_both_descend_to_the_same_places(effects):
    compiled, plain = fits(effects, nuisances=True)
    rng = np.random.default_rng(2)
    low, high = np.array([-8, -0.6, -0.6, -0.3, -0.3]), np.array([-4, 0.6, 0.6, 0.3, 0.3])
    for truth in rng.uniform(low, high, (20, 5)):
        readings = plain.model.expose(truth, rng).ravel()
        starts = truth + rng.normal(0, 0.1, (4, 5))
        best, [same] = plain.refine(readings, starts)[0], compiled.refine(readings, starts)[:1]
        off = same.coordinates - best.coordinates
        # An iteration more or less is worth a tenth of a standard deviation at most.
        assert off @ best.information @ off < 0.1**2
        assert same.cost == pytest.approx(best.cost, abs=0.01)
        np.testing.assert_allclose(same.pose, plain.chart.to_pose(same.coordinates[:5], 0.0)[0])


@numba
def test_readings_and_priors_may_be_those_of_each_start():
    compiled, plain = fits("electronics")
    rng = np.random.default_rng(3)
    some = ALIGNED + rng.normal(0, 0.2, (6, 5))
    readings = plain.model.expose(some, rng).reshape(6, -1)
    mean = compiled.mean + rng.normal(0, 1, (6, 5))
    coordinates = at_places(plain, some, 0.0, rng)
    together, _, poses = compiled.descend(readings, coordinates.copy(), 0.0, mean)
    for i in range(6):
        alone = compiled.descend(readings[i], coordinates[i : i + 1].copy(), 0.0, mean[i])
        assert alone[0][0] == together[i]
        assert (alone[2][0] == poses[i]).all()


@numba
@given(
    reading=st.floats(-50, 1200),
    light=st.floats(-100, 5000) | st.floats(-1e9, 1e9),
    still=st.floats(1e-6, 1e4),
    steep=st.just(0.0) | st.floats(1e-3, 10),
)
@reproducible
def test_the_likelihood_of_a_reading_is_that_of_scipys_functions(reading, light, still, steep):
    from uuv_optical_array.estimation.least_squares.fit_kernel import _likely

    variance = np.maximum(still + steep * max(light, 0.0), 1e-6)
    one = np.ones(1)
    value, score, curvature = log_likelihood(
        reading * one, light * one, variance * one, steep * one, Limits(0.0, 1023.0)
    )
    ours = _likely(reading, light, still, steep, 1e-6, 0.0, 1023.0)
    # Far out a hazard less its argument is the difference of nearly equal numbers.
    for mine, theirs, near in zip(
        ours, (value, score[0], curvature[0]), (1e-9, 1e-9, 1e-6), strict=True
    ):
        assert mine == pytest.approx(float(theirs), rel=near, abs=1e-12)


@numba
def test_the_range_comes_from_wrights_omega():
    from uuv_optical_array.estimation.least_squares.fit_kernel import _omega

    for target in np.concatenate([np.linspace(-30, 15, 2001), [-0.999999, 2.000001]]):
        assert _omega(target) == pytest.approx(float(wrightomega(target)), rel=1e-14)


@numba
def test_an_estimate_is_the_same_by_either():
    scene = load_scene("reference")
    table = build_table(scene)
    model, rng = ForwardModel(scene), np.random.default_rng(4)
    both = [Estimator(table, "least_squares", compiled=compiled) for compiled in (True, False)]
    low, high = np.array([-8, -0.5, -0.5, -0.3, -0.3]), np.array([-4, 0.5, 0.5, 0.3, 0.3])
    for pose in rng.uniform(low, high, (25, 5)):
        image = model.expose(pose, rng)
        signature = key_parameters(image, scene.full_scale_counts, scene.signature.peak)
        ours, theirs = (estimator.estimate(signature, image) for estimator in both)
        off = (ours.pose - theirs.pose) / np.sqrt(theirs.covariance.diagonal())
        assert np.abs(off).max() < 0.05
        np.testing.assert_allclose(
            ours.covariance.diagonal(), theirs.covariance.diagonal(), rtol=0.1
        )


@numba
def test_no_light_at_all_is_no_pose_by_either():
    scene = load_scene("reference")
    table = build_table(scene)
    for compiled in (True, False):
        with pytest.raises(NoPose, match="no light"):
            Estimator(table, "least_squares", compiled=compiled).estimate(
                np.zeros(5), np.zeros((5, 5))
            )


def test_without_numba_numpy_fits_and_asking_for_it_says_what_to_install():
    code = """
import sys
sys.modules["numba"] = None
import numpy as np
from uuv_optical_array.estimation.least_squares.compiled_fit import image_fit
from uuv_optical_array.estimation.least_squares.solver import Prior
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.scene import load_scene
model, prior = ForwardModel(load_scene("reference")), Prior(np.zeros(5), np.ones(5), {})
print(type(image_fit(model, prior)).__name__)
try:
    image_fit(model, prior, True)
except ValueError as error:
    print(error)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    kind, error = run.stdout.splitlines()
    assert kind == "ImageFit"
    assert error.startswith("compiled: ")
    assert error.endswith("install Numba: pip install -e '.[fast]'")


@numba
def test_an_effect_that_the_kernel_does_not_know_is_left_to_numpy(monkeypatch):
    def fog(array, *, share):
        return lambda light, rays: light.dim(np.full(light.image.shape[-2:], share))

    fog.__annotations__["share"] = Annotated[float, Quantity("of the light that is left", "", 0, 1)]
    monkeypatch.setitem(effects_module.EFFECTS, "fog", (effects_module.Stage.LIGHT, fog))
    values = load_scene("reference").settings()
    values["effects"] = {**WATER, "fog": {"share": 0.5}}
    model = ForwardModel(scene_from_settings(values, "test"))
    prior = Prior(ALIGNED, np.ones(5), {})
    assert type(image_fit(model, prior)) is ImageFit
    with pytest.raises(ValueError, match="compiled: fog is no effect of the kernel"):
        image_fit(model, prior, True)


@numba
def test_no_frame_waits_for_the_compiler():
    """Whatever the image's memory looks like, the kernels are those of the start."""
    from uuv_optical_array.estimation.least_squares import fit_kernel

    kernels = fit_kernel.evaluate, fit_kernel.costs, fit_kernel.descend, fit_kernel.light_at
    scene = load_scene("reference")
    estimator = Estimator(build_table(scene), "least_squares", compiled=True)
    before = [len(kernel.signatures) for kernel in kernels]
    model, rng = ForwardModel(scene), np.random.default_rng(5)
    # The second one's dim image starts everywhere at once and goes through the chains.
    for pose in (ALIGNED, np.array([-8, 0.9, 0.9, -0.3, 0.3])):
        image = model.expose(pose, rng)
        fixed = image.copy()
        fixed.flags.writeable = False
        for same in (image, fixed, np.asfortranarray(image), image.astype(np.uint16), image[:]):
            signature = key_parameters(same, scene.full_scale_counts, scene.signature.peak)
            estimator.estimate(signature, same)
    assert [len(kernel.signatures) for kernel in kernels] == before


def test_the_kind_of_fit_can_be_chosen():
    model = ForwardModel(load_scene("reference"))
    prior = Prior(ALIGNED, np.ones(5), {})
    assert type(image_fit(model, prior, False)) is ImageFit
    assert math.isfinite(
        image_fit(model, prior, False).cost(np.ones(25), np.zeros((1, 5)), 0)[1][0]
    )
    if bulk.installed():
        assert type(image_fit(model, prior)) is CompiledFit
