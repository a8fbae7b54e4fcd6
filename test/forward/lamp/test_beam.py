"""The beam as a sum of Gaussians: settings, light beside that of each alone, and slopes."""

import itertools
import math

import numpy as np
import pytest
import second_forward
from differences import assert_close, differentiate
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from needs import numba
from scenes import changed, ready
from scipy.integrate import quad
from scipy.optimize import brentq

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.lamp.beam import angle_of, beam_solid_angle, dark_angle, gaussians_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.view.shapes import beams

WEIGHTS, WIDTHS = [-0.22, 0.87, 0.35], [0.64, 1.0, 1.82]  # a flat top and a wide foot
FLAT = {"beam_weights": WEIGHTS, "beam_widths": WIDTHS}
POSES = np.array(
    [[-5.0, 0.3, -0.2, 0.1, -0.05], [-7.5, -0.9, 0.5, -0.2, 0.2], [-4.0, 0.0, 0.0, 0.0, 0.0]]
)
BAD = [
    ({"beam_widths": [0.5, 1.0]}, r"beam_weights: 0 weights, but 2 beam_widths; give each"),
    ({"beam_widths": [1.0], "beam_weights": [1.0]}, r"beam_widths: 1 widths; give two or 3"),
    ({"beam_widths": [1.0] * 4, "beam_weights": [0.25] * 4}, r"beam_widths: 4 widths"),
    ({"beam_widths": [0.5, 1.0], "beam_weights": [0.5, 0.6]}, r"their sum is 1\.1; scale it to 1"),
    ({"beam_widths": [0.5, 20.0], "beam_weights": [0.5, 0.5]}, r"160 deg; it must be from 0\.1"),
    ({"beam_widths": [1.0, 2.0], "beam_weights": [1.1, -0.1]}, r"light negative 20\.\d deg off"),
    ({"beam_widths": [0.5, 1.0], "beam_weights": [0.5, "a"]}, r"beam_weights\[1\]: 'a' is not"),
]


@pytest.mark.parametrize(("lamp", "error"), BAD)
def test_what_is_no_beam_is_refused_with_a_cure(lamp, error):
    with pytest.raises(ValueError, match=rf"lamp\.beam_\w+.*{error}|lamp\..*{error}"):
        changed("reference", lamp=lamp)


@pytest.mark.parametrize("name", ["reference", "eren2016", "follow", "harbour", "sunlit_modulated"])
def test_the_light_is_the_sum_of_that_of_each_gaussian_by_the_second_forward_model(name):
    scene = changed(name, lamp=FLAT)
    model, plain, total = ForwardModel(scene), ready(name).settings(), 0.0
    for pose, found in zip(POSES, model.light(POSES, 0.1, on_array=False), strict=True):
        total = np.zeros(found.shape)
        for weight, width in zip(WEIGHTS, WIDTHS, strict=True):
            sigma_deg = width * plain["lamp"]["beam_sigma_deg"]
            one = dict(plain, lamp=plain["lamp"] | {"beam_sigma_deg": sigma_deg})
            kept = {k: v for k, v in plain["effects"].items() if k not in second_forward.ARRAY}
            one["effects"] = {k: v for k, v in kept.items() if k != "demodulation"}
            total += weight * second_forward.light(one, pose, 0.1, power=model.power)
        np.testing.assert_allclose(found, total, rtol=1e-9)
    # The reference reading sets the power of the whole beam.
    aligned = [-scene.lamp.reference_range_m, 0, 0, 0, 0]
    lit = model.light(aligned, on_array=False).max()
    if not {"responsivity", "forward_scatter"} & {*scene.effects}:
        assert lit == pytest.approx(scene.lamp.reference_counts, rel=1e-12)


@pytest.mark.parametrize("name", ["reference", "harbour"])
@settings(max_examples=20, deadline=None)
@given(
    x=st.floats(-9, -1),
    aside=st.tuples(*[st.floats(-0.8, 0.8)] * 2),
    turn=st.tuples(*[st.floats(-0.3, 0.3)] * 2),
    wider=st.floats(-1, 1),
)
def test_slopes_are_those_of_differences(name, x, aside, turn, wider):
    model = ForwardModel(changed(name, lamp=FLAT))
    names = ["lamp.power", "lamp.beam_sigma_deg"]
    if name == "harbour":
        names += ["sea.absorption_per_m", "sea.scattering_per_m"]
    at = np.array([x, *aside, *turn, 0.1, wider, *[0.05] * (len(names) - 2)])

    def light(at):
        offsets = dict(zip(names, np.moveaxis(at[..., 5:], -1, 0), strict=True))
        return model.light(at[..., :5], 0.1, offsets).ravel()

    offsets = dict(zip(names, at[5:], strict=True))
    _, jacobian = model.linearised(at[:5], 0.1, offsets)
    assert_close(jacobian, differentiate(light, at))


@given(parts=st.lists(st.tuples(st.floats(-1, 1), st.floats(0.3, 3)), min_size=2, max_size=3))
def test_a_beam_is_dark_from_where_its_gaussians_cancel_out(parts):
    parts = [(weight, width) for weight, width in parts if abs(weight) > 1e-3]
    assume(sum(weight for weight, _ in parts) > 1e-3)
    widest = max(width for _, width in parts)
    angles = np.linspace(0, 12 * widest, 3001)
    # Over the widest, so that it does not vanish far off the axis.
    light = sum(w * np.exp(-0.5 * angles**2 * (s**-2 - widest**-2)) for w, s in parts)
    found = dark_angle(np.array(parts).T)
    if found is None:
        assert light.min() > -1e-3
    else:
        assert light[angles < found - 0.05].min(initial=1.0) > 0
        assert np.interp(found, angles, light) < 1e-3


def test_equal_widths_are_one_gaussian_and_a_third_without_weight_is_none():
    one = changed("follow", lamp={"beam_sigma_deg": 9.0})
    equal = {"beam_sigma_deg": 6.0, "beam_widths": [1.5] * 3, "beam_weights": [0.5, -0.3, 0.8]}
    two = {"beam_sigma_deg": 9.0, "beam_widths": [1.0, 2.0], "beam_weights": [0.7, 0.3]}
    three = {"beam_widths": [1.0, 2.0, 0.3], "beam_weights": [0.7, 0.3, 0.0]}
    lit = [
        ForwardModel(changed("follow", lamp=lamp)).light(POSES)
        for lamp in (equal, two, two | three)
    ]
    np.testing.assert_allclose(lit[0], ForwardModel(one).light(POSES), rtol=1e-12)
    np.testing.assert_allclose(lit[1], lit[2], rtol=1e-12)


@pytest.mark.parametrize("name", ["reference", "follow"])
@pytest.mark.parametrize("widths", [[0.8, 0.8, 1.0], [0.8, 0.9, 1.0]])
def test_light_and_slopes_are_the_same_in_any_order_even_where_two_gaussians_cancel_out(
    name, widths
):
    model, unknown = ForwardModel(ready(name)), {"lamp.beam_sigma_deg": 0.2}
    gaussians = np.array([[0.5, -0.5, 1.0], widths])
    found = [
        model.with_beam(gaussians[:, order]).linearised(POSES, 0.1, unknown)
        for order in map(list, itertools.permutations(range(3)))
    ]
    for light, slopes in found[1:]:
        np.testing.assert_allclose(light, found[0][0], rtol=1e-12)
        np.testing.assert_allclose(slopes, found[0][1], rtol=1e-9, atol=1e-9 * abs(slopes).max())


@given(
    weights=st.tuples(st.floats(-0.3, 0.5), st.floats(0.05, 0.4)),
    widths=st.tuples(st.floats(0.2, 0.8), st.floats(1.2, 3)),
    place=st.tuples(*[st.floats(-30, 30)] * 3),
    turn=st.tuples(st.floats(-1.5, 1.5), st.floats(-3, 3)),
)
@settings(max_examples=40, deadline=None)
def test_light_is_finite_and_not_negative_at_any_pose(weights, widths, place, turn):
    narrow, wide = weights
    lamp = {
        "beam_weights": [narrow, 1 - narrow - wide, wide],
        "beam_widths": [widths[0], 1.0, widths[1]],
    }
    for name in ("reference", "follow"):
        model = ForwardModel(changed(name, lamp=lamp))
        image, jacobian = model.linearised([*place, *turn])
        assert np.isfinite(image).all()
        assert np.isfinite(jacobian).all()
        assert (image >= 0).all()


def test_solid_angle_and_edges_are_those_of_the_whole_beam():
    scene = changed("reference", lamp=FLAT)
    shape, sigma = gaussians_of(scene.lamp), math.radians(8)

    def beam(eta):
        parts = zip(WEIGHTS, WIDTHS, strict=True)
        return sum(w * math.exp(-0.5 * (eta / (s * sigma)) ** 2) for w, s in parts)

    flux, _ = quad(lambda eta: 2 * math.pi * beam(eta) * math.sin(eta), 0, math.pi, points=[0.5])
    assert beam_solid_angle(sigma, shape) == pytest.approx(flux, rel=1e-9)
    for stds in (1, 2):
        edge = brentq(lambda eta, stds=stds: beam(eta) - math.exp(-0.5 * stds**2), 0.01, 1)
        assert angle_of(shape, stds) * sigma == pytest.approx(edge, rel=1e-4)
        [(_, cones)] = beams(scene, 2.0)
        vertices, _ = cones[stds - 1]
        widest = np.hypot(vertices[:, 1], vertices[:, 2]).max()
        assert widest == pytest.approx(2 * math.tan(edge), rel=1e-3)


@numba
@pytest.mark.parametrize("name", ["reference", "follow"])
def test_poses_in_a_beam_of_three_gaussians_are_found_as_honestly_as_in_one(name):
    scene = changed(name, lamp=FLAT, prior={"known": "exactly"})
    model, rng = ForwardModel(scene), np.random.default_rng(5)
    poses = lit_poses(model, 150, rng)
    estimator, errors = Estimator(scene, compiled=compilation.installed()), []
    for pose, image in zip(poses, model.expose(poses, rng), strict=True):
        try:
            found = estimator.estimate(image)
        except NoPose:
            continue
        off = found.pose - pose
        errors.append(off @ np.linalg.solve(found.covariance, off))
    assert len(errors) >= 145
    # The mean of 150 squared errors of five degrees of freedom has a deviation of 0.26.
    assert abs(np.mean(errors) - 5) < 5 * math.sqrt(10 / len(errors))
