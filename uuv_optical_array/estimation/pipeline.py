"""An image through all stages, the same on a vehicle, in a replay and in a study."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.errors import NoPose, expect
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import Estimate, Estimator
from uuv_optical_array.estimation.signature.daylight import Daylight
from uuv_optical_array.estimation.signature.features import FeatureSettings, no_pattern
from uuv_optical_array.estimation.signature.plausibility import FrozenFrames
from uuv_optical_array.estimation.tracking.doubted_detectors import DoubtedDetectors
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import POSE, Track
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel

DEFAULT_TRACKING = TrackerSettings()


class Answer(NamedTuple):
    """What comes of one image.

    - stamp_ns: of the image, ns.
    - estimate: the pose of this image by itself; ``None`` where there is none.
    - track: the track with it; ``None`` where there is no pose, or no tracker.
    - reason: why there is no pose; empty where there is one.
    """

    stamp_ns: int
    estimate: Estimate | None
    track: Track | None
    reason: str


class Pipeline:
    """Answer images as they come, each with what the track has learnt by then.

    `answer` does all of it. A node calls `estimate`, publishes the pose, and then calls `track`.

    Parameters
    ----------
    estimator
        Of the scene.
    tracking
        Settings of the tracker, which learns the scene's unknown constants; ``None``: no tracker.
    min_peak_counts
        As of `FeatureSettings`.

    Attributes
    ----------
    estimator : Estimator
        The one in use; another one of the same scene may take its place between two images.
    tracker : Tracker or None
        Takes every frame that has a pose.
    least_counts : float
        Peak below which an image shows no light.
    """

    def __init__(
        self,
        estimator: Estimator,
        tracking: TrackerSettings | None = DEFAULT_TRACKING,
        min_peak_counts: float = FeatureSettings.min_peak_counts,
    ) -> None:
        expect(estimator, Estimator, "estimator", "Estimator(scene)")
        self.least_counts = min_peak_counts + estimator.scene.black_counts
        model = ForwardModel(estimator.scene)
        self._frozen, self._daylight = FrozenFrames(model), Daylight(model)
        self.estimator = estimator
        self.track_with(tracking)

    def track_with(self, tracking: TrackerSettings | None) -> None:
        """Begin a new track with these settings, or do without one."""
        constants = self.estimator.constants
        self.tracker = None if tracking is None else Tracker(tracking, constants=constants)
        self._doubted = DoubtedDetectors()

    def command(self, stamp_ns: int, linear: Array, angular: Array) -> None:
        """Tell the tracker how the follower is commanded to move from a stamp on, ns.

        In its frame, m/s and rad/s, ``(3,)`` each; roll rate ignored. Errors of `Tracker.command`.
        """
        if self.tracker is not None:
            self.tracker.command(stamp_ns, [*linear, *angular[1:]])

    def range(self, stamp_ns: int, range_m: float, std_m: float) -> None:
        """Tell the tracker a range from elsewhere; arguments and errors of `Tracker.range`."""
        if self.tracker is not None:
            self.tracker.range(stamp_ns, range_m, std_m)

    def lit(self, image: Array) -> bool:
        """Say whether an image, ``(side, side)``, shows light, with a pose or without."""
        return bool(image.max() >= self.least_counts) and not self._daylight.explains(image)

    def check(self, image: Array) -> None:
        """Raise NoPose for an image, ``(side, side)``, without a lamp or the same as before."""
        self.estimator.check_shape(image)
        if reason := no_pattern(image, self.least_counts):
            raise NoPose(reason)
        self._frozen.check(image, lambda: np.asarray(image))

    def estimate(
        self, stamp_ns: int, image: Array | None, parameters: Array | None = None, roll: float = 0.0
    ) -> Estimate:
        """Return the pose of the next frame, which the tracker has taken and found no outlier.

        Parameters
        ----------
        stamp_ns
            Of the image, ns.
        image
            Counts, shape ``(side, side)``; ``None``: a match of the key parameters does without.
        parameters
            Its key parameters, shape ``(5,)``; ``None``: worked out from the image.
        roll
            Of the follower, rad.

        Raises
        ------
        NoPose
            As `check`, `Estimator.estimate` and `Tracker.take`, and for a late frame: it enters the
            track, whose newer pose is published.
        """
        if image is not None:
            self.check(image)
        uneven = None if self.tracker is None else self.tracker.uneven(stamp_ns)
        estimate = self.estimator.estimate(image, parameters, roll, uneven)
        if image is None:
            assert parameters is not None
            self._frozen.check(
                parameters, lambda: self._frozen.profiles(estimate.pose, roll, parameters)
            )
        if self.tracker is not None:
            frame = stamp_ns, estimate.pose, estimate.covariance
            if image is None or estimate.readings is None or estimate.believed is None:
                newest = self.tracker.take(*frame, shaded=1 - estimate.clear)
            else:
                trust = self._doubted.trust(stamp_ns, estimate.believed)
                used = estimate._replace(believed=trust * estimate.believed)
                near = self.estimator.lineariser(used, image, roll)
                readings = None if estimate.bent else estimate.readings.believed(trust)
                newest = self.tracker.take(*frame, readings, near)
            if newest != stamp_ns:
                raise NoPose("late frame: the track used it, but a newer pose was published")
        return estimate

    def track(self, roll: float = 0.0) -> Track | None:
        """Return the track at its newest frame, in which the follower had a roll, rad.

        Its covariance includes the aim of lamp and array, which no frame shows.
        """
        if self.tracker is None:
            return None
        track = self.tracker.track()
        joint = track.joint_covariance.copy()
        joint[POSE, POSE] += self.estimator.aim_covariance(track.pose, roll)
        return replace(track, joint_covariance=joint)

    def answer(self, stamp_ns: int, image: Array, roll: float = 0.0) -> Answer:
        """Answer the next image, counts, ``(side, side)``, by its stamp, ns, and a roll, rad."""
        try:
            estimate = self.estimate(stamp_ns, image, roll=roll)
        except NoPose as reason:
            return Answer(stamp_ns, None, None, str(reason))
        return Answer(stamp_ns, estimate, self.track(roll + estimate.roll), "")
