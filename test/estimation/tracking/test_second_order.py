"""What is not linear over a belief: of quadratic functions, of images, of straight coordinates."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uuv_optical_array.estimation.information.linearised import LinearisedReadings, Lineariser
from uuv_optical_array.estimation.tracking.belief import BiasSpace
from uuv_optical_array.estimation.tracking.correction import Correction
from uuv_optical_array.estimation.tracking.second_order import second_order
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.estimation.unknowns.coordinates import frame_of
from uuv_optical_array.estimation.unknowns.joint_coordinates import JointCoordinates
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

SECOND_NS = 10**9
SIGNS = tuple(itertools.product((1, -1), repeat=2))
WIDE = np.diag(np.square([50.0, 50.0, 50.0, 5.0, 5.0]))


def spread(rng, count):
    """Return a random covariance."""
    root = rng.standard_normal((count, count))
    return root @ root.T


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 6))
def test_of_a_quadratic_function_it_is_what_the_moments_of_a_gaussian_are(seed, numbers, places):
    """The mean of x'Hx/2 is tr(HP)/2, and the covariance of two of them is tr(HPGP)/2."""
    rng = np.random.default_rng(seed)
    bends = rng.standard_normal((numbers, places, places))
    bends = bends + bends.transpose(0, 2, 1)
    slopes, mean = rng.standard_normal((numbers, places)), rng.standard_normal(places)
    covariance = spread(rng, places)
    found = second_order(lambda x: slopes + bends @ (x - mean), mean, covariance)
    by = bends @ covariance
    np.testing.assert_allclose(
        found.shift, np.trace(by, axis1=1, axis2=2) / 2, rtol=1e-9, atol=1e-9
    )
    expected = np.einsum("kij,lji->kl", by, by) / 2
    atol = 1e-9 * np.abs(expected).max()
    np.testing.assert_allclose(found.modes @ found.modes.T, expected, rtol=1e-9, atol=atol)


def test_images_that_bend_over_all_that_is_known_make_a_track_no_surer_than_it_is():
    """Without the second order the squared errors are dozens of times those expected."""
    rng, pose = np.random.default_rng(1), np.array([-6.0, 0.1, 0.2, 0.05, -0.05])
    std, count, draws = 0.3, 9, 300
    slopes = 2 * rng.standard_normal((count, 5))
    bends = 15 * rng.standard_normal((count, 5, 5))
    bends = bends + bends.transpose(0, 2, 1)
    squares, errors = [], []
    for _ in range(draws):
        true = pose + std * rng.standard_normal(5)
        off = true - pose
        reading = slopes @ off + 0.5 * (bends @ off) @ off + rng.standard_normal(count)

        def near(at, reading=reading):
            x = at[:5] - pose
            light = slopes @ x + 0.5 * (bends @ x) @ x
            return LinearisedReadings(
                at, reading - light, slopes + bends @ x, np.zeros(count), np.ones(count)
            )

        tracker = Tracker(TrackerSettings(gate_probability=1.0), Constants())
        known = LinearisedReadings(
            pose, np.zeros(count), np.eye(count, 5) / std, np.zeros(count), np.ones(count)
        )
        tracker.take(SECOND_NS, pose, std**2 * np.eye(5), known)
        track = tracker.update(SECOND_NS + 1, pose, WIDE, None, near)
        error = track.pose - true
        errors.append(error)
        squares.append(error @ np.linalg.solve(track.covariance, error))
    assert (np.abs(np.mean(errors, axis=0)) < 5 * np.std(errors, axis=0) / math.sqrt(draws)).all()
    # Of 5, with the deviation of a mean of so many chi-squares of 5.
    assert np.mean(squares) < 5 + 5 * math.sqrt(10 / draws)


def test_a_pose_is_as_uncertain_as_straight_coordinates_bend_but_along_a_range():
    """Second derivatives by differences of poses, of which four corners of a square have one."""
    constants = Constants(frame=frame_of(ForwardModel(load_scene("follow"))))
    coordinates, space = JointCoordinates(constants.frame, ()), BiasSpace(constants, 3600.0)
    correction = Correction(space, constants, TrackerSettings(), math.inf)
    pose, stds = np.array([-6.0, 0.3, -0.4, 0.1, 0.2]), np.array([0.02, 0.02, 0.01, 0.02, 0.02])
    at, by = coordinates.of(pose)
    covariance = by @ np.diag(stds**2) @ by.T
    belief = space.begun(np.zeros(10), np.eye(10))
    belief.mean[:5], belief.covariance[:5, :5] = pose, covariance
    expected: np.ndarray = np.zeros((5, 5))
    for one, other in itertools.product(np.diag(stds), repeat=2):
        corners = [coordinates.place(at + a * one + b * other)[0] * a * b for a, b in SIGNS]
        expected += np.outer(sum(corners), sum(corners)) / 16 / 2
    found = correction.bent_covariance(belief, 100 * SECOND_NS)
    np.testing.assert_allclose(found, expected, atol=0.01 * np.abs(expected).max())
    ranged = belief._replace(ranged_ns=99 * SECOND_NS)
    sight, left = pose[:3] / np.linalg.norm(pose[:3]), correction.bent_covariance
    assert sight @ found[:3, :3] @ sight > 0.01 * np.trace(found)
    assert sight @ left(ranged, 100 * SECOND_NS)[:3, :3] @ sight == pytest.approx(0, abs=1e-15)
    np.testing.assert_allclose(left(ranged, 200 * SECOND_NS), found)


def test_a_track_of_poses_is_gaussian_in_them_and_not_in_straight_coordinates():
    model, pose = ForwardModel(load_scene("follow")), np.array([-6.0, 0.3, -0.4, 0.1, 0.2])
    covariance = np.diag([0.5, 0.1, 0.1, 0.04, 0.04])
    tracker = Tracker(TrackerSettings(), Constants(frame=frame_of(model)))
    track = tracker.update(SECOND_NS, pose, covariance, None, Lineariser(model, ()))
    np.testing.assert_allclose(track.covariance, covariance, rtol=1e-9, atol=1e-12)
