"""Search by spectral angle: every peer timed in turns on one table, its answers checked."""

import contextlib
import importlib.util
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import repeat
from typing import Any

import numpy as np

from peers.exact import is_nearest, nearest_exactly
from peers.libraries import NEEDS, OURS, Search
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.signature.features import key_parameters, lifted
from uuv_optical_array.estimation.signature_table import BLOCK_POSES, grid_axes
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene

TURN_S = 0.02  # how long a peer answers queries before it is the next one's turn
BATCH = 1000
BATCH_ANGLES = 100_000_000  # a peer's batch is cut to so many angles; ours never


def one_thread() -> contextlib.AbstractContextManager[Any]:
    """Keep every library to one thread, where that can be said to all of them."""
    if importlib.util.find_spec("threadpoolctl") is None:
        return contextlib.nullcontext()
    for module in NEEDS.values():  # what is not loaded cannot be limited
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1)


def signatures(
    scene: Scene,
    count: int,
    rng: np.random.Generator,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> Array:
    """Draw signatures as a real table holds them: of random poses in the scene's table volume.

    Parameters
    ----------
    scene
        Gives volume, forward model and weights.
    count
        How many, >= 1.
    rng
        Source of the poses.
    progress
        Wraps the loop over blocks.

    Returns
    -------
    Array
        Lifted vectors, shape ``(count, 6)``; poses without a count of light are drawn again.
    """
    model = ForwardModel(scene)
    low, high = np.transpose([axis[[0, -1]] for axis in grid_axes(scene.table)])
    vectors = np.empty((count, 6))
    for start in progress(range(0, count, BLOCK_POSES)):
        part = vectors[start : start + BLOCK_POSES]
        filled = 0
        for _ in range(1000):
            images = model.expected(rng.uniform(low, high, (len(part), 5)))
            images = images[images.max(axis=(1, 2)) >= 1][: len(part) - filled]
            parameters = key_parameters(images, scene.full_scale_counts, scene.signature.peak)
            part[filled : filled + len(images)] = lifted(
                parameters, scene.signature, scene.array.detectors_per_side
            )
            filled += len(images)
            if filled == len(part):
                break
        else:
            raise ValueError(f"scene {scene.name}: hardly a pose of its table has light")
    return vectors


@dataclass
class Answers:
    """What one peer did on one table: times in s, and how many of the checked queries it missed."""

    build_s: float
    query_s: list[float] = field(default_factory=list)
    batch_s: list[float] = field(default_factory=list)  # per query
    batch_queries: int = 0
    checked: int = 0
    missed: int = 0


def compare(
    builders: Mapping[str, Callable[[Array], Search]],
    rows: Array,
    queries: Array,
    rounds: int,
    checks: int = 50,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> dict[str, Answers]:
    """Time peers against each other, in turns, and check their answers against exact ones.

    Parameters
    ----------
    builders
        Peers by name.
    rows
        Finite and not zero, shape ``(m, n)``.
    queries
        Shape ``(q, n)``, q >= 1; a batch repeats them as needed.
    rounds
        How many turns each has.
    checks
        How many queries are answered exactly.
    progress
        Wraps the loop over rounds.

    Returns
    -------
    dict
        By peer. An interrupt leaves what was measured before it.
    """
    searches, results = {}, {}
    for name, build in builders.items():
        start = time.perf_counter()
        searches[name] = build(rows)
        results[name] = Answers(time.perf_counter() - start)
    checked = queries[:checks]
    truths = [nearest_exactly(rows, query) for query in checked]
    for name, search in searches.items():
        found = search(checked)[0].tolist()
        right = map(is_nearest, repeat(rows), checked, found, truths)
        results[name].checked, results[name].missed = len(checked), len(checked) - sum(right)
    batch = np.resize(queries, (BATCH, rows.shape[1]))
    for turn in progress(range(rounds)):
        for name, search in searches.items():
            spent, asked = 0.0, 0
            while spent < TURN_S:
                query = queries[(turn + asked) % len(queries)][None]
                start = time.perf_counter()
                search(query)
                results[name].query_s.append(time.perf_counter() - start)
                spent, asked = spent + results[name].query_s[-1], asked + 1
            if turn % 3 == 0:  # batches are long
                size = BATCH if name == OURS else max(1, min(BATCH, BATCH_ANGLES // len(rows)))
                start = time.perf_counter()
                search(batch[:size])
                results[name].batch_s.append((time.perf_counter() - start) / size)
                results[name].batch_queries = size
    return results


def figures(answers: dict[str, Answers], verdicts: dict[str, dict[str, str]]) -> dict[str, Any]:
    """Return medians, ratios to ours and exactness, by peer."""
    ours = answers[OURS]
    query, batch = np.median(ours.query_s), np.median(ours.batch_s)
    return {
        name: {
            "query_us": float(np.median(each.query_s) * 1e6),
            "ratio": float(np.median(each.query_s) / query),
            "batch_us": float(np.median(each.batch_s) * 1e6),
            "batch_ratio": float(np.median(each.batch_s) / batch),
            "batch_queries": each.batch_queries,
            "build_s": each.build_s,
            "missed": each.missed,
            "checked": each.checked,
            "exact": each.missed == 0
            and all(words.startswith("right") for words in verdicts[name].values()),
        }
        for name, each in answers.items()
    }
