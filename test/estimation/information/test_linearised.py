"""Readings as a linear problem, of the light and the likelihood; its coordinates compiled."""

import numpy as np
import pytest
from fits import writer_of_fits
from needs import numba

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.information.likelihood import log_likelihood
from uuv_optical_array.estimation.information.linearised import Lineariser
from uuv_optical_array.estimation.unknowns import joint_coordinates
from uuv_optical_array.estimation.unknowns.constants import constants_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

pytestmark = pytest.mark.filterwarnings("error")
MODEL = ForwardModel(load_scene("follow"))
CONSTANTS = constants_of(MODEL)
OFFSETS = np.array([0.1, -0.4, 0.01, 0.3, 0.1, -0.02, 3.0, -2.0, 4.0])
WAYS = pytest.mark.parametrize(
    "fast", [False, pytest.param(True, marks=numba)], ids=["plain", "compiled"]
)


@WAYS
@pytest.mark.parametrize("names", [CONSTANTS.names, CONSTANTS.names[1:], ()], ids=len)
def test_readings_are_linearised_about_the_models_light(fast, names):
    linearise = Lineariser(MODEL, names, writer_of_fits() if fast else None)
    pose, roll = np.array([-4.0, 0.3, -0.2, 0.05, -0.1]), 0.2
    offsets = dict(zip(CONSTANTS.names, OFFSETS, strict=True))
    at = np.array([*pose, *(offsets[name] for name in names)])
    light, slopes = MODEL.linearised(pose, roll, {name: offsets[name] for name in names})
    image = np.rint(light + np.linspace(-9, 9, light.size))
    image[3], image[4] = MODEL.noise.high, MODEL.noise.low  # which say only what is beyond them
    found = linearise(image.reshape(MODEL.array.side, -1), at, roll)
    _, score, curvature = log_likelihood(image, light, MODEL.noise._replace(square=0.0))
    np.testing.assert_array_equal(found.at, at)
    np.testing.assert_allclose(found.slopes, slopes, rtol=1e-9, atol=1e-9 * np.abs(slopes).max())
    np.testing.assert_allclose(found.light, light, rtol=1e-9)
    says = np.isfinite(found.variances)
    np.testing.assert_array_equal(says, curvature > 1e-12)
    np.testing.assert_allclose(1 / found.variances, says * curvature, rtol=1e-7)
    np.testing.assert_allclose(
        found.residuals[says], (score / curvature)[says], rtol=1e-7, atol=1e-7
    )


@numba
def test_compiled_coordinates_are_those_of_numpy():
    at = np.array([-4.0, 0.3, -0.2, 0.05, -0.1, *OFFSETS])
    joint = joint_coordinates.JointCoordinates(CONSTANTS.frame, CONSTANTS.names)
    own, slopes = joint.of(at)
    place, _ = joint.place(own)
    joint_coordinates.prepare(CONSTANTS)
    assert compilation.loaded(joint_coordinates.write_place).signatures
    np.testing.assert_allclose(joint.of(at)[0], own, rtol=1e-12)
    np.testing.assert_allclose(joint.place(own)[0], place, rtol=1e-12)
    for _, compiled in (joint.of(at), joint.place(own)):
        np.testing.assert_allclose(compiled, slopes, rtol=1e-9, atol=1e-12)
