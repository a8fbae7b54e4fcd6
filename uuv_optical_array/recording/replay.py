"""A recording estimated anew, by the checks and in the order of the feature and estimator nodes."""

import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import Estimate, Estimator
from uuv_optical_array.estimation.signature.features import (
    FeatureSettings,
    key_parameters,
    no_pattern,
)
from uuv_optical_array.estimation.signature.plausibility import FrozenFrames, check_full_scale
from uuv_optical_array.estimation.tracking.enter import enter
from uuv_optical_array.estimation.tracking.track import Track
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel

CHUNK_FRAMES = 64  # estimated by one process at a time


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


def replay(
    images: Array,
    stamps_ns: NDArray[np.int64],
    estimator: Estimator,
    tracker: Tracker | None = None,
    processes: int | None = None,
) -> Generator[Frame, None, None]:
    """Estimate images in order; those behind each other only where a track is wanted.

    Parameters
    ----------
    images
        Counts, shape ``(m, side, side)``.
    stamps_ns
        Ascending, ns, shape ``(m,)``.
    estimator
        Takes the roll as 0.
    tracker
        Takes each frame and tells the next what it learnt of the constants, so that one comes after
        the other; ``None``: no track, and images are spread over processes.
    processes
        How many at a time, >= 1; ``None``: one a core.

    Yields
    ------
    Frame
        One for each image, as soon as it is there.
    """
    if tracker is not None:
        frames = FrameByFrame(estimator, tracker)
        for image, stamp in zip(images, stamps_ns, strict=True):
            yield frames.answer(int(stamp), image)
        return
    shown = list(_shown(images, estimator, FrozenFrames(ForwardModel(estimator.table.scene))))

    def of_chunk(chunk: int) -> list[Estimate | str]:
        rows = range(chunk * CHUNK_FRAMES, min((chunk + 1) * CHUNK_FRAMES, len(images)))
        return [_estimated(estimator, images[i], *shown[i]) for i in rows]

    answers = _spread(of_chunk, math.ceil(len(images) / CHUNK_FRAMES), processes)
    each = (answer for chunk in answers for answer in chunk)
    for stamp, (parameters, _), answer in zip(stamps_ns, shown, each, strict=True):
        said = (None, None, answer) if isinstance(answer, str) else (answer, None, "")
        yield Frame(int(stamp), parameters, *said)


class FrameByFrame:
    """Estimates images as they come, each with what the track has learnt by then.

    Parameters
    ----------
    estimator
        Takes the roll as 0.
    tracker
        Gets every frame that has a pose.
    """

    def __init__(self, estimator: Estimator, tracker: Tracker) -> None:
        self._estimator, self._tracker = estimator, tracker
        self._frozen = FrozenFrames(ForwardModel(estimator.table.scene))

    def answer(self, stamp_ns: int, image: Array) -> Frame:
        """Return what is said of the next image.

        Parameters
        ----------
        stamp_ns
            Of the image, ns.
        image
            Counts, shape ``(side, side)``.
        """
        ((parameters, why_not),) = _shown(image[None], self._estimator, self._frozen)
        known = self._tracker.constants(stamp_ns)
        answer = _estimated(self._estimator, image, parameters, why_not, known)
        if isinstance(answer, str):
            return Frame(stamp_ns, parameters, None, None, answer)
        try:
            track = enter(self._tracker, self._estimator, stamp_ns, answer, image)
        except NoPose as no_pose:
            return Frame(stamp_ns, parameters, None, None, str(no_pose))
        return Frame(stamp_ns, parameters, answer, track, "")


def _shown(
    images: Array, estimator: Estimator, frozen: FrozenFrames
) -> Iterator[tuple[Array | None, str]]:
    """Yield the key parameters of each image, or why it shows no lamp."""
    scene = estimator.table.scene
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


def _estimated(
    estimator: Estimator,
    image: Array,
    parameters: Array | None,
    reason: str,
    constants: tuple[Array, Array] | None = None,
) -> Estimate | str:
    """Return the pose of an image, or why there is none."""
    if parameters is None:
        return reason
    try:
        return estimator.estimate(image, parameters, 0.0, constants)
    except NoPose as no_pose:
        return str(no_pose)


Work = Callable[[int], list[Estimate | str]]
_work: list[Work] = []  # of a process of the pool


def _begin(work: Work) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    _work.append(work)


def _do(chunk: int) -> list[Estimate | str]:
    return _work[0](chunk)


def _spread(work: Work, chunks: int, processes: int | None) -> Iterator[list[Estimate | str]]:
    """Yield what each chunk gives, in order, from processes where there are several of both."""
    processes = min(processes or os.cpu_count() or 1, chunks)
    if processes <= 1:
        yield from map(work, range(chunks))
        return
    # Forked, a process has images, table and compiled fit from the beginning.
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("fork"), _begin, (work,))
    try:
        yield from pool.map(_do, range(chunks))
    finally:
        pool.shutdown(cancel_futures=True)
