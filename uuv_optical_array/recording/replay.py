"""Estimates of a recording, by the same pipeline as on a vehicle."""

from collections.abc import Generator, Sequence

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.processes import spread
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

    yield from spread(answer, len(images), processes, CHUNK_FRAMES)
