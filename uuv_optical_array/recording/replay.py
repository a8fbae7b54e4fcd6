"""A recording estimated anew, by the same pipeline as on a vehicle."""

import gc
import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Answer, Pipeline
from uuv_optical_array.estimation.tracking.settings import TrackerSettings

CHUNK_FRAMES = 64  # estimated by one process at a time


def replay(
    images: Array,
    stamps_ns: NDArray[np.int64],
    estimator: Estimator,
    tracking: TrackerSettings | None = None,
    processes: int | None = None,
    commands: Sequence[tuple[int, Array, Array]] = (),
) -> Generator[Answer, None, None]:
    """Yield the answer to each image in order.

    - images: counts, shape ``(m, side, side)``.
    - stamps_ns: ascending, ns, shape ``(m,)``.
    - estimator: takes the roll as 0.
    - tracking: settings of a tracker, which learns constants from each frame, so that images are
      estimated one by one; ``None``: no track, and images are spread over processes.
    - processes: how many at a time, >= 1; ``None``: one for each core that this process may use.
    - commands: as of a `Recording`, for the track.
    """
    pipeline = Pipeline(estimator, tracking)
    if tracking is not None:
        sent = 0
        for image, stamp in zip(images, stamps_ns, strict=True):
            while sent < len(commands) and commands[sent][0] <= stamp:
                pipeline.command(*commands[sent])
                sent += 1
            yield pipeline.answer(int(stamp), image)
        return

    def refused(image: Array) -> str:
        try:
            pipeline.check(image)
        except NoPose as reason:
            return str(reason)
        return ""

    reasons = list(map(refused, images))  # in order: a frozen frame repeats one before it

    def answer(i: int) -> Answer:
        estimate, reason = None, reasons[i]
        if not reason:
            try:
                estimate = estimator.estimate(images[i])
            except NoPose as no_pose:
                reason = str(no_pose)
        return Answer(int(stamps_ns[i]), estimate, None, reason)

    yield from _spread(answer, len(images), processes)


Work = Callable[[int], Answer]
_work: list[Work] = []  # of a process of the pool


def _begin(work: Work) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    gc.freeze()  # ROS nodes that the parent has dropped cannot be ended without its threads
    _work.append(work)


def _do(i: int) -> Answer:
    return _work[0](i)


def _spread(work: Work, count: int, processes: int | None) -> Iterator[Answer]:
    """Yield the answer to each of `count` images, in order, from several processes if it pays."""
    # Not every system says which cores this process may use.
    cores = len(getattr(os, "sched_getaffinity", lambda process: range(os.cpu_count() or 1))(0))
    processes = min(processes or cores, math.ceil(count / CHUNK_FRAMES))
    if processes <= 1:
        yield from map(work, range(count))
        return
    # Forked, a process has images, table and compiled fit from the beginning.
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("fork"), _begin, (work,))
    try:
        yield from pool.map(_do, range(count), chunksize=CHUNK_FRAMES)
    finally:
        pool.shutdown(cancel_futures=True)
