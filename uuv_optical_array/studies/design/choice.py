"""The designs that none beats: few detectors against what they allow to be known."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from uuv_optical_array.studies.design.designs import Design
from uuv_optical_array.studies.design.store import Row, Study
from uuv_optical_array.studies.shared.pareto import thinned_front


def front(rows: Sequence[Row]) -> list[Row]:
    """Find the designs worth their detectors.

    A design is left out for one that has no more detectors and bounds on position and angle that
    are no more than 10 % larger, or smaller.

    Parameters
    ----------
    rows
        Designs with their scores.

    Returns
    -------
    list
        Those that remain, fewest detectors first; none of them stands for another.
    """
    bounds = [(row.score.position_m, row.score.angle_deg) for row in rows]
    detectors = [row.design.detectors for row in rows]
    kept = [rows[i] for i in thinned_front(detectors, np.reshape(bounds, (-1, 2)))]
    return sorted(kept, key=lambda row: (row.design.detectors, row.score.position_m))


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


# What Eren et al. (2016) choose; their lamp is not given.
PAPER: dict[str, Any] = {
    "shape": "curved",
    "detectors_per_side": 5,
    "width_m": 0.4,
    "radius_m": 0.32,
}


def of_the_paper(design: Design) -> bool:
    """Say whether a design has the array that the paper chooses, whatever its lamp."""
    return design == dataclasses.replace(design, **PAPER)


def numbered(study: Study, rows: Sequence[Row]) -> list[Row]:
    """Return every design that is told, once: the fronts in turn, then the paper's array.

    The last is the one with the scene's lamp, where it is swept.
    """
    own = study.scene.lamp.beam_sigma_deg
    paper = [row for row in rows if of_the_paper(row.design) and row.design.beam_sigma_deg == own]
    listed = [row for found in fronts(study, rows).values() for row in found]
    return list(dict.fromkeys([*listed, *paper]))


def standing(study: Study, rows: Sequence[Row]) -> list[str]:
    """Return for each of `numbered` on which fronts it is, and whether it is the paper's array."""
    on = fronts(study, rows)
    return [
        ", ".join([name for name, found in on.items() if row in found] or ["none"])
        + ("; the paper's array" if of_the_paper(row.design) else "")
        for row in numbered(study, rows)
    ]
