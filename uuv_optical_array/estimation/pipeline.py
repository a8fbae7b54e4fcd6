"""An image through all stages, as the nodes have them: checks, key parameters, pose, track."""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import Estimate, Estimator
from uuv_optical_array.estimation.signature.features import (
    FeatureSettings,
    key_parameters,
    no_pattern,
)
from uuv_optical_array.estimation.signature.plausibility import FrozenFrames, check_full_scale
from uuv_optical_array.estimation.tracking.enter import enter, entered, tell
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Track
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.estimation.unknowns.constants import Expected
from uuv_optical_array.forward.model import ForwardModel


class Frame(NamedTuple):
    """What is said of one image.

    Parameters
    ----------
    stamp_ns
        Of the image, ns.
    parameters
        Key parameters, shape ``(5,)``; ``None`` where the image shows no lamp.
    estimate
        The pose of this image by itself; ``None`` where there is none.
    track
        The track with it; ``None`` where there is none or none is wanted.
    reason
        Why there is no pose; empty where there is one.
    """

    stamp_ns: int
    parameters: Array | None
    estimate: Estimate | None
    track: Track | None
    reason: str


class Pipeline:
    """Estimate images as they come, each with what the track has learnt by then.

    Parameters
    ----------
    estimator
        Of the scene.
    tracker
        Gets every frame that has a pose; ``None``: one with the default settings, which learns the
        scene's unknown constants.

    Attributes
    ----------
    estimator : Estimator
        May be replaced by another one of the same scene.
    """

    def __init__(self, estimator: Estimator, tracker: Tracker | None = None) -> None:
        self.estimator = estimator
        self._tracker = tracker or Tracker(TrackerSettings(), constants=estimator.constants)
        self._frozen = FrozenFrames(ForwardModel(estimator.scene))

    def command(self, stamp_ns: int, linear: Array, angular: Array) -> None:
        """Tell the track how the follower is commanded to move from a stamp on, as `tell` does."""
        tell(self._tracker, stamp_ns, linear, angular)

    def answer(self, stamp_ns: int, image: Array) -> Frame:
        """Return what is said of the next image.

        Parameters
        ----------
        stamp_ns
            Of the image, ns.
        image
            Counts, shape ``(side, side)``; the roll of the follower is taken as 0.
        """
        ((parameters, why_not),) = shown(image[None], self.estimator, self._frozen)
        expected = self._tracker.expected(stamp_ns)
        answer = estimated(self.estimator, image, parameters, why_not, expected)
        if isinstance(answer, str):
            return Frame(stamp_ns, parameters, None, None, answer)
        try:
            enter(self._tracker, self.estimator, stamp_ns, answer, image)
        except NoPose as no_pose:
            return Frame(stamp_ns, parameters, None, None, str(no_pose))
        track = entered(self._tracker, self.estimator)
        return Frame(stamp_ns, parameters, answer, track, "")


def shown(
    images: Array, estimator: Estimator, frozen: FrozenFrames
) -> Iterator[tuple[Array | None, str]]:
    """Yield the key parameters of each image, or why it shows no lamp."""
    scene = estimator.scene
    lowest = FeatureSettings.min_peak_counts
    dark = [no_pattern(image, lowest) or "" for image in images]
    parameters = key_parameters(images, scene.full_scale_counts, scene.signature.peak)
    for image, of_image, why_not in zip(images, parameters, dark, strict=True):
        try:
            check_full_scale(image, scene)
            if why_not:
                raise NoPose(why_not)
            frozen.check(image, partial(np.asarray, image))
        except NoPose as reason:
            yield None, str(reason)
            continue
        yield of_image, ""


def estimated(
    estimator: Estimator,
    image: Array,
    parameters: Array | None,
    reason: str,
    expected: Expected | None = None,
) -> Estimate | str:
    """Return the pose of an image, or why there is none."""
    if parameters is None:
        return reason
    try:
        return estimator.estimate(image, parameters, 0.0, expected)
    except NoPose as no_pose:
        return str(no_pose)
