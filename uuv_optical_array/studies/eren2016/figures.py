"""Figs 4 to 6 of Eren et al. (2016): by what spectral angle a move shows in the signature.

The aligned follower is shifted to starboard, or turned about its centre of mass, and the plain
spectral angle (eq. 13) is taken between the signatures before and after. What the paper leaves
open is a choice: the scene `eren2016` and `RECONSTRUCTION` hold ours, `paper_choices.py` others.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import YAW, Array, X, Y
from uuv_optical_array.estimation.features import key_parameters
from uuv_optical_array.estimation.spectral_angle import spectral_angle
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene

Motion = Literal["shift", "yaw"]
UNITS: dict[Motion, str] = {"shift": "m", "yaw": "deg"}
# The steps of the paper's curves, in these units.
STEPS: dict[Motion, Array] = {"shift": np.arange(31) * 3 / 100, "yaw": np.arange(31) / 1}
THRESHOLD_DEG = 15.0  # the angle from which the paper calls a move detected
SIDES = (3, 5, 7, 9, 11, 15, 21, 51, 101)  # the paper says 3 to 101
FLAT = 1e-9  # share of the peak below which differences are rounding
RANGES_M = (4.0, 5.0, 6.0, 7.0, 8.0)


def from_paper_axes(poses: ArrayLike) -> Array:
    """Convert poses from the paper's axes to ours; every sign changes.

    Parameters
    ----------
    poses
        Range behind the lamp, to starboard and down, m; bow up and bow to starboard, rad,
        shape ``(..., 5)``.

    Returns
    -------
    Array
        ``(x, y, z, pitch, yaw)`` in ``beacon`` (REP 103), shape ``(..., 5)``.
    """
    return 0.0 - np.asarray(poses, dtype=float)


def paper_signature(
    images: Array, on_axis_counts: float, peak: Literal["detector", "subdetector"] = "detector"
) -> Array:
    """Scale the five key parameters as the paper's figures seem to.

    Column and row count from 1 at the port and the top edge and are divided by the detectors in
    a row; nothing is appended. The text gives neither divisor, and measures from the centre.

    Parameters
    ----------
    images
        Readings in counts, shape ``(..., side, side)``.
    on_axis_counts
        Largest reading of the aligned array at the same range, counts, > 0.
    peak
        As in `key_parameters`; the paper takes a whole detector.

    Returns
    -------
    Array
        ``(peak / on axis, column / side, row / side, skewness, skewness)``, shape ``(..., 5)``.
    """
    side = images.shape[-1]
    vectors = key_parameters(images, on_axis_counts, peak)
    vectors[..., 1:3] = (vectors[..., 1:3] + (side + 1) / 2) / side
    return vectors


def scene_signature(images: Array, on_axis_counts: float, scene: Scene) -> Array:
    """Return `paper_signature` with the peak where the scene places it."""
    return paper_signature(images, on_axis_counts, scene.signature.peak)


@dataclass(frozen=True)
class Choice:
    """One way to fill in what the paper leaves open.

    Parameters
    ----------
    text
        What is chosen, a few words.
    scene
        Changes the scene, whose array has its shape and size already.
    poses
        Changes poses in ``beacon``, shape ``(n, 5)``; the second argument is the scene.
    images
        Takes model and poses to images, shape ``(..., n, side, side)``; the mean spectral angle
        over the leading axes counts.
    signature
        Takes images, the on-axis reading and the scene to vectors, shape ``(..., 5)``.
    """

    text: str
    scene: Callable[[Scene], Scene] = lambda scene: scene
    poses: Callable[[Array, Scene], Array] = lambda poses, scene: poses
    images: Callable[[ForwardModel, Array], Array] = ForwardModel.expected
    signature: Callable[[Array, float, Scene], Array] = scene_signature


RECONSTRUCTION = Choice("as reconstructed")


@dataclass(frozen=True)
class Conditions:
    """An array that is moved: of which shape, with how many detectors in a row, and where."""

    shape: Shape
    side: int
    range_m: float
    motion: Motion

    def as_object(self, steps: ArrayLike) -> dict[str, Any]:
        """Return the conditions and the steps of the move as plain values."""
        return {
            "array": self.shape,
            "detectors_per_side": self.side,
            "range_m": self.range_m,
            f"{self.motion}_{UNITS[self.motion]}": np.asarray(steps, dtype=float).tolist(),
        }


def angles_deg(
    scene: Scene, conditions: Conditions, steps: ArrayLike, choice: Choice = RECONSTRUCTION
) -> Array:
    """Spectral angles between the aligned array and the moved one.

    Parameters
    ----------
    scene
        Lamp, water and array, of which shape and size are replaced.
    conditions
        The array, its range (of ``base_link`` behind the lamp) and the motion.
    steps
        Shifts to starboard in m, or turns of the bow to starboard in deg, shape ``(n,)``.
    choice
        What the paper leaves open.

    Returns
    -------
    Array
        Degrees in [0, 180], shape ``(n,)``; nan where the aligned image is flat, so that
        rounding alone decides where its peak is.

    Raises
    ------
    ValueError
        Where a signature has no direction, or the scene cannot have such an array.
    """
    array = dataclasses.replace(
        scene.array.with_shape(conditions.shape), detectors_per_side=conditions.side
    )
    model = ForwardModel(choice.scene(dataclasses.replace(scene, array=array)))
    moved = np.atleast_1d(np.asarray(steps, dtype=float))
    in_paper_axes = np.zeros((1 + len(moved), 5))
    in_paper_axes[:, X] = conditions.range_m
    if conditions.motion == "shift":
        in_paper_axes[1:, Y] = moved
    else:
        in_paper_axes[1:, YAW] = np.radians(moved)
    poses = choice.poses(from_paper_axes(in_paper_axes), model.scene)
    on_axis_counts = float(model.expected(poses[0]).max())
    images = choice.images(model, poses)
    if np.ptp(images[..., 0, :, :]) <= FLAT * on_axis_counts:
        return np.full(len(moved), np.nan)
    vectors = choice.signature(images, on_axis_counts, model.scene)
    angles = np.degrees(spectral_angle(vectors[..., :1, :], vectors[..., 1:, :]))
    return angles.reshape(-1, len(moved)).mean(axis=0)


# Spectral angles of moves, once scene and choice are fixed.
Angles: TypeAlias = Callable[[Conditions, ArrayLike], Array]


@dataclass(frozen=True)
class Statement:
    """What the paper's text states of a figure, and the same number of ours.

    Parameters
    ----------
    figure
        Number and panel, such as ``4b``.
    text
        What is compared, a few words.
    conditions
        The same as plain values.
    paper
        The stated number, deg; ``None`` where the paper has words only.
    relation
        Whether the paper's number is the angle, or the angle lies above or below it; or the
        paper's words.
    ours
        Computes our number, deg.
    """

    figure: str
    text: str
    conditions: Mapping[str, Any]
    paper: float | None
    relation: str
    ours: Callable[[Angles], float]

    @property
    def label(self) -> str:
        """The paper's number as it is printed: ``12``, ``> 15``, or its words."""
        if self.paper is None:
            return self.relation
        sign = {"is": "", "above": "> ", "below": "< "}[self.relation]
        return f"{sign}{self.paper:g}"

    def met(self, ours: float) -> bool | None:
        """Whether our number lies on the stated side; ``None`` where no side is stated.

        A number that is nan lies on neither.
        """
        if self.paper is None or self.relation not in ("above", "below"):
            return None
        return ours > self.paper if self.relation == "above" else ours < self.paper


def _at(figure: str, conditions: Conditions, step: float, relation: str, paper: float) -> Statement:
    side, unit = conditions.side, UNITS[conditions.motion]
    return Statement(
        figure,
        f"{conditions.shape} {side} x {side}, {conditions.range_m:g} m, "
        f"{conditions.motion} {step:g} {unit}",
        conditions.as_object(step),
        paper,
        relation,
        lambda angles: float(angles(conditions, [step])[0]),
    )


def _curved_less_planar(angles: Angles, steps: Array) -> Array:
    curved, planar = (Conditions(shape, 21, 4.0, "shift") for shape in ("curved", "planar"))
    return angles(curved, steps) - angles(planar, steps)


def _largest_near(angles: Angles) -> float:
    difference = _curved_less_planar(angles, NEAR)
    return float(difference[np.abs(difference).argmax()])


def _best_gain(motion: Motion, step: float) -> Statement:
    def ours(angles: Angles) -> float:
        at_7, *larger = (
            float(angles(Conditions("curved", side, 4.0, motion), [step])[0])
            for side in SIDES
            if side >= 7
        )
        return max(larger) - at_7

    return Statement(
        "5a" if motion == "shift" else "5b",
        f"best gain over 7 x 7, 4 m, {motion} {step:g} {UNITS[motion]}",
        {
            **Conditions("curved", 7, 4.0, motion).as_object(step),
            "compared_with_detectors_per_side": [side for side in SIDES if side > 7],
        },
        None,
        "not significant",
        ours,
    )


_BOTH = {"array": "curved less planar", "detectors_per_side": 21, "range_m": 4.0}
FAR, NEAR = STEPS["shift"][STEPS["shift"] > 0.6], STEPS["shift"][STEPS["shift"] <= 0.6]
STATEMENTS = (
    Statement(
        "4a",
        "curved less planar, shift > 0.6 m, mean",
        {**_BOTH, "shift_m": FAR.tolist(), "statistic": "mean"},
        2.0,
        "is",
        lambda angles: float(_curved_less_planar(angles, FAR).mean()),
    ),
    Statement(
        "4a",
        "curved less planar, shift <= 0.6 m, largest",
        {**_BOTH, "shift_m": NEAR.tolist(), "statistic": "largest in magnitude"},
        None,
        "similar",
        _largest_near,
    ),
    _at("4b", Conditions("planar", 21, 4.0, "yaw"), 5.0, "is", 5.0),
    _at("4b", Conditions("planar", 21, 4.0, "yaw"), 10.0, "is", 11.0),
    _at("4b", Conditions("curved", 21, 4.0, "yaw"), 5.0, "is", 12.0),
    _at("4b", Conditions("curved", 21, 4.0, "yaw"), 10.0, "is", 22.0),
    _at("5a", Conditions("curved", 3, 4.0, "shift"), 0.2, "below", THRESHOLD_DEG),
    _at("5a", Conditions("curved", 5, 4.0, "shift"), 0.2, "above", THRESHOLD_DEG),
    _best_gain("shift", 0.2),
    _at("5b", Conditions("curved", 3, 4.0, "yaw"), 10.0, "below", THRESHOLD_DEG),
    _at("5b", Conditions("curved", 5, 4.0, "yaw"), 10.0, "above", THRESHOLD_DEG),
    _best_gain("yaw", 10.0),
    _at("6b", Conditions("curved", 5, 8.0, "shift"), 0.2, "above", 6.0),
    _at("6e", Conditions("curved", 5, 8.0, "yaw"), 10.0, "above", 10.0),
)


def score(ours: Sequence[float]) -> tuple[int, float]:
    """Sum up numbers of all `STATEMENTS`.

    Parameters
    ----------
    ours
        One a statement, deg.

    Returns
    -------
    met : int
        On how many of the stated sides they lie.
    rms_deg : float
        Root mean square of what they are off the stated angles.
    """
    pairs = list(zip(STATEMENTS, ours, strict=True))
    off = [value - s.paper for s, value in pairs if s.relation == "is" and s.paper is not None]
    return sum(s.met(value) is True for s, value in pairs), float(np.sqrt(np.mean(np.square(off))))


def panels() -> dict[str, list[Conditions]]:
    """Return the curves of each panel of the paper's figures, by its number and letter."""
    found: dict[str, list[Conditions]] = {}
    shapes: tuple[Shape, ...] = ("planar", "curved")
    motions: tuple[Motion, ...] = ("shift", "yaw")
    for motion, letter in zip(motions, "ab", strict=True):
        found[f"4{letter}"] = [Conditions(shape, 21, 4.0, motion) for shape in shapes]
        found[f"5{letter}"] = [Conditions("curved", side, 4.0, motion) for side in SIDES]
    for motion, letters in zip(motions, ("abc", "def"), strict=True):
        for side, letter in zip((3, 5, 101), letters, strict=True):
            found[f"6{letter}"] = [Conditions("curved", side, m, motion) for m in RANGES_M]
    return dict(sorted(found.items()))


def least_detected(steps: Array, angles: Array) -> float | None:
    """Return the first step whose angle reaches the paper's threshold, or ``None``."""
    reached = angles >= THRESHOLD_DEG
    return float(steps[reached.argmax()]) if reached.any() else None
