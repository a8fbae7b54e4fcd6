"""Estimates and commands put into a track, and the track that comes of them."""

from dataclasses import replace

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import Estimate, Estimator
from uuv_optical_array.estimation.tracking.track import POSE, Track
from uuv_optical_array.estimation.tracking.tracker import Tracker


def enter(
    tracker: Tracker,
    estimator: Estimator,
    stamp_ns: int,
    estimate: Estimate,
    image: Array | None,
    roll: float = 0.0,
) -> int:
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
    int
        Stamp of the newest frame in the track, ns.

    Raises
    ------
    NoPose
        As `Tracker.update`.
    """
    if estimate.readings is None or image is None:
        lasting = 1 - estimate.clear
        return tracker.take(stamp_ns, estimate.pose, estimate.covariance, lasting=lasting)
    near = estimator.lineariser(estimate, image, roll)
    return tracker.take(stamp_ns, estimate.pose, estimate.covariance, estimate.readings, near)


def tell(tracker: Tracker, stamp_ns: int, linear: Array, angular: Array) -> None:
    """Tell a track how the follower is commanded to move from a stamp on.

    Parameters
    ----------
    tracker
        The one that is told.
    stamp_ns
        Of the command, ns.
    linear, angular
        In the follower's frame, m/s and rad/s, shape ``(3,)`` each; the roll rate is ignored.

    Raises
    ------
    ValueError
        As `Tracker.command`.
    """
    tracker.command(stamp_ns, [*linear, *angular[1:]])


def entered(tracker: Tracker, estimator: Estimator, roll: float = 0.0) -> Track:
    """Return a track at its newest frame, as others are to know it.

    Its covariance has the aim of the array, too: no frame tells anything of that, and so no
    tracker does.

    Parameters
    ----------
    tracker, estimator
        As of `enter`.
    roll
        Of the follower in that frame, rad.
    """
    track = tracker.track()
    joint = track.joint_covariance.copy()
    joint[POSE, POSE] += estimator.aim_covariance(track.pose, roll)
    return replace(track, joint_covariance=joint)
