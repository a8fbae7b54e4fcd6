"""What else searches for the nearest row by spectral angle.

Each peer is called as its manual says. None of them names its answer's angle by a stable formula,
so cosines become angles by arccos, as their users would do.
"""

import importlib.util
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.signature.spectral_angle import SpectralIndex

# Of queries (q, n): the nearest row of each, and its angle in rad.
Search: TypeAlias = Callable[[Array], tuple[NDArray[np.intp], Array]]

OURS = "uuv_optical_array"
# Module that a peer needs besides NumPy and SciPy.
NEEDS = {"spectral": "spectral", "scikit-learn": "sklearn", "faiss": "faiss"}
ANGLES_AT_ONCE = 25_000_000  # 200 MB: queries beyond it go to a peer in parts


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
        angles, found = zip(*map(index.nearest, queries), strict=True)
        return np.concatenate(found), np.concatenate(angles)

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
