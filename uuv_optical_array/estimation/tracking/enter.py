"""An estimate put into the track."""

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import Estimate, Estimator
from uuv_optical_array.estimation.tracking.track import Track
from uuv_optical_array.estimation.tracking.tracker import Tracker


def enter(
    tracker: Tracker,
    estimator: Estimator,
    stamp_ns: int,
    estimate: Estimate,
    image: Array | None,
    roll: float = 0.0,
) -> Track:
    """Put a frame into a track, by its readings where these are as good as linear.

    Parameters
    ----------
    tracker, estimator
        Both of one scene.
    stamp_ns
        Of the image, ns.
    estimate
        What `estimator` made of the image.
    image, roll
        As it was given them.

    Returns
    -------
    Track
        The track with the frame.

    Raises
    ------
    NoPose
        As `Tracker.update`.
    """
    if estimate.best is None or image is None:
        lasting = 1 - estimate.clear
        return tracker.update(stamp_ns, estimate.pose, estimate.covariance, lasting=lasting)
    near = estimator.lineariser(estimate, image, roll)
    return tracker.update(stamp_ns, estimate.pose, estimate.covariance, near(estimate.best), near)
