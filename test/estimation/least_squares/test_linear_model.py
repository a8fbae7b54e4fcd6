"""Kinds of frame of several lamps: their odds against integrals, and fits that start from a fit."""

import dataclasses

import numpy as np
import pytest

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.least_squares.frame_kinds import frame_kinds
from uuv_optical_array.estimation.least_squares.problem import light_at, start_at
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import BEAM_SIGMA, ROLL
from uuv_optical_array.forward.scene import load_scene

LOADED = load_scene("leading_lights")
SCENE = dataclasses.replace(
    LOADED, prior=dataclasses.replace(LOADED.prior, aim_std_deg=0.0, lamp_aim_std_deg=0.0)
)
MODEL = ForwardModel(SCENE)
POSE = np.array([-5.5, 0.3, -0.2, 0.1, -0.15])


@pytest.fixture(scope="module")
def fit():
    return Estimator(SCENE, compiled=compilation.installed())._fit


def clear_fit(fit, problem):
    """Return the fit of a clear frame from the true pose."""
    return fit._hypothesis(fit._kinds[0], problem, fit._from(POSE, 0.0), np.full((5, 1), np.nan))


@pytest.mark.parametrize(("name", "off"), [(ROLL, 0.08), (BEAM_SIGMA, -1.5)])
def test_odds_are_those_of_an_integral_over_what_is_more_unknown(fit, name, off):
    """The evidence of clear frames whose prior is moved, by the trapezium rule over the move."""
    image = MODEL.read(MODEL.light(POSE, 0.0, {name: np.array(off)}), np.random.default_rng(2))
    problem = fit._kinds[0].problem._replace(readings=image.ravel())
    clear = clear_fit(fit, problem)
    place = next(
        k
        for k, kind in enumerate(fit._kinds)
        if np.count_nonzero(kind.added) == 1
        and kind.names[int(kind.added.diagonal().argmax())] == name
    )
    kind = fit._kinds[place]
    at = fit._kinds[0].names.index(name)
    std = np.sqrt(kind.added.max())
    moves = np.linspace(-4 * std, 4 * std, 161)
    logs = []
    for move in moves:
        mean = problem.nuisance_mean.copy()
        mean[at] += move
        moved = clear_fit(fit, problem._replace(nuisance_mean=mean))
        logs.append(moved.frame.log_evidence - 0.5 * (move / std) ** 2)
    peak = max(logs)
    integral = np.trapezoid(np.exp(np.array(logs) - peak), moves) / (std * np.sqrt(2 * np.pi))
    wanted = np.log(integral) + peak - clear.frame.log_evidence
    assert wanted > 1
    odds = fit._models.log_odds(clear.linear, problem, fit._kinds)[place - 1]
    found = odds - np.log(kind.share / fit._kinds[0].share)
    # As good as linear: one linearisation is to choose what is fitted.
    assert found == pytest.approx(wanted, rel=0.1, abs=0.3)


def test_a_fit_starts_where_a_rolled_follower_was_found(fit):
    roll = np.radians(15)
    problem = frame_kinds(MODEL, fit._prior)[0].problem._replace(roll=roll)
    light = light_at(problem, start_at(problem, fit._from(POSE, roll).poses[0]))
    np.testing.assert_allclose(light, MODEL.light(POSE, roll).ravel(), rtol=1e-9)
