"""The settings that no other setting beats."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.studies.tradeoff.measurement import guess
from uuv_optical_array.studies.tradeoff.results import Row

# A setting that leaves more frames than this without a pose has no fair error, and is no choice.
MOST_WITHOUT_POSE = 0.01
# Times and errors are compared in steps of 10 %: closer ones are noise.
STEP = 1.1


def pareto_front(costs: ArrayLike) -> NDArray[np.bool_]:
    """Find the points that no other point beats.

    A point is beaten by one that costs no more in anything and less in something; equal points
    do not beat each other.

    Parameters
    ----------
    costs
        Less is better, shape ``(n, k)``; a point with a nan or an infinity is on no front.

    Returns
    -------
    ndarray of bool
        Which points are on the front, shape ``(n,)``.
    """
    costs = np.asarray(costs, dtype=float)
    front = np.isfinite(costs).all(axis=1)
    points = np.unique(costs[front], axis=0)  # sorted: only an earlier one can beat a point
    kept: list[Array] = []
    for point in points:
        if not any((other <= point).all() for other in kept):
            kept.append(point)
    if kept:
        front &= (costs[:, None] == np.array(kept)).all(axis=2).any(axis=1)
    return front


def fronts(rows: Sequence[Row]) -> dict[str, NDArray[np.bool_]]:
    """Find the settings on each front: of median time, in models, and one of the two errors.

    The middle of the volume can be had for nothing, so a setting has to be better than that. Time
    and error are rounded to steps of 10 %. Of settings that are then equal, the one of fewest
    detectors is kept, and of those the one of the smallest table.

    Parameters
    ----------
    rows
        n settings; those that leave frames without a pose are on no front.

    Returns
    -------
    dict
        Which rows are on the front, shape ``(n,)``, by ``position`` and ``angle``.
    """
    found = {}
    for name, column, free in zip(
        ("position", "angle"), ("position_m", "angle_deg"), guess(), strict=True
    ):
        costs = [
            (row.models, getattr(row, column))
            if row.without_pose <= MOST_WITHOUT_POSE
            else (np.inf, np.inf)
            for row in rows
        ]
        steps = np.round(np.log(np.reshape(costs, (-1, 2))) / np.log(STEP))
        steps[~(steps[:, 1] < np.round(np.log(free) / np.log(STEP)))] = np.inf
        on = pareto_front(steps)
        simplest: dict[tuple[float, ...], int] = {}
        by_cost = sorted(on.nonzero()[0], key=lambda i: simplicity(rows[i]))
        for i in by_cost:
            simplest.setdefault(tuple(steps[i]), i)
        found[name] = np.isin(np.arange(len(rows)), list(simplest.values()))
    return found


def simplicity(row: Row) -> tuple[float, ...]:
    """Order settings by what they ask for: fewest detectors, smallest table, least time."""
    return row.detectors_per_side, row.table_rows, row.median_ms


def numbered(rows: Sequence[Row]) -> list[int]:
    """Return the places in `rows` of the settings on any front, the fastest first."""
    on = np.any(list(fronts(rows).values()), axis=0)
    return sorted(on.nonzero()[0].tolist(), key=lambda i: rows[i].models)
