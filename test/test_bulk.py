"""Light at very many poses, in blocks and compiled, against the light of each pose alone."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uuv_optical_array.estimation.table.signature_table import build_table
from uuv_optical_array.forward import effects
from uuv_optical_array.forward import light_batch as bulk
from uuv_optical_array.forward.array import ArraySettings, build_array
from uuv_optical_array.forward.light import MIN_RANGE_M, LateRays, irradiance, lamp_in_body, trace
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

pytestmark = pytest.mark.filterwarnings("error")

PATHS = [
    pytest.param(False, id="NumPy"),
    pytest.param(
        True,
        id="Numba",
        marks=pytest.mark.skipif(not bulk.installed(), reason="Numba is not installed"),
    ),
]
both = pytest.mark.parametrize("compiled", PATHS)
numba = pytest.mark.skipif(not bulk.installed(), reason="Numba is not installed")
SHAPES = {
    "planar": ArraySettings("planar", 5),
    "curved": ArraySettings("curved", 4, width_m=0.5, bow_m=0.7, radius_m=0.4),
    "large": ArraySettings("curved", 21, radius_m=0.32),
}
ARRAYS = {name: build_array(shape) for name, shape in SHAPES.items()}

angles = st.floats(-math.pi, math.pi)
places = st.tuples(st.floats(-12, -2), st.floats(-2, 2), st.floats(-2, 2)) | st.tuples(
    st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3)
)
poses = st.tuples(places, st.floats(-math.pi / 2, math.pi / 2), angles, angles)


def plain(array, pose, roll, sigma, power, k):
    """The light by `trace` and `irradiance`, and that on detectors that face the lamp."""
    rays = trace(array, *lamp_in_body(pose, roll))
    water = np.exp(-k * rays.range_m)
    facing = power / rays.range_m**2 * np.exp(-0.5 * (rays.off_axis_rad / sigma) ** 2) * water
    return irradiance(rays, sigma, power) * water, facing


@both
@pytest.mark.parametrize("shape", ARRAYS)
@settings(deadline=None, max_examples=60)
@given(
    some=st.lists(poses, min_size=1, max_size=12),
    sigma=st.floats(math.radians(3), math.radians(60)),
    k=st.floats(0, 1),
    power=st.just(0.0) | st.floats(1e-6, 1e9),
)
def test_light_is_that_of_trace_and_irradiance(compiled, shape, some, sigma, k, power):
    array = ARRAYS[shape]
    pose = np.array([[*place, pitch, yaw] for place, pitch, yaw, _ in some])
    rolls = np.array([roll for *_, roll in some])
    light = np.full((len(some), len(array.positions)), np.nan)
    with np.errstate(over="raise", divide="raise", invalid="raise", under="raise"):
        bulk.BulkLight(array, sigma, power, k, compiled).write(light, pose, rolls)
    with np.errstate(under="ignore"):
        expected, facing = plain(array, pose, rolls, sigma, power, k)
        # The cosine itself is known to rounding, so a grazing detector's light is less well.
        assert (np.abs(light - expected) <= 1e-12 * facing + 1e-300).all()
    assert (light >= 0).all()


def table_poses(count, seed=1):
    low, high = [-8, -1, -1, -0.4, -0.4], [-4, 1, 1, 0.4, 0.4]
    return np.random.default_rng(seed).uniform(low, high, (count, 5))


@both
def test_a_million_readings_of_the_reference_scene_agree_to_rounding(compiled):
    scene = load_scene("reference")
    pose = table_poses(40_000)
    light = ForwardModel(scene, compiled).light(pose)
    model = ForwardModel(scene)
    expected = np.concatenate([model.light(pose[i : i + 500]) for i in range(0, 40_000, 500)])
    np.testing.assert_allclose(light, expected, rtol=1e-12, atol=1e-12)


@both
@pytest.mark.parametrize(
    "place",
    [
        (-0.4, 0.0, 0.0),  # the lamp in the middle detector itself
        (-0.4 + 1e-4, 0.0, 0.0),
        (-1.0, 0.0, 0.0),
        (-1e-9, 0.0, 0.0),
        (0.4, 0.0, 0.0),
        (1000.0, 0.0, 0.0),  # straight behind the lamp
        (-1000.0, 1e-9, 0.0),
        (-2.0, 1.6, 0.0),  # about the edge of the cone in which eta^2 is a polynomial
        (-2.0, 0.9, 0.0),
        (0.0, 5.0, 0.0),
    ],
)
def test_singular_places_have_the_light_of_trace_and_irradiance(compiled, place):
    array, sigma = ARRAYS["planar"], math.radians(8)
    pose = np.array([[*place, 0.0, 0.0], [*place, 0.3, math.pi], [*place, -math.pi / 2, 2.0]])
    light = np.empty((3, 25))
    bulk.BulkLight(array, sigma, 900.0, 0.1, compiled).write(light, pose, np.array([0.0, 1.0, 3]))
    with np.errstate(under="ignore"):
        expected, facing = plain(array, pose, np.array([0.0, 1.0, 3]), sigma, 900.0, 0.1)
    assert np.isfinite(light).all()
    # Within a millimetre of a detector the direction to the lamp is lost in the place's rounding.
    np.testing.assert_allclose(light, expected, rtol=0, atol=1e-12 * facing.max())
    assert (light <= 900.0 / MIN_RANGE_M**2).all()


@both
def test_light_too_dim_for_a_number_is_zero_and_a_pose_that_is_no_number_gives_none(compiled):
    pose = np.zeros((4, 5))
    pose[:, 0] = -1000, -1e200, math.nan, -4
    pose[3, 3] = math.nan
    light = np.empty((4, 25))
    with np.errstate(under="raise", over="ignore", invalid="ignore"):
        bulk.BulkLight(ARRAYS["planar"], 0.1, 900.0, 10.0, compiled).write(light, pose, np.zeros(4))
    assert (light[:2] == 0).all()
    assert np.isnan(light[2:]).all()


@numba
@pytest.mark.parametrize("degrees", [0.0, 1e-6, 0.01, 1.0, 10.0, 30.0, 44.0, 45.0])
def test_the_polynomial_is_the_square_of_the_angle(degrees):
    from uuv_optical_array.forward import light_batch_kernel as bulk_kernel

    eta = math.radians(degrees)
    squared = math.sin(eta) ** 2
    square = squared * np.polyval(bulk_kernel.SQUARED_ANGLE, squared)
    assert square == pytest.approx(eta**2, rel=2e-15)


@numba
def test_roots_and_exponentials_of_the_kernel_are_those_of_mathematics():
    from uuv_optical_array.forward import light_batch_kernel as bulk_kernel

    rng = np.random.default_rng(5)
    numbers = np.concatenate([10 ** rng.uniform(-6, 200, 20_000), [1e-6, 1.0, 2.0, 4.0]])
    roots = np.array([bulk_kernel.inverse_root(x) for x in numbers])
    np.testing.assert_allclose(roots, 1 / np.sqrt(numbers), rtol=4e-16)
    numbers = np.concatenate([rng.uniform(-708, 0, 20_000), [0.0, -0.0, -1e-300, -707.99]])
    exponentials = np.array([bulk_kernel.exponential(x) for x in numbers])
    np.testing.assert_allclose(exponentials, np.exp(numbers), rtol=4e-16)
    assert [bulk_kernel.exponential(x) for x in (-708.1, -1e5, -1e200)] == [0, 0, 0]


EFFECTS = {
    "attenuation": {"k_per_m": 0.15},
    "ambient": {"level_counts": 7.0},
    "forward_scatter": {"window_m": 0.3},
}


def scene_with(**named):
    values = load_scene("reference").settings()
    return scene_from_settings({**values, "effects": named}, "test")


@both
@pytest.mark.parametrize("names", [[], ["ambient"], ["forward_scatter"], list(EFFECTS)], ids=str)
def test_other_effects_follow_as_ever(compiled, names):
    scene = scene_with(**{name: EFFECTS[name] for name in names})
    pose, roll = table_poses(5000).reshape(50, 100, 5), np.linspace(-1, 1, 100)
    model = ForwardModel(scene, compiled)
    light = model.light(pose, roll)
    expected = np.stack([model.light(some, roll) for some in pose])
    assert light.shape == (50, 100, 5, 5)
    np.testing.assert_allclose(light, expected, rtol=1e-12, atol=1e-11)
    images = np.full_like(light, np.nan)
    model.write_light(images, pose, roll)
    np.testing.assert_array_equal(images, light)


@both
def test_an_effect_that_asks_for_rays_gets_them(compiled, monkeypatch):
    def darkened(array):
        def step(light, rays):
            light.image *= (rays.off_axis_rad < 0.1).reshape(light.image.shape)

        return step

    monkeypatch.setitem(effects.EFFECTS, "darkened", (effects.Stage.LIGHT, darkened))
    monkeypatch.setattr(effects, "check_all", lambda function, values, name: values or {})
    model = ForwardModel(scene_with(attenuation={"k_per_m": 0.1}, darkened={}), compiled)
    pose = table_poses(3000)
    light = model.light(pose)
    assert (light == 0).any()
    assert (light > 0).any()
    np.testing.assert_allclose(light[::100], model.light(pose[::100]), rtol=1e-11, atol=1e-11)


@both
def test_light_whose_exponential_is_subnormal_is_right(compiled):
    array, power, k = ARRAYS["planar"], 1e9, 10.0
    pose = np.array([[-72.5, 0, 0, 0, 0]])
    light = np.empty((1, 25))
    bulk.BulkLight(array, 1.0, power, k, compiled).write(light, pose, np.zeros(1))
    rays = trace(array, *lamp_in_body(pose, np.zeros(1)))
    range_m = rays.range_m
    assert (-k * range_m > -745).all()
    assert (-k * range_m < -708).all()
    expected = irradiance(rays, 1.0, power) * np.exp(-k / 2 * range_m) * np.exp(-k / 2 * range_m)
    assert (expected > 0).all()
    np.testing.assert_allclose(light, expected, rtol=1e-9)


@both
def test_a_turn_of_a_thousand_rounds_is_none(compiled):
    pose = table_poses(40, seed=3)
    turned = pose.copy()
    turned[:, 3:] += 2 * math.pi * np.array([1000, -1000])
    light, expected = np.empty((2, 40, 25))
    lamp = bulk.BulkLight(ARRAYS["planar"], 0.2, 900.0, 0.1, compiled)
    lamp.write(expected, pose, np.zeros(40))
    lamp.write(light, turned, np.full(40, 2000 * math.pi))
    # 2000 pi itself is known to 5e-13.
    np.testing.assert_allclose(light, expected, rtol=0, atol=1e-10 * expected.max())


def test_late_rays_are_traced_once_when_asked():
    pose, roll = table_poses(4), np.zeros(4)
    rays = LateRays(ARRAYS["planar"], pose, roll)
    expected = trace(ARRAYS["planar"], *lamp_in_body(pose, roll))
    assert "range_m" not in vars(rays)
    for name, value in vars(expected).items():
        np.testing.assert_array_equal(getattr(rays, name), value)
    assert rays.range_m is rays.range_m
    with pytest.raises(AttributeError):
        rays.colour  # noqa: B018


def test_images_of_another_shape_are_refused():
    model = ForwardModel(load_scene("reference"))
    for images in (np.empty((3, 5, 4)), np.empty((3, 5, 10))[..., ::2]):
        with pytest.raises(ValueError, match=r"give contiguous \(\.\.\., 5, 5\)"):
            model.write_light(images, np.zeros(5))


def test_numba_is_loaded_for_bulk_work_only():
    code = (
        "import sys, numpy as np; from uuv_optical_array.forward.model import ForwardModel;"
        "from uuv_optical_array.forward.scene import load_scene;"
        "from uuv_optical_array.estimation.table.signature_table import build_table;"
        "model = ForwardModel(load_scene('reference'));"
        "model.light(np.tile([-6.0, 0, 0, 0, 0], (10_000, 1)));"
        "print('numba' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
    assert not bulk.worthwhile(bulk.WORTH_READINGS - 1)
    assert bulk.worthwhile(bulk.WORTH_READINGS) == bulk.installed()


def test_without_numba_asking_for_it_is_refused_with_the_cure_and_bulk_work_goes_on(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.setattr(bulk, "installed", lambda: True)
    monkeypatch.setattr(bulk, "WORTH_READINGS", 1)
    bulk.kernel.cache_clear()
    with pytest.raises(ValueError, match=r"compiled: .*pip install -e '\.\[fast\]'"):
        ForwardModel(load_scene("reference"), compiled=True)
    assert not bulk.worthwhile(10**9)
    light = ForwardModel(load_scene("reference")).light(table_poses(3000))
    assert light.max() > 0


@numba
def test_where_nothing_can_be_kept_the_kernel_is_compiled_all_the_same(monkeypatch):
    import numba

    from uuv_optical_array.forward import light_batch_kernel as bulk_kernel

    asked = []

    def njit(*signature, **options):
        asked.append(options.get("cache", False))
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(numba, "njit", njit)
    bulk.kernel.cache_clear()
    try:
        assert bulk.kernel() is bulk_kernel.write
    finally:
        bulk.kernel.cache_clear()
    assert asked == [True, False]


@both
def test_a_table_is_the_same_either_way(compiled, monkeypatch):
    monkeypatch.setattr(bulk, "WORTH_READINGS", 1 if compiled else math.inf)
    values = load_scene("reference").settings()
    values["table"] = {**values["table"], "x_m": [-8, -4, 3], "z_m": [-0.5, 0.5, 2]}
    table = build_table(scene_from_settings(values, "test"))
    model = ForwardModel(scene_from_settings(values, "test"))
    peaks = [model.expected(pose).max() for pose in table.poses[::500]]
    np.testing.assert_allclose(table.parameters[::500, 0] * 1023, peaks, rtol=1e-12)
