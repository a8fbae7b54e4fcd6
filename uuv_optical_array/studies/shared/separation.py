"""The criterion of Eren et al. (2016): by what spectral angle a move changes the signature.

The aligned follower is shifted to starboard, or turned about its centre of mass, and the plain
spectral angle (eq. 13) is taken between the signatures before and after.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import YAW, Array, X, Y
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.lamps import together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import SPECIFICATION

Motion = Literal["shift", "yaw"]
UNITS: dict[Motion, str] = {"shift": "m", "yaw": "deg"}
# What the paper wants detected, in these units, and the angle from which it calls a move detected.
WANTED: dict[Motion, float] = {"shift": float(SPECIFICATION[Y]), "yaw": float(SPECIFICATION[YAW])}
THRESHOLD_DEG = 15.0
FLAT = 1e-9  # share of the peak below which differences are rounding


def from_paper_axes(poses: ArrayLike) -> Array:
    """Convert poses from the paper's axes to ours, shape ``(..., 5)``; every sign changes.

    The paper has the range behind the lamp, to starboard and down, bow up and bow to starboard.
    """
    return 0.0 - np.asarray(poses, dtype=float)


def paper_signature(
    images: Array, on_axis_counts: float, peak: Literal["detector", "subdetector"] = "detector"
) -> Array:
    """Scale the five key parameters as the paper's figures seem to, shape ``(..., 5)``.

    The peak is divided by `on_axis_counts`, the largest reading of the aligned array at the same
    range. Column and row count from 1 at the port and the top edge and are divided by the detectors
    in a row; nothing is appended. The text gives neither divisor, and measures from the centre.
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
    """One way to fill in what the paper leaves open, and its `text` in a few words.

    `scene` changes the scene, whose array has its shape and size already, `poses` changes poses in
    ``beacon`` ``(n, 5)``. `images` takes model and poses to images ``(..., n, side, side)``; the
    mean spectral angle over the leading axes counts. `signature` takes images, the on-axis reading
    and the scene to vectors ``(..., 5)``.
    """

    text: str
    scene: Callable[[Scene], Scene] = lambda scene: scene
    poses: Callable[[Array, Scene], Array] = lambda poses, scene: poses
    images: Callable[[ForwardModel, Array], Array] = ForwardModel.expected
    signature: Callable[[Array, float, Scene], Array] = scene_signature


RECONSTRUCTION = Choice("as reconstructed")


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
    scene: Scene, conditions: Conditions, steps: ArrayLike, choice: Choice = RECONSTRUCTION
) -> Array:
    """Return spectral angles between the aligned array and the moved one, deg, ``(n,)``.

    The steps ``(n,)`` are shifts to starboard in m, or turns of the bow to starboard in deg. nan
    where the aligned image is flat, so that rounding alone decides where its peak is; a ValueError
    says that a signature has no direction, or that the scene cannot have such an array.
    """
    shaped = scene.array.with_shape(conditions.shape)
    array = dataclasses.replace(shaped, detectors_per_side=conditions.side, wiring=None)
    model = ForwardModel(choice.scene(dataclasses.replace(scene, array=array)))
    steps = np.atleast_1d(np.asarray(steps, dtype=float))
    in_paper_axes = np.zeros((1 + len(steps), 5))
    in_paper_axes[:, X] = conditions.range_m
    is_shift = conditions.motion == "shift"
    in_paper_axes[1:, Y if is_shift else YAW] = steps if is_shift else np.radians(steps)
    poses = choice.poses(from_paper_axes(in_paper_axes), model.scene)
    on_axis_counts = float(together(model.expected(poses[0])).max())
    images = together(choice.images(model, poses))
    if np.ptp(images[..., 0, :, :]) <= FLAT * on_axis_counts:
        return np.full(len(steps), np.nan)
    vectors = choice.signature(images, on_axis_counts, model.scene)
    angles = np.degrees(spectral_angle(vectors[..., :1, :], vectors[..., 1:, :]))
    return angles.reshape(-1, len(steps)).mean(axis=0)
