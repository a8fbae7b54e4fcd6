"""What is told of a sweep of designs."""

from collections.abc import Sequence
from typing import Any

from uuv_optical_array.studies.design.fronts import fronts, is_papers_array, numbered
from uuv_optical_array.studies.design.study import DesignStudy, ScoredDesign
from uuv_optical_array.studies.shared.results import for_json

CLEAR_SIGMAS = 3.0


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
        "designs": [for_json(row.columns()) for row in rows],
        "fronts": {
            name: [rows.index(row) for row in found] for name, found in fronts(study, rows).items()
        },
        "numbered": [rows.index(row) for row in numbered(study, rows)],
        "papers_array": [i for i, row in enumerate(rows) if is_papers_array(row.design)],
        "dropped": study.sweep.dropped(),
    }
