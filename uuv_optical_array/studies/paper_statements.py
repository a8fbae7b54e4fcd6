"""Figs 4 to 6 of Eren et al. (2016): their curves, and what the text states of them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.working_volume import RANGES_M
from uuv_optical_array.studies.shared.separation import THRESHOLD_DEG, UNITS, Conditions, Motion

MOTIONS: tuple[Motion, ...] = ("shift", "yaw")
# The steps of the paper's curves, in their units.
STEPS: dict[Motion, Array] = {"shift": np.arange(31) * 3 / 100, "yaw": np.arange(31) / 1}
FAR, NEAR = STEPS["shift"][STEPS["shift"] > 0.6], STEPS["shift"][STEPS["shift"] <= 0.6]
SIDES = (3, 5, 7, 9, 11, 15, 21, 51, 101)  # the paper says 3 to 101
SIGNS = {"is": "", "above": "> ", "below": "< "}

# Spectral angles of moves, once scene and choice are fixed.
Angles: TypeAlias = Callable[[Conditions, ArrayLike], Array]


@dataclass(frozen=True)
class Statement:
    """A statement of the paper's text about a figure, and the same number of ours.

    The number and panel of the figure, such as ``4b``; what is compared, in words and as plain
    values; whether the stated number ``is`` the angle, or the angle lies ``above`` or ``below`` it,
    or else the paper's words; what computes our number, deg; and the stated number, deg.
    """

    figure: str
    text: str
    conditions: Mapping[str, Any]
    relation: str
    ours: Callable[[Angles], float]
    paper: float | None = None

    @property
    def label(self) -> str:
        """The paper's number as it is printed: ``12``, ``> 15``, or its words."""
        return self.relation if self.paper is None else f"{SIGNS[self.relation]}{self.paper:g}"

    def met(self, ours: float) -> bool | None:
        """Whether our number lies on the stated side; ``None`` where no side is stated.

        A number that is nan lies on neither.
        """
        if self.paper is None or self.relation == "is":
            return None
        return ours > self.paper if self.relation == "above" else ours < self.paper

    def row(self, ours: float) -> dict[str, Any]:
        """Return the statement as plain values, with our number, deg."""
        stated = {"point": self.text, "conditions": self.conditions, "relation": self.relation}
        return {**stated, "paper_deg": self.paper, "ours_deg": ours, "met": self.met(ours)}

    def verdict(self, ours: float) -> str:
        """Return how our number compares with the paper's, in a word or as a difference."""
        met = self.met(ours)
        if met is not None:
            return "met" if met else "missed"
        return "" if self.paper is None or math.isnan(ours) else f"{ours - self.paper:+.1f}"


def _of(angles: Angles, conditions: Conditions, step: float) -> float:
    return float(angles(conditions, [step])[0])


def _at(figure: str, at: Conditions, step: float, relation: str, paper: float) -> Statement:
    array, move = f"{at.shape} {at.side} x {at.side}", f"{at.motion} {step:g} {UNITS[at.motion]}"
    text, plain = f"{array}, {at.range_m:g} m, {move}", at.as_object(step)
    return Statement(figure, text, plain, relation, lambda angles: _of(angles, at, step), paper)


def _curved_less_planar(angles: Angles, steps: Array) -> Array:
    curved, planar = (Conditions(shape, 21, 4.0, "shift") for shape in ("curved", "planar"))
    return angles(curved, steps) - angles(planar, steps)


def _largest_near(angles: Angles) -> float:
    difference = _curved_less_planar(angles, NEAR)
    return float(difference[np.abs(difference).argmax()])


def best_gain(motion: Motion, step: float, sides: Sequence[int] = (7, 9, 11, 15, 21)) -> Statement:
    """Compare the best array of more than 7 x 7 detectors of `sides` with that of 7 x 7, first."""
    every = [Conditions("curved", side, 4.0, motion) for side in sides]
    conditions = every[0].as_object(step)
    conditions["compared_with_detectors_per_side"] = [other.side for other in every[1:]]

    def ours(angles: Angles) -> float:
        at_7, *others = (_of(angles, array, step) for array in every)
        return max(others) - at_7

    figure = "5a" if motion == "shift" else "5b"
    text = f"best gain over 7 x 7, 4 m, {motion} {step:g} {UNITS[motion]}"
    return Statement(figure, text, conditions, "not significant", ours)


_BOTH = {"array": "curved less planar", "detectors_per_side": 21, "range_m": 4.0}
STATEMENTS = (
    Statement(
        "4a",
        "curved less planar, shift > 0.6 m, mean",
        {**_BOTH, "shift_m": FAR.tolist(), "statistic": "mean"},
        "is",
        lambda angles: float(_curved_less_planar(angles, FAR).mean()),
        2.0,
    ),
    Statement(
        "4a",
        "curved less planar, shift <= 0.6 m, largest",
        {**_BOTH, "shift_m": NEAR.tolist(), "statistic": "largest in magnitude"},
        "similar",
        _largest_near,
    ),
    _at("4b", Conditions("planar", 21, 4.0, "yaw"), 5.0, "is", 5.0),
    _at("4b", Conditions("planar", 21, 4.0, "yaw"), 10.0, "is", 11.0),
    _at("4b", Conditions("curved", 21, 4.0, "yaw"), 5.0, "is", 12.0),
    _at("4b", Conditions("curved", 21, 4.0, "yaw"), 10.0, "is", 22.0),
    _at("5a", Conditions("curved", 3, 4.0, "shift"), 0.2, "below", THRESHOLD_DEG),
    _at("5a", Conditions("curved", 5, 4.0, "shift"), 0.2, "above", THRESHOLD_DEG),
    best_gain("shift", 0.2),
    _at("5b", Conditions("curved", 3, 4.0, "yaw"), 10.0, "below", THRESHOLD_DEG),
    _at("5b", Conditions("curved", 5, 4.0, "yaw"), 10.0, "above", THRESHOLD_DEG),
    best_gain("yaw", 10.0),
    _at("6b", Conditions("curved", 5, 8.0, "shift"), 0.2, "above", 6.0),
    _at("6e", Conditions("curved", 5, 8.0, "yaw"), 10.0, "above", 10.0),
)


def agreement(ours: Sequence[float]) -> tuple[int, float]:
    """Return how many numbers lie on the stated side, and the RMS difference of angles, deg."""
    pairs = list(zip(STATEMENTS, ours, strict=True))
    off = [value - s.paper for s, value in pairs if s.relation == "is" and s.paper is not None]
    return sum(s.met(value) is True for s, value in pairs), float(np.sqrt(np.mean(np.square(off))))


def panels() -> dict[str, list[Conditions]]:
    """Return the curves of each panel of the paper's figures, by its number and letter."""
    curves: dict[str, list[Conditions]] = {}
    shapes: tuple[Shape, ...] = ("planar", "curved")
    for motion, letter in zip(MOTIONS, "ab", strict=True):
        curves[f"4{letter}"] = [Conditions(shape, 21, 4.0, motion) for shape in shapes]
        curves[f"5{letter}"] = [Conditions("curved", side, 4.0, motion) for side in SIDES]
    for motion, letters in zip(MOTIONS, ("abc", "def"), strict=True):
        for side, letter in zip((3, 5, 101), letters, strict=True):
            curves[f"6{letter}"] = [Conditions("curved", side, m, motion) for m in RANGES_M]
    return dict(sorted(curves.items()))


def least_detected(steps: Array, angles: Array) -> float | None:
    """Return the first step whose angle reaches the paper's threshold, or ``None``."""
    reached = angles >= THRESHOLD_DEG
    return float(steps[reached.argmax()]) if reached.any() else None
