"""A recording estimated anew, by the checks and in the order of the feature and estimator nodes."""

import gc
import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import Estimate, Estimator
from uuv_optical_array.estimation.pipeline import Frame, Pipeline, estimated, shown
from uuv_optical_array.estimation.signature.plausibility import FrozenFrames
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel

CHUNK_FRAMES = 64  # estimated by one process at a time


def replay(
    images: Array,
    stamps_ns: NDArray[np.int64],
    estimator: Estimator,
    tracker: Tracker | None = None,
    processes: int | None = None,
    commands: Sequence[tuple[int, Array, Array]] = (),
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
    commands
        As of a `Recording`, for the track.

    Yields
    ------
    Frame
        One for each image, as soon as it is there.
    """
    if tracker is not None:
        frames, told = Pipeline(estimator, tracker), 0
        for image, stamp in zip(images, stamps_ns, strict=True):
            while told < len(commands) and commands[told][0] <= stamp:
                frames.command(*commands[told])
                told += 1
            yield frames.answer(int(stamp), image)
        return
    frozen = FrozenFrames(ForwardModel(estimator.scene))
    signatures = list(shown(images, estimator, frozen))

    def of_chunk(chunk: int) -> list[Estimate | str]:
        rows = range(chunk * CHUNK_FRAMES, min((chunk + 1) * CHUNK_FRAMES, len(images)))
        return [estimated(estimator, images[i], *signatures[i]) for i in rows]

    answers = _spread(of_chunk, math.ceil(len(images) / CHUNK_FRAMES), processes)
    each = (answer for chunk in answers for answer in chunk)
    for stamp, (parameters, _), answer in zip(stamps_ns, signatures, each, strict=True):
        said = (None, None, answer) if isinstance(answer, str) else (answer, None, "")
        yield Frame(int(stamp), parameters, *said)


Work = Callable[[int], list[Estimate | str]]
_work: list[Work] = []  # of a process of the pool


def _begin(work: Work) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    gc.freeze()  # ROS nodes that the parent has dropped cannot be ended without its threads
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
