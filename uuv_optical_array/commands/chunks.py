"""What the commands that work in chunks have in common: their options, and the work itself."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from tqdm import tqdm

from uuv_optical_array.core.cluster import on_cluster, on_threads, threads_within


class ChunkStore(Protocol):
    """What is filled chunk by chunk; sent to workers as it is."""

    @property
    def chunks(self) -> range:
        """The numbers of the chunks."""

    def thread_bytes(self) -> int:
        """Return what a thread that computes chunks holds, bytes."""

    def present(self) -> list[int]:
        """Return the chunks that are there."""

    def fill(self, chunk: int) -> int:
        """Make sure that a chunk is there."""


def add_chunks(parser: argparse.ArgumentParser, title: str) -> None:
    """Add the options that say where chunks are worked out."""
    chunks = parser.add_argument_group(title)
    chunks.add_argument("--threads", type=int, help="threads of this machine (default: all cores)")
    chunks.add_argument("--memory", help="what this process may take, such as 2GB")
    chunks.add_argument("--scheduler", metavar="ADDRESS", help="scheduler of a Dask cluster")


def check_chunks(options: argparse.Namespace) -> None:
    """Refuse options of `add_chunks` that contradict each other, by ValueError."""
    if options.scheduler and (options.memory or options.threads):
        raise ValueError(
            "scheduler: its workers have limits of their own; give them to dask worker as "
            "--memory-limit and --nthreads"
        )
    if options.threads is not None and options.threads < 1:
        raise ValueError(f"threads: {options.threads}; give at least 1")


def fill_chunks(
    store: ChunkStore,
    output: Path,
    options: argparse.Namespace,
    tell: Callable[[str], None] = print,
) -> list[int] | None:
    """Work out the chunks of a store that are missing, and show progress.

    Parameters
    ----------
    store
        What is filled.
    output
        Its folder, as it is called in messages.
    options
        Those of `add_chunks`, checked.
    tell
        Takes messages.

    Returns
    -------
    list of int or None
        What `fill` returned of each chunk; ``None`` after Ctrl-C, which was told.
    """
    chunks, before = store.chunks, len(store.present())
    if before:
        tell(f"{output}: {before} of {len(chunks)} chunks are there already")
    try:
        with tqdm(total=len(chunks), unit="chunk") as shown:
            need = store.thread_bytes()
            if options.scheduler:
                return on_cluster(store.fill, chunks, options.scheduler, need, shown.update)
            threads = threads_within(options.memory, need, options.threads)
            return on_threads(store.fill, chunks, threads, shown.update)
    except KeyboardInterrupt:
        tell(
            f"interrupted: {len(store.present())} of {len(chunks)} chunks are in {output}; "
            "the same command goes on from there"
        )
        return None
