"""The designs that none beats: few detectors against what they allow to be known."""

from collections.abc import Sequence

import numpy as np

from uuv_optical_array.design import Design
from uuv_optical_array.design_store import Row, Study
from uuv_optical_array.pareto import STEP, pareto_front


def front(rows: Sequence[Row]) -> list[Row]:
    """Find the designs that none beats in detectors, position and angle.

    Bounds are rounded to steps of 10 %; of designs that are then equal, the one with the least
    bound on the position is kept.

    Parameters
    ----------
    rows
        Designs with their scores.

    Returns
    -------
    list
        Those on the front, fewest detectors first.
    """
    ordered = sorted(rows, key=lambda row: (row.design.detectors, row.score.position_m))
    bounds = np.reshape([(row.score.position_m, row.score.angle_deg) for row in ordered], (-1, 2))
    steps = np.round(np.log(bounds) / np.log(STEP))
    costs = np.column_stack([[row.design.detectors for row in ordered], steps])
    first: dict[tuple[float, ...], Row] = {}
    for i in pareto_front(costs).nonzero()[0]:
        first.setdefault(tuple(costs[i]), ordered[i])
    return list(first.values())


def fronts(study: Study, rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Find the fronts that are told: of which designs, and those on it.

    Parameters
    ----------
    study, rows
        What was scored.

    Returns
    -------
    dict
        ``fits``: no wider than the scene's array; ``told``: of these, the paper's criterion met
        at 4 m; ``any``: of any width.
    """
    fits = [row for row in rows if row.design.width_m <= study.scene.array.width_m]
    return {
        "fits": front(fits),
        "told": front([row for row in fits if row.score.told_near]),
        "any": front(rows),
    }


def of_the_paper(study: Study, rows: Sequence[Row]) -> Row | None:
    """Return what Eren et al. (2016) choose, with the scene's lamp, or ``None`` if not swept."""
    chosen = Design("curved", 5, 0.4, 0.32, study.scene.lamp.beam_sigma_deg)
    return next((row for row in rows if row.design == chosen), None)


def numbered(study: Study, rows: Sequence[Row]) -> list[Row]:
    """Return every design that is told, once: the fronts in turn, then the paper's choice."""
    paper = of_the_paper(study, rows)
    listed = [row for found in fronts(study, rows).values() for row in found]
    return list(dict.fromkeys([*listed, *([paper] if paper else [])]))
