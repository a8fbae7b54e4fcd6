"""Work that is spread over processes of this program."""

import gc
import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")
_work: list[Callable[[int], Any]] = []  # of a process of the pool


def spread(
    work: Callable[[int], T], count: int, processes: int | None = None, chunk: int = 1
) -> Generator[T, None, None]:
    """Yield the results of ``work(0)`` to ``work(count - 1)``, in order.

    It is done in several processes where it pays, at most one for each `chunk` of them, which one
    process does at a time; `processes`, >= 1, is how many at most, ``None``: one for each core that
    this process may use. What the work remembers is lost with them.
    """
    # Not every system says which cores this process may use.
    cores = len(getattr(os, "sched_getaffinity", lambda process: range(os.cpu_count() or 1))(0))
    processes = min(processes or cores, math.ceil(count / chunk))
    if processes <= 1:
        yield from map(work, range(count))
        return
    # Forked, a process has all that the work refers to, and the compiled fit, from the beginning.
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("fork"), _begin, (work,))
    try:
        yield from pool.map(_do, range(count), chunksize=chunk)
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(work: Callable[[int], Any]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    gc.freeze()  # ROS nodes that the parent has dropped cannot be ended without its threads
    _work.append(work)


def _do(i: int) -> Any:
    return _work[0](i)
