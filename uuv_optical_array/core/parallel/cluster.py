"""Work in numbered chunks through Dask: on this machine's threads, or on a cluster."""

import os
import resource
from collections.abc import Callable, Sequence

from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.storage.memory import gigabytes

Work = Callable[[int], int]
Tick = Callable[[], object]

WORKER_BYTES = 250_000_000  # a process with the package, before it works
WAIT_S = 30.0
BATCH = 256  # chunks in one graph
RETRIES = 2  # of a chunk that fails on a worker that lives, as a shared disk may


def threads_within(memory: str | None, thread_bytes: int, threads: int | None = None) -> int:
    """Return how many threads to use.

    Parameters
    ----------
    memory
        What the whole process may take, such as ``2GB``; ``None``: anything.
    thread_bytes
        What each thread takes.
    threads
        The most to use; ``None``: one a core.

    Raises
    ------
    ValueError
        Where not even one thread has room.
    """
    wanted = threads or os.cpu_count() or 1
    if memory is None:
        return wanted
    sizes = needs("cluster", "dask.utils")
    try:
        budget = sizes.parse_bytes(memory)
    except (ValueError, KeyError):
        raise ValueError(f"memory: {memory!r} is no size; give one such as 2GB") from None
    for module in ("dask", "dask.threaded", "zarr"):  # what is imported later counts too
        needs("cluster", module)
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    if base + thread_bytes > budget:
        raise ValueError(
            f"memory: {gigabytes(budget)} is too little; one thread needs "
            f"{gigabytes(base + thread_bytes + 5e7)}"
        )
    return min(wanted, int((budget - base) // thread_bytes))


def on_threads(work: Work, chunks: Sequence[int], threads: int, tick: Tick) -> list[int]:
    """Do the chunks on threads of this process.

    Parameters
    ----------
    work
        Does one chunk, by its number.
    chunks
        The numbers.
    threads
        How many at a time, >= 1.
    tick
        Called as each is done.

    Returns
    -------
    list of int
        What `work` returned, in order.
    """
    dask = needs("cluster", "dask")
    done: list[int] = []
    with needs("cluster", "dask.callbacks").Callback(posttask=lambda *_: tick()):
        # A graph of very many chunks would take longer to plan than to begin.
        for start in range(0, len(chunks), BATCH):
            tasks = [dask.delayed(work, pure=False)(i) for i in chunks[start : start + BATCH]]
            done += dask.compute(*tasks, scheduler="threads", num_workers=threads)
    return done


def on_cluster(
    work: Work, chunks: Sequence[int], address: str, thread_bytes: int, tick: Tick
) -> list[int]:
    """Do the chunks on the workers of a Dask scheduler; what a dead worker had is done by another.

    Parameters
    ----------
    work, chunks, tick
        As in `on_threads`.
    address
        Of the scheduler, such as ``tcp://127.0.0.1:8786``.
    thread_bytes
        What each thread of a worker takes.

    Returns
    -------
    list of int
        What `work` returned, in order.

    Raises
    ------
    ValueError
        Where the scheduler has no workers, or one of them too little memory.
    """
    distributed = needs("cluster", "distributed")
    with distributed.Client(address, timeout=WAIT_S) as client:
        try:
            client.wait_for_workers(1, timeout=WAIT_S)
        except TimeoutError:
            none = f"scheduler {address}: no workers; start some with dask worker {address}"
            raise ValueError(none) from None
        for name, worker in client.scheduler_info(n_workers=-1)["workers"].items():
            need = WORKER_BYTES + worker["nthreads"] * thread_bytes
            if 0 < worker["memory_limit"] < need:
                raise ValueError(
                    f"worker {name}: a memory limit of {gigabytes(worker['memory_limit'])}, and "
                    f"its threads ({worker['nthreads']}) need {gigabytes(need)}; start it with "
                    "more --memory-limit or fewer --nthreads"
                )
        futures = client.map(work, chunks, pure=False, retries=RETRIES)
        try:
            for future in distributed.as_completed(futures):
                if future.status == "error":
                    future.result()
                tick()
            return [int(count) for count in client.gather(futures)]
        except BaseException:
            client.cancel(futures, force=True)
            raise
