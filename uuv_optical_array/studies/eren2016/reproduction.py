"""Everything that is repeated of Eren et al. (2016), and how far it has got."""

import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.eren2016.choices import alternatives, noisy
from uuv_optical_array.studies.eren2016.figures import (
    MOTIONS,
    SIDES,
    STATEMENTS,
    STEPS,
    agreement,
    least_detected,
    panels,
)
from uuv_optical_array.studies.separation import (
    UNITS,
    WANTED,
    Choice,
    Conditions,
    angles_deg,
)

NOISE_RANGES_M = (4.0, 8.0)


@dataclass
class Reproduction:
    """What has been computed so far.

    Parameters
    ----------
    points
        Our number of each of `STATEMENTS`, deg.
    sizes
        One row an array size.
    curves
        Panel, conditions and angles in deg at `STEPS`.
    choices
        Name of each choice, and its numbers of `STATEMENTS`, deg.
    drawable
        Whether no curve is missing.
    complete
        Whether nothing is missing.
    """

    points: list[float] = field(default_factory=list)
    sizes: list[dict[str, Any]] = field(default_factory=list)
    curves: list[tuple[str, Conditions, Array]] = field(default_factory=list)
    choices: list[tuple[str, list[float]]] = field(default_factory=list)
    drawable: bool = False
    complete: bool = False

    def compute(
        self, scene: Scene, seed: int, progress: Callable[[Iterable[Any], str], Iterable[Any]]
    ) -> None:
        """Compute all, the most wanted first; an interrupt leaves what there is.

        Parameters
        ----------
        scene
            Lamp, water and sphere.
        seed
            Of the noise.
        progress
            Wraps each loop; its second argument names what a round is.
        """
        rng = np.random.default_rng(seed)
        angles = functools.partial(angles_deg, scene)
        for statement in progress(STATEMENTS, "point"):
            self.points.append(statement.ours(angles))
        for side in progress(SIDES, "size"):
            self.sizes.append(size(scene, side, noisy(rng)))
        curves = [(panel, conditions) for panel, those in panels().items() for conditions in those]
        for panel, conditions in progress(curves, "curve"):
            self.curves.append((panel, conditions, angles(conditions, STEPS[conditions.motion])))
        self.drawable = True
        for choice in progress(alternatives(rng), "choice"):
            chosen = functools.partial(angles_deg, scene, choice=choice)
            numbers = [statement.ours(chosen) for statement in STATEMENTS]
            self.choices.append((choice.text, numbers))
        self.complete = True


def size(scene: Scene, side: int, noise: Choice) -> dict[str, Any]:
    """Return what a curved array of one size detects at 4 m and takes for a move, plain values."""
    row: dict[str, Any] = {"detectors_per_side": side}
    for motion in MOTIONS:
        steps = np.append(STEPS[motion], WANTED[motion])
        angles = angles_deg(scene, Conditions("curved", side, 4.0, motion), steps)
        name = f"{WANTED[motion]:g}_{UNITS[motion]}".replace(".", "_")
        row[f"angle_deg_at_{name}"] = float(angles[-1])
        row[f"least_{motion}_{UNITS[motion]}"] = least_detected(steps[:-1], angles[:-1])
    for range_m in NOISE_RANGES_M:
        still = angles_deg(scene, Conditions("curved", side, range_m, "shift"), [0.0], noise)
        row[f"noise_deg_at_{range_m:g}_m"] = float(still[0])
    return row


def as_object(found: Reproduction) -> dict[str, Any]:
    """Return what was computed as plain values, by figure; None is not known."""
    figures: dict[str, dict[str, list[Any]]] = {
        panel: {"points": [], "curves": []} for panel in panels()
    }
    for statement, ours in zip(STATEMENTS, found.points, strict=False):
        figures[statement.figure]["points"].append(
            {
                "point": statement.text,
                "conditions": dict(statement.conditions),
                "relation": statement.relation,
                "paper_deg": statement.paper,
                "ours_deg": _known(ours),
                "met": statement.met(ours),
            }
        )
    for panel, conditions, angles in found.curves:
        figures[panel]["curves"].append(
            {
                **conditions.as_object(STEPS[conditions.motion]),
                "angle_deg": [*map(_known, angles.tolist())],
            }
        )
    names = [f"{statement.figure} {statement.text}" for statement in STATEMENTS]
    return {
        "complete": found.complete,
        "figures": figures,
        "sizes": found.sizes,
        "choices": [
            {
                "choice": text,
                "ours_deg": dict(zip(names, map(_known, points), strict=True)),
                "met": agreement(points)[0],
                "rms_deg": _known(agreement(points)[1]),
            }
            for text, points in found.choices
        ],
    }


def _known(ours: float) -> float | None:
    return None if np.isnan(ours) else ours
