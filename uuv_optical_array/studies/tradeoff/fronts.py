"""The Pareto-optimal settings: nothing measured is both faster and better by 10 %."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.forward.working_volume import volume_spread
from uuv_optical_array.studies.pareto import STEP, pareto_front
from uuv_optical_array.studies.tradeoff.results import Measurement

# A setting that leaves more frames than this without a pose has no fair error, and is no choice.
MOST_WITHOUT_POSE = 0.01


def fronts(rows: Sequence[Measurement]) -> dict[str, NDArray[np.bool_]]:
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
    columns = {"position": "position_m", "angle": "angle_deg"}
    for (name, column), free in zip(columns.items(), volume_spread(), strict=True):
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


def simplicity(row: Measurement) -> tuple[float, ...]:
    """Order settings by what they ask for: fewest detectors, smallest table, least time."""
    return row.detectors_per_side, row.table_rows, row.median_ms


def numbered(rows: Sequence[Measurement]) -> list[int]:
    """Return the places in `rows` of the settings on any front, the fastest first."""
    on = np.any(list(fronts(rows).values()), axis=0)
    return sorted(on.nonzero()[0].tolist(), key=lambda i: rows[i].models)


def as_object(rows: Sequence[Measurement]) -> dict[str, Any]:
    """Return settings as plain values, and which are on a front."""
    return {
        "settings": [row.columns() for row in rows],
        "fronts": {
            name: [rows[i].label for i in front.nonzero()[0]]
            for name, front in fronts(rows).items()
        },
    }
