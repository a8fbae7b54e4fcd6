"""What else answers our questions, and what the exact answer is: SAM search by other libraries.

Each peer is called as its manual says. None of them names its answer's angle by a stable formula,
so cosines become angles by arccos, as their users would do.
"""

import importlib.util
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import repeat
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.features import key_parameters, lifted
from uuv_optical_array.estimation.spectral_angle import SpectralIndex, spectral_angle
from uuv_optical_array.estimation.table.signature_table import BLOCK_POSES, grid_axes
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene

# Of queries (q, n): the nearest row of each, and its angle in rad.
Search: TypeAlias = Callable[[Array], tuple[NDArray[np.intp], Array]]

OURS = "uuv_optical_array"
# Module that a peer needs besides NumPy and SciPy.
NEEDS = {"spectral": "spectral", "scikit-learn": "sklearn", "faiss": "faiss"}
ANGLES_AT_ONCE = 25_000_000  # 200 MB: queries beyond it go to a peer in parts
TURN_S = 0.02  # how long a peer answers queries before it is the next one's turn
BATCH = 1000
BATCH_ANGLES = 100_000_000  # a peer's batch is cut to so many angles; ours never
ROUNDING_RAD = 2e-15  # rows whose angles differ by less are equally near to float64 unit vectors


def _angles(cosines: Array) -> Array:
    return np.arccos(np.clip(cosines, -1, 1))


def _in_parts(nearest: Search, rows: int) -> Search:
    size = max(1, ANGLES_AT_ONCE // rows)

    def search(queries: Array) -> tuple[NDArray[np.intp], Array]:
        parts = [nearest(queries[i : i + size]) for i in range(0, len(queries), size)]
        found, angles = zip(*parts, strict=True)
        return np.concatenate(found), np.concatenate(angles)

    return search


def _ours(rows: Array) -> Search:
    index = SpectralIndex(rows)

    def search(queries: Array) -> tuple[NDArray[np.intp], Array]:
        angles, found = index.nearest(queries[0] if len(queries) == 1 else queries)
        return found.reshape(-1), angles.reshape(-1)

    return search


def _spectral(rows: Array) -> Search:
    from spectral import spectral_angles

    def search(queries: Array) -> tuple[NDArray[np.intp], Array]:
        angles = spectral_angles(rows[:, None], queries)[:, 0]
        return angles.argmin(axis=0), angles.min(axis=0)

    return _in_parts(search, len(rows))


def _scikit_learn(rows: Array) -> Search:
    from sklearn import config_context
    from sklearn.neighbors import NearestNeighbors

    model = NearestNeighbors(n_neighbors=1, metric="cosine", algorithm="brute").fit(rows)

    def search(queries: Array) -> tuple[NDArray[np.intp], Array]:
        with config_context(working_memory=ANGLES_AT_ONCE * 8 >> 20):  # MiB; it cuts by itself
            distance, found = model.kneighbors(queries)
        return found[:, 0], _angles(1 - distance[:, 0])

    return search


def _scipy(rows: Array) -> Search:
    def search(queries: Array) -> tuple[NDArray[np.intp], Array]:
        distance = cdist(queries, rows, "cosine")
        return distance.argmin(axis=1), _angles(1 - distance.min(axis=1))

    return _in_parts(search, len(rows))


def _numpy(rows: Array) -> Search:
    units = rows / np.linalg.norm(rows, axis=1, keepdims=True)

    def search(queries: Array) -> tuple[NDArray[np.intp], Array]:
        units_too = queries / np.linalg.norm(queries, axis=1, keepdims=True)
        # A product with one vector is several times faster than with a matrix of one column.
        product = (units @ units_too[0])[None] if len(queries) == 1 else units_too @ units.T
        found = product.argmax(axis=1)
        return found, _angles(product[np.arange(len(found)), found])

    return _in_parts(search, len(rows))


def _faiss(rows: Array) -> Search:
    import faiss

    units = rows.astype(np.float32)
    faiss.normalize_L2(units)
    index = faiss.IndexFlatIP(rows.shape[1])
    index.add(units)

    def search(queries: Array) -> tuple[NDArray[np.intp], Array]:
        single = queries.astype(np.float32)
        faiss.normalize_L2(single)
        cosines, found = index.search(single, 1)
        return found[:, 0], _angles(cosines[:, 0].astype(float))

    return search


BUILDERS: dict[str, Callable[[Array], Search]] = {
    OURS: _ours,
    "NumPy": _numpy,
    "SciPy cdist": _scipy,
    "faiss": _faiss,
    "spectral": _spectral,
    "scikit-learn": _scikit_learn,
}


def missing() -> list[str]:
    """Name the peers that are not installed."""
    return [name for name, module in NEEDS.items() if importlib.util.find_spec(module) is None]


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


def nearest_exactly(rows: Array, query: Array) -> set[int]:
    """Find the rows of least spectral angle by exact fractions.

    Parameters
    ----------
    rows
        Finite and not zero, shape ``(m, n)``.
    query
        Finite and not zero, shape ``(n,)``, of moderate size.

    Returns
    -------
    set of int
        The nearest row, with those that are as near to the last fraction.
    """
    cosines = rows @ query
    cosines /= np.sqrt(np.einsum("ij,ij->i", rows, rows)) * np.linalg.norm(query)
    # Far more than rounding, so the nearest row is among these.
    close = np.flatnonzero(cosines >= cosines.max() - 1e-13)
    exact = [Fraction(x) for x in query.tolist()]
    keys: dict[int, Fraction] = {}
    for row in close.tolist():
        vector = [Fraction(x) for x in rows[row].tolist()]
        dot = sum((a * b for a, b in zip(vector, exact, strict=True)), Fraction(0))
        # The cosine squared with its sign, but for the query's length.
        keys[row] = dot * abs(dot) / sum((a * a for a in vector), Fraction(0))
    largest = max(keys.values())
    return {row for row, key in keys.items() if key == largest}


def is_nearest(rows: Array, query: Array, found: int, truth: set[int]) -> bool:
    """Say whether a row is one of the truth, or as near to it as float64 can tell."""
    if not 0 <= found < len(rows):
        return False
    if found in truth:
        return True
    best = spectral_angle(rows[next(iter(truth))], query)
    return bool(spectral_angle(rows[found], query) <= best + ROUNDING_RAD)


@dataclass(frozen=True)
class HardCase:
    """A question with an exact answer: rows, query, the nearest rows and their angle, rad.

    ``rows_right`` is empty where there is no answer, so that only a refusal or NaN is right.
    """

    rows: Array
    query: Array
    rows_right: set[int]
    angle: float


def hard_cases(rows: Array) -> dict[str, HardCase]:
    """Make the questions that are easy to get wrong, out of at least 500 signatures."""
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    across = np.roll(rows[400], 1)
    across -= (across @ rows[400]) * rows[400]
    across /= np.linalg.norm(across)  # so that a step along it is an angle
    between = rows.copy()
    between[20] = rows[400] - 3e-9 * across
    near = rows[400] + 1e-9 * across
    twins = rows.copy()
    twins[[50, 250]] = rows[450]
    dark = rows.copy()
    dark[10] = 0.0
    aside = rows[450] + 1e-3 * across
    angle = float(spectral_angle(rows[450], aside))
    truth = nearest_exactly(twins, aside)
    dark_truth = {row + (row >= 10) for row in nearest_exactly(np.delete(dark, 10, 0), aside)}
    return {
        "1e-9 rad": HardCase(between, near, {400}, 1e-9),
        "equal rows": HardCase(twins, aside, truth, angle),
        "1e200 times": HardCase(rows, 1e200 * aside, nearest_exactly(rows, aside), angle),
        "zero row": HardCase(dark, aside, dark_truth, angle),
        "zero query": HardCase(rows, np.zeros(rows.shape[1]), set(), np.nan),
    }


def verdict(build: Callable[[Array], Search], case: HardCase) -> str:
    """Say in a few words how a peer answers a hard case; what is right starts with ``right``."""
    try:
        with np.errstate(all="ignore"):
            found, angles = build(case.rows)(case.query[None])
    except ValueError:
        refusable = not case.rows_right or not case.rows.any(axis=1).all()
        return "right: refused" if refusable else "refused"
    row, angle = int(found[0]), float(angles[0])
    if not case.rows_right:
        return f"row {row}, NaN" if np.isnan(angle) else f"row {row}, {angle:.2g} rad"
    if np.isnan(angle):
        return f"row {row}, NaN"
    if row not in case.rows_right:
        if row < 0 or not case.rows[row].any():
            return f"wrong row: {row}"
        return f"wrong row at {spectral_angle(case.rows[row], case.query):.1e} rad"
    if abs(angle - case.angle) > 1e-3 * case.angle:
        return f"wrong angle: {angle:.2g}"
    return "right"


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
