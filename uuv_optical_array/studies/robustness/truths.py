"""The light of seas that are not the scene.

Each function turns poses into the light of a truth that an estimator does not know, or returns a
function that does. Noise and electronics are those of the scene; the lamp keeps its power where
another setting is off.
"""

import dataclasses
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.polynomial.legendre import legvander2d

from uuv_optical_array.core.geometry import PITCH, YAW, Array, X, Y, Z, rotation_matrix
from uuv_optical_array.forward.effects import check_effects
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import ATTENUATION, BEAM_SIGMA, POWER, over_array
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import DAY_S, uniform_poses

# Light at the detectors, counts, shape (n, side, side), of poses, shape (n, 5), in the sea that
# differs from the scene of a model; the generator is for what of it is random.
Light: TypeAlias = Callable[[ForwardModel, Array, np.random.Generator], Array]

# Products of Legendre polynomials over the array, by their degrees: its smooth uneven modes.
MODES = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
SECOND_LAMP_M = np.array([0.0, 0.3, 0.0, 0.0, 0.0])
MIRRORED_LAMP_M = np.array([0.0, 0.0, 1.0, 0.0, 0.0])  # the surface is halfway
NEAR_M, ASIDE_M = 2.0, 1.5


def nothing(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Return the light of the scene itself."""
    return model.light(poses)


def with_power(factor: float) -> Light:
    """Change the lamp's power by a factor."""
    return lambda model, poses, rng: model.light(poses, 0.0, {POWER: np.array(np.log(factor))})


def attenuation_per_m(scene: Scene) -> float:
    """Return the attenuation of a scene, 1/m."""
    return float(scene.effects.get("attenuation", {}).get("k_per_m", 0.0))


def with_attenuation(off_per_m: float) -> Light:
    """Add to the attenuation, 1/m."""

    def light(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
        if ATTENUATION not in model.nuisances:
            clear = {**model.scene.effects, "attenuation": {"k_per_m": 0.0}}
            power = model.power
            model = ForwardModel(dataclasses.replace(model.scene, effects=check_effects(clear)))
            model.power = power  # else the lamp would be set anew, by its reference reading
        return model.light(poses, 0.0, {ATTENUATION: np.array(off_per_m)})

    return light


def with_beam(off_deg: float) -> Light:
    """Add to the standard deviation of the beam, deg; its intensity on the axis stays."""
    return lambda model, poses, rng: model.light(poses, 0.0, {BEAM_SIGMA: np.array(off_deg)})


def plus(low_counts: float, high_counts: float) -> Light:
    """Add light that grows evenly from the port edge of the array to its starboard edge."""

    def light(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
        return model.light(poses) + np.linspace(low_counts, high_counts, model.array.side)

    return light


def lamp_alone(model: ForwardModel, poses: Array) -> tuple[Array, Array]:
    """Return the light of the lamp, and that of all else."""
    dark = model.light(poses, 0.0, {POWER: np.array(-np.inf)})
    return model.light(poses) - dark, dark


def with_second_lamp(share: float, offset_m: Array) -> Light:
    """Add another lamp, parallel to the first, of a share of its power, at an offset in beacon."""

    def light(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
        # The follower is at that much less in the frame of the other lamp.
        return model.light(poses) + share * lamp_alone(model, poses - offset_m)[0]

    return light


def with_gains(std: float) -> Light:
    """Give each detector a gain of its own, in each frame another."""

    def light(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
        image = model.light(poses)
        return image * np.maximum(1 + std * rng.standard_normal(image.shape), 0.0)

    return light


def with_detector(reads_full_scale: bool) -> Light:
    """Let one detector, in each frame another, be dead or stuck at full scale."""

    def light(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
        image, side = model.light(poses), model.array.side
        row, column = rng.integers(side, size=(2, len(poses)))
        level = 10 * model.scene.full_scale_counts if reads_full_scale else 0.0
        image[np.arange(len(poses)), row, column] = level
        return image

    return light


def with_rows(gain: float) -> Light:
    """Let two neighbouring rows, in each frame others, read a share of their light."""

    def light(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
        image, side = model.light(poses), model.array.side
        first = rng.integers(side - 1, size=(len(poses), 1))
        row = np.arange(side)
        image[(row == first) | (row == first + 1)] *= gain
        return image

    return light


def dimmed(model: ForwardModel, poses: Array, factor: Array) -> Array:
    """Let a factor ``(n, side, side)`` of the lamp's light pass, and all of the rest."""
    lamp, rest = lamp_alone(model, poses)
    return lamp * factor + rest


def uneven_modes(side: int) -> Array:
    """Return `MODES` over the array, each with an RMS of 1, shape ``(modes, side, side)``."""
    column, row = over_array(side)
    modes = np.stack([legvander2d(column, row, degrees)[..., -1] for degrees in MODES])
    return modes / np.sqrt(np.mean(modes**2, axis=(1, 2), keepdims=True))


def with_shade(std: float) -> Light:
    """Shade the lamp unevenly and smoothly, the logarithm off by `std` over the array, RMS."""

    def light(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
        depths = rng.standard_normal((len(poses), len(MODES))) * std / np.sqrt(len(MODES))
        shade = np.tensordot(depths, uneven_modes(model.array.side), axes=1)
        return dimmed(model, poses, np.exp(shade))

    return light


def in_half_shadow(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Let the lamp reach one half of the array, in each frame another, with a hard edge."""
    column, row = over_array(model.array.side)
    turn = rng.uniform(0, 2 * np.pi, (len(poses), 1, 1))
    return dimmed(model, poses, np.where(np.cos(turn) * column + np.sin(turn) * row > 0, 0.0, 1.0))


def rolled(by_deg: float) -> Light:
    """Roll the follower."""
    return lambda model, poses, rng: model.light(poses, np.radians(by_deg))


def turned_on_its_mount(by_deg: float) -> Light:
    """Turn the array about its middle, in each frame in another direction."""

    def light(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
        direction = rng.uniform(0, 2 * np.pi, len(poses))
        aimed = poses.copy()
        aimed[:, PITCH] += np.radians(by_deg) * np.sin(direction)
        aimed[:, YAW] += np.radians(by_deg) * np.cos(direction)
        # Where base_link would be if it turned with the array.
        ahead, aimed_ahead = (
            rotation_matrix(p[:, PITCH], p[:, YAW])[..., X] for p in (poses, aimed)
        )
        aimed[:, : Z + 1] += model.scene.array.bow_m * (ahead - aimed_ahead)
        return model.light(aimed)

    return light


def mirrored(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Swap port and starboard of the image, as by a connector the wrong way round."""
    return model.light(poses)[..., ::-1]


def at_moments(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Let what moves in the scene move: each image is of a random moment of a day."""
    return model.light(poses, time_s=rng.uniform(0, DAY_S, len(poses)))


def noise(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Return readings that are uniform up to full scale."""
    return rng.uniform(0, model.scene.full_scale_counts, model.light(poses).shape)


def blob(model: ForwardModel, poses: Array, rng: np.random.Generator) -> Array:
    """Return a Gaussian blob of any place, width and brightness."""
    column, row = over_array(model.array.side)
    at = rng.uniform(-1, 1, (2, len(poses), 1, 1))
    width = rng.uniform(0.3, 1, (2, len(poses), 1, 1))
    peak = rng.uniform(0.1, 1, (len(poses), 1, 1)) * model.scene.full_scale_counts
    return peak * np.exp(
        -(((column - at[0]) / width[0]) ** 2 + ((row - at[1]) / width[1]) ** 2) / 2
    )


def near_poses(count: int, rng: np.random.Generator) -> Array:
    """Draw poses on bearings of the working volume, `NEAR_M` behind the lamp."""
    poses = uniform_poses(count, rng)
    poses[:, : Z + 1] *= -NEAR_M / poses[:, X : X + 1]
    return poses


def aside_poses(count: int, rng: np.random.Generator) -> Array:
    """Draw poses of the working volume, but `ASIDE_M` from the beam's axis."""
    poses = uniform_poses(count, rng)
    across = poses[:, Y : Z + 1]
    across *= ASIDE_M / np.linalg.norm(across, axis=1, keepdims=True)
    return poses
