"""The criterion of Eren et al. (2016): by what spectral angle a move changes the signature.

The aligned follower is shifted to starboard, or turned about its centre of mass, and the plain
spectral angle (eq. 13) is taken between the signatures before and after.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import YAW, Array, X, Y
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import SPECIFIED

Motion = Literal["shift", "yaw"]
# Reads n poses ``(n, 5)`` by a model, counts, ``(..., n, side, side)``.
Read: TypeAlias = Callable[[ForwardModel, Array], Array]
UNITS: dict[Motion, str] = {"shift": "m", "yaw": "deg"}
# What the paper wants detected, in these units, and the angle from which it calls a move detected.
WANTED: dict[Motion, float] = {"shift": SPECIFIED[0], "yaw": SPECIFIED[1]}
MOVES = tuple(f"{size:g} {UNITS[motion]}" for motion, size in WANTED.items())
THRESHOLD_DEG = 15.0
FLAT = 1e-9  # share of the peak below which differences are rounding


def from_paper_axes(poses: ArrayLike) -> Array:
    """Convert poses from the paper's axes, behind the lamp, starboard and down, to ours."""
    return 0.0 - np.asarray(poses, dtype=float)  # without a negative zero


def paper_signature(
    images: Array, on_axis_counts: float, peak: Literal["detector", "subdetector"]
) -> Array:
    """Scale the five key parameters as the paper's figures seem to, shape ``(..., 5)``.

    The peak is divided by the aligned array's at the same range, column and row, from 1 at port and
    top edge, by the detectors in a row. The text gives neither divisor, and counts from the centre.
    """
    side = images.shape[-1]
    vectors = key_parameters(images, on_axis_counts, peak)
    vectors[..., 1:3] = (vectors[..., 1:3] + (side + 1) / 2) / side
    return vectors


@dataclass(frozen=True)
class Conditions:
    """The array that is moved: its shape, its detectors in a row, its range, and the motion."""

    shape: Shape
    side: int
    range_m: float
    motion: Motion

    def as_object(self, steps: ArrayLike) -> dict[str, Any]:
        """Return the conditions and the steps of the move as plain values."""
        array = {"array": self.shape, "detectors_per_side": self.side, "range_m": self.range_m}
        values = np.asarray(steps, dtype=float).tolist()
        return {**array, f"{self.motion}_{UNITS[self.motion]}": values}


def angles_deg(
    scene: Scene, conditions: Conditions, steps: ArrayLike, read: Read = ForwardModel.expected
) -> Array:
    """Return spectral angles between the aligned array and the moved one, deg, ``(n,)``.

    The steps ``(n,)`` are shifts, m, or turns of the bow, deg, to starboard; angles are means over
    the leading axes of what is read, nan where the aligned image is flat, so that rounding decides
    where it peaks. ValueError for a signature without direction, or an impossible array.
    """
    shaped = scene.array.with_shape(conditions.shape)
    array = dataclasses.replace(shaped, detectors_per_side=conditions.side, wiring=None)
    model = ForwardModel(dataclasses.replace(scene, array=array))
    steps = np.asarray(steps, dtype=float)
    in_paper_axes = np.zeros((1 + len(steps), 5))
    in_paper_axes[:, X] = conditions.range_m
    dof, size = (Y, steps) if conditions.motion == "shift" else (YAW, np.radians(steps))
    in_paper_axes[1:, dof] = size
    poses = from_paper_axes(in_paper_axes)
    on_axis_counts = float(together(model.expected(poses[0])).max())
    images = together(read(model, poses))
    if np.ptp(images[..., 0, :, :]) <= FLAT * on_axis_counts:
        return np.full(len(steps), np.nan)
    vectors = paper_signature(images, on_axis_counts, scene.signature.peak)
    angles = np.degrees(spectral_angle(vectors[..., :1, :], vectors[..., 1:, :]))
    return angles.reshape(-1, len(steps)).mean(axis=0)
