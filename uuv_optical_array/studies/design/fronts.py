"""What a sweep of designs shows: those that are Pareto-optimal in detectors and bounds."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from uuv_optical_array.studies.design.designs import Design
from uuv_optical_array.studies.design.study import DesignStudy, ScoredDesign
from uuv_optical_array.studies.pareto import thinned_front

CLEAR_SIGMAS = 3.0


def front(rows: Sequence[ScoredDesign]) -> list[ScoredDesign]:
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


def fronts(study: DesignStudy, rows: Sequence[ScoredDesign]) -> dict[str, list[ScoredDesign]]:
    """Find the Pareto-optimal designs among three sets of them.

    Parameters
    ----------
    study, rows
        What was scored.

    Returns
    -------
    dict
        ``fits``: no wider than the scene's array; ``resolved``: of these, the paper's criterion
        met at 4 m; ``any``: of any width.
    """
    fits = [row for row in rows if row.design.width_m <= study.scene.array.width_m]
    return {
        "fits": front(fits),
        "resolved": front([row for row in fits if row.score.resolved_at_4m]),
        "any": front(rows),
    }


# What Eren et al. (2016) choose; their lamp is not given.
PAPER: dict[str, Any] = {
    "shape": "curved",
    "detectors_per_side": 5,
    "width_m": 0.4,
    "radius_m": 0.32,
}


def is_papers_array(design: Design) -> bool:
    """Say whether a design has the array that the paper chooses, whatever its lamp."""
    return design == dataclasses.replace(design, **PAPER)


def numbered(study: DesignStudy, rows: Sequence[ScoredDesign]) -> list[ScoredDesign]:
    """Return every design that is listed, once: the fronts in turn, then the paper's array.

    The last is the one with the scene's lamp, where it is swept.
    """
    own = study.scene.lamp.beam_sigma_deg
    paper = [
        row for row in rows if is_papers_array(row.design) and row.design.beam_sigma_deg == own
    ]
    listed = [row for found in fronts(study, rows).values() for row in found]
    return list(dict.fromkeys([*listed, *paper]))


def standing(study: DesignStudy, rows: Sequence[ScoredDesign]) -> list[str]:
    """Return for each of `numbered` on which fronts it is, and whether it is the paper's array."""
    on = fronts(study, rows)
    return [
        ", ".join([name for name, found in on.items() if row in found] or ["none"])
        + ("; the paper's array" if is_papers_array(row.design) else "")
        for row in numbered(study, rows)
    ]


def resolved_counts(rows: Sequence[ScoredDesign]) -> tuple[int, int, int]:
    """Count the designs that meet the criterion at 4 m, from 4 to 8 m, and there beyond noise."""
    near = [row.score for row in rows if row.score.resolved_at_4m]
    far = [row.score for row in rows if row.score.resolved_4_to_8m]
    clear = [score for score in far if score.sigmas >= CLEAR_SIGMAS]
    return len(near), len(far), len(clear)


def as_object(study: DesignStudy, rows: Sequence[ScoredDesign]) -> dict[str, Any]:
    """Return a study as plain values; None is not known, or has no bound."""
    return {
        "scene": study.scene.name,
        "sweep": study.sweep.as_object(),
        "power": study.power,
        "mount": study.mount,
        "poses": study.poses,
        "seed": study.seed,
        "designs": [row.columns() for row in rows],
        "fronts": {
            name: [rows.index(row) for row in found] for name, found in fronts(study, rows).items()
        },
        "numbered": [rows.index(row) for row in numbered(study, rows)],
        "papers_array": [i for i, row in enumerate(rows) if is_papers_array(row.design)],
        "dropped": study.sweep.dropped(),
    }
