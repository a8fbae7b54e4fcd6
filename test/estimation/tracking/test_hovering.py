"""At one place nothing is to be learnt, however long a track lasts: noise adds up to no range."""

import numpy as np
from fits import writer_of_fits

from uuv_optical_array.estimation.information.linearised import Lineariser
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.estimation.unknowns.constants import constants_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

FRAMES, STEP_NS = 300, 10**8
AT = np.array([-4.2, 0.0, 0.0, 0.0, 0.0])
NEAR = np.diag(1 / np.square([3.0, 1.0, 1.0, 0.5, 0.5]))  # of a pose that is hardly known


def fitted(lineariser, image, constants):
    """Return the pose that fits an image best by Gauss and Newton, and its covariance."""
    at = np.concatenate([AT, np.zeros(constants)])
    for _ in range(2):
        near = lineariser(image, at)
        white = 1 / np.sqrt(near.variances)
        slopes = white[:, None] * near.slopes[:, :5]
        covariance = np.linalg.inv(slopes.T @ slopes + NEAR)
        at[:5] += covariance @ (slopes.T @ (white * near.residuals) - NEAR @ (at[:5] - AT))
    return at[:5], covariance, lineariser(image, at)


def test_half_a_minute_at_one_place_moves_no_range_and_makes_no_gradient_known():
    """Without noise by the place gradients were known to 0.57 of their prior by then."""
    model, rng = ForwardModel(load_scene("follow")), np.random.default_rng(1)
    constants = constants_of(model)
    lineariser = Lineariser(model, constants.names, writer_of_fits())
    light = model.light(AT, 0.0)
    tracker = Tracker(TrackerSettings(), constants)
    for k in range(FRAMES):
        image = model.read(light, rng)
        pose, covariance, readings = fitted(lineariser, image, len(constants.names))
        tracker.take(
            (k + 1) * STEP_NS,
            pose,
            covariance,
            readings,
            lambda at, image=image: lineariser(image, at),
        )
    track = tracker.track()
    assert abs(track.pose[0] - AT[0]) < 0.02
    assert track.covariance[0, 0] ** 0.5 > 0.14
    # From one place light from aside looks as a turn of the array.
    prior = dict(zip(constants.names, constants.stds, strict=True))
    for name in ("ambient.to_starboard_counts", "ambient.to_bottom_counts"):
        assert track.constants[name].std > 0.85 * prior[name]
