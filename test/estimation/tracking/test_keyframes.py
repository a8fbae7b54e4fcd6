"""Biases by keyframes: against SciPy's minimum, and a regression over the frames that are kept."""

import numpy as np
import pytest
from scipy.optimize import minimize

from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import BiasSpace
from uuv_optical_array.estimation.tracking.keyframes import (
    EVERY_S,
    LINEAR,
    MOST_READINGS,
    BiasFit,
    Keyframe,
)
from uuv_optical_array.estimation.tracking.measurement import Measurement
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.estimation.unknowns.joint_coordinates import JointCoordinates

pytestmark = pytest.mark.filterwarnings("error")

SECOND_NS, STD, HOLD_S = 10**9, 0.5, 1e9
LINEAR_IN_ALL = JointCoordinates(None, ())


class Frame:
    """Readings whose light follows pose and constant by laws that are bent."""

    def __init__(self, rng, count, truth, bend):
        self.by_pose, self.by_constant = rng.standard_normal((count, 5)), rng.uniform(2, 4, count)
        self.bend = bend
        self.readings = self.light(truth) + rng.standard_normal(count)

    def light(self, constant):
        return self.by_constant * np.sinh(self.bend * constant) / self.bend

    def at(self, at):
        """Return the readings linearised there, as `Lineariser` has them."""
        by_constant = self.by_constant * np.cosh(self.bend * at[5])
        residuals = self.readings - self.light(at[5]) - self.by_pose @ at[:5]
        ones = np.ones(len(residuals))
        slopes = np.column_stack([self.by_pose, by_constant])
        return LinearisedReadings(at, residuals, slopes, ones, ones)

    def cost(self, constant):
        """Return the squares of what is left by the best pose."""
        residuals = self.readings - self.light(constant)
        pose = np.linalg.lstsq(self.by_pose, residuals, rcond=None)[0]
        return float(np.square(residuals - self.by_pose @ pose).sum())


def fit_of(frames, every_s=1):
    fit = BiasFit(BiasSpace(Constants(("lamp.power",), (STD,)), HOLD_S), HOLD_S, LINEAR_IN_ALL)
    keyframes = fit.prior()
    for k, frame in enumerate(frames):
        stamp_ns, zeros = k * every_s * SECOND_NS, np.zeros(5)
        key = Keyframe(stamp_ns, zeros, zeros, np.zeros((5, 1)), np.zeros(1), frame.at)
        keyframes, biases = fit.fitted(keyframes, key)
    return keyframes, biases


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("bend", [1e-6, 3.0])
def test_biases_are_where_all_frames_together_are_likeliest(seed, bend):
    rng = np.random.default_rng(seed)
    # Where the law is bent, the first step from the prior goes far beyond what fits.
    frames = [Frame(rng, 12, 1.5, bend) for _ in range(12)]
    _, biases = fit_of(frames)

    def cost(bias):
        return bias[0] ** 2 + sum(frame.cost(STD * bias[0]) for frame in frames)

    best = minimize(cost, [2.5], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-9}).x[0]
    std = np.sqrt(biases.covariance[0, 0])
    assert biases.mean[0] == pytest.approx(best, abs=LINEAR * std)
    curvature = (cost([best + 1e-4]) - 2 * cost([best]) + cost([best - 1e-4])) / 1e-8
    assert std == pytest.approx(np.sqrt(2 / curvature), rel=0.1)


class Walled(Frame):
    """Beyond a wall the readings fit much worse, which their slopes do not say."""

    wall = 0.3

    def at(self, at):
        there = super().at(at)
        beyond = 1e3 * (at[5] > self.wall) * self.by_constant
        return there._replace(residuals=there.residuals - beyond)


def test_no_step_is_taken_to_where_the_score_is_larger():
    rng = np.random.default_rng(1)
    keyframes, _ = fit_of([Walled(rng, 12, 0.7, 1e-6) for _ in range(4)])
    assert 0 < keyframes.biases[0] <= Walled.wall / STD


def test_a_step_no_part_of_which_fits_better_is_not_known_better():
    class AtWall(Walled):
        wall = 0.0

    rng = np.random.default_rng(1)
    frames = [AtWall(rng, 12, 0.7, 1e-6) for _ in range(4)]
    keyframes, biases = fit_of(frames)
    assert keyframes.biases == biases.mean == 0
    assert np.sqrt(biases.covariance[0, 0]) == pytest.approx(0.7 / STD, rel=0.1)


def test_a_frame_is_linearised_where_the_track_expected_it_moved_with_the_biases():
    frame, places = Frame(np.random.default_rng(3), 12, 0.7, 1e-6), []

    def readings_at(at):
        places.append(at)
        return frame.at(at)

    fit = BiasFit(BiasSpace(Constants(("lamp.power",), (STD,)), HOLD_S), HOLD_S, LINEAR_IN_ALL)
    place, slopes, then = np.arange(5.0), np.ones((5, 1)), np.array([0.25])
    key = Keyframe(0, np.zeros(5), place, slopes, then, readings_at)
    keyframes, _ = fit.fitted(fit.prior(), key)
    assert len(places) > 1
    for at, bias in ((places[0], 0.0), (places[-1], keyframes.biases[0])):
        np.testing.assert_allclose(at, [*place + (bias - 0.25), STD * bias])


def test_when_there_are_too_many_every_second_one_is_left_out():
    most, rng = 10, np.random.default_rng(5)
    frames = [Frame(rng, MOST_READINGS // most, 0.7, 1e-6) for _ in range(25)]
    keyframes, biases = fit_of(frames)
    kept = [frame.stamp_ns // SECOND_NS for frame in keyframes.frames]
    assert most / 2 <= len(kept) <= most
    assert kept[-1] == 24
    assert kept[0] < 8
    assert keyframes.every_s == 8 * EVERY_S  # three times
    slopes = np.array([frames[k].at(np.zeros(6)).slopes for k in kept])
    rows, values = [np.array([[1.0]])], [np.zeros(1)]
    for k, slope in zip(kept, slopes, strict=True):
        basis = np.linalg.qr(slope[:, :5])[0]
        rest = np.eye(len(slope)) - basis @ basis.T
        rows.append(rest @ slope[:, 5:] * STD)
        values.append(rest @ frames[k].readings)
    best = np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=None)[0]
    assert biases.mean == pytest.approx(best, rel=1e-6)


def test_frames_are_wanted_from_new_places_and_not_too_often():
    keyframes, _ = fit_of([Frame(np.random.default_rng(0), 8, 0.1, 1e-6)])
    # Errors of y and yaw that go together: across them, half as far is a new place.
    covariance = np.diag([0.2, 0.1, 0.1, 0.05, 0.05]) ** 2
    covariance[1, 4] = covariance[4, 1] = 0.9 * 0.1 * 0.05
    root = np.linalg.cholesky(covariance)

    def wants(keyframes, stamp_ns, pose):
        return keyframes.want(Measurement(stamp_ns, pose, root, None, None, 0.0), pose)

    apart_ns = round(EVERY_S * SECOND_NS)
    for stamp_ns, pose, wanted in (
        (apart_ns, [0.21, 0, 0, 0, 0], True),
        (apart_ns, [0.19, 0, 0, 0, 0], False),
        (apart_ns, [0, 0.09, 0, 0, 0.045], False),
        (apart_ns, [0, 0.05, 0, 0, -0.025], True),
        (apart_ns, [0, 0, 0, 0, 2 * np.pi], False),
        (apart_ns - 1, [0.21, 0, 0, 0, 0], False),
        (-apart_ns, [0.21, 0, 0, 0, 0], True),  # the clock was set back
    ):
        assert wants(keyframes, stamp_ns, np.array(pose)) == wanted
    for names, stds in ((("lamp.power",), (STD,)), ((), ())):  # where nothing is to be learnt, none
        space = BiasSpace(Constants(names, stds), HOLD_S)
        assert wants(BiasFit(space, HOLD_S, LINEAR_IN_ALL).prior(), 0, np.zeros(5)) == bool(names)
