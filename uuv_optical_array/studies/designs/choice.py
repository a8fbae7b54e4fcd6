"""What a sweep offers: Pareto-optimal designs, as a table."""

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.designs.scores import PAPER, ScoredDesign
from uuv_optical_array.studies.designs.sweep import Design
from uuv_optical_array.studies.shared.results import STEP
from uuv_optical_array.studies.shared.separation import MOVES

CLEAR_SIGMAS = 3.0


def front(rows: Sequence[ScoredDesign]) -> list[ScoredDesign]:
    """Return the designs that represent all in detectors and bounds, fewest detectors first.

    One represents another that has no fewer and whose bounds are each at least its own over `STEP`.
    """
    kept: list[ScoredDesign] = []
    # A later design never represents an earlier one: that would need a smaller product.
    for row in sorted(rows, key=lambda row: (row.detectors, row.position_m * row.angle_deg)):
        most = STEP * row.position_m, STEP * row.angle_deg
        if not any(one.position_m <= most[0] and one.angle_deg <= most[1] for one in kept):
            kept.append(row)
    return sorted(kept, key=lambda row: (row.detectors, row.position_m))


@dataclass(frozen=True)
class Choice:
    """What a sweep offers: the Pareto-optimal designs among the scored ones about a scene's."""

    scene: Scene
    rows: Sequence[ScoredDesign]

    @functools.cached_property
    def fronts(self) -> dict[str, list[ScoredDesign]]:
        """Fronts of what is no wider than the scene's array, of what resolves, and of all."""
        fits = [row for row in self.rows if row.width_m <= self.scene.array.width_m]
        resolved = [row for row in fits if row.resolved_at_4m]
        return {"fits": front(fits), "resolved": front(resolved), "any": front(self.rows)}

    @functools.cached_property
    def papers(self) -> list[ScoredDesign]:
        """The paper's array with the scene's lamps, where it is swept."""
        own = dataclasses.replace(Design.of(self.scene), **PAPER)
        return [row for row in self.rows if row.design == own]

    @functools.cached_property
    def numbered(self) -> list[ScoredDesign]:
        """Every design that is listed, once: the fronts in turn, then the paper's array."""
        on_fronts = [row for rows in self.fronts.values() for row in rows]
        return list(dict.fromkeys([*on_fronts, *self.papers]))

    def table(self) -> str:
        """Return `numbered` as a table."""
        heads = ("position", "angle", "lit", "at 4 m", "", "4 to 8 m", "", "")
        lines: list[tuple[object, ...]] = [
            ("no", "design", "front", "15 deg", *heads),
            ("", "", "", "at", "m", "deg", "%", *MOVES, *MOVES, "sigma"),
        ]
        for number, row in enumerate(self.numbered, start=1):
            on_fronts = [name for name, rows in self.fronts.items() if row in rows] or ["none"]
            standing = ", ".join(on_fronts) + "; the paper's array" * row.is_papers_array
            bounds = f"{row.position_m:.3f}", f"{row.angle_deg:.2f}", f"{100 * row.lit:.0f}"
            angles = row.shift_near_deg, row.yaw_near_deg, row.shift_deg, row.yaw_deg, row.sigmas
            told = (f"{angle:.1f}" for angle in angles)
            lines.append((number, row.label, standing, row.resolved, *bounds, *told))
        return columns(lines, 4)

    def as_object(self) -> dict[str, Any]:
        """Return plain values; None is not known, or has no bound."""
        place = {row: i for i, row in enumerate(self.rows)}
        return {
            "designs": [row.columns() for row in self.rows],
            "fronts": {name: [place[row] for row in rows] for name, rows in self.fronts.items()},
            "numbered": [place[row] for row in self.numbered],
            "papers_array": [i for i, row in enumerate(self.rows) if row.is_papers_array],
        }


def report(choice: Choice) -> str:
    """Return the designs that are listed, and how many meet the criterion."""
    far = [row for row in choice.rows if row.resolved_4_to_8m]
    near = sum(row.resolved_at_4m for row in choice.rows)
    clear = sum(row.sigmas >= CLEAR_SIGMAS for row in far)
    return (
        f"{choice.table()}\n\n"
        f"{near} of {len(choice.rows)} designs tell {' and '.join(MOVES)} apart by 15 deg at 4 m, "
        f"{len(far)} from 4 to 8 m;\nof these, {clear} by {CLEAR_SIGMAS:g} or more standard "
        "deviations of their signature's noise"
    )
